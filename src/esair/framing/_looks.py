"""What bounds the work for garbage, however it is made."""

from __future__ import annotations

RESERVE = 2048
"""How many places are looked at one after the other before the search gets sparse."""

SPARSE = 128
"""How many bytes pay for the look at one place."""


class Looks:
    """Pays for looks at places that begin no good frame.

    A reserve of `RESERVE` looks is spent on whatever comes, and filled again by bytes,
    `SPARSE` for each. All is counted by the place in the stream, so that it is the same
    however the stream was cut.
    """

    def __init__(self) -> None:
        self.count: int = 0
        """How many looks were paid."""
        self.credit: float = 0.0
        """How many looks are left of the reserve."""
        self._stride = 1
        self.fill()

    def fill(self) -> None:
        """Have the whole reserve again."""
        self.credit = float(RESERVE)

    def pay(self, cost: float = 1.0) -> int:
        """Pay for a look in vain; return how many bytes to leave out before the next."""
        self.count += 1
        self.credit -= cost
        if self.credit > 0.0:
            return 0
        # Not always the same: frames of one length would be missed for ever.
        self._stride = self._stride * 5 % 257
        return round(cost) * (1 + self._stride)

    def earn(self, count: int) -> None:
        """Have gone further by so many bytes."""
        self.credit = min(RESERVE, self.credit + count / SPARSE)
