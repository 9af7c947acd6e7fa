"""Who gets which frames."""

from __future__ import annotations

from typing import Final

from esair.buses.can._ids import Filter
from esair.buses.can._inbox import FrameInbox

ROUTES_LIMIT: Final = 4096
"""Of how many ids it is remembered who listens to them."""


class Routes(dict[int, tuple[FrameInbox, ...]]):
    """The inboxes of each id that came; found when it comes for the first time."""

    def __init__(self) -> None:
        super().__init__()
        self._filters: dict[FrameInbox, tuple[Filter, ...]] = {}

    def __missing__(self, key: int) -> tuple[FrameInbox, ...]:
        if len(self) >= ROUTES_LIMIT:
            self.clear()
        found = self[key] = tuple(
            inbox
            for inbox, filters in self._filters.items()
            if any(key & mask == wanted for wanted, mask in filters)
        )
        return found

    @property
    def filters(self) -> frozenset[Filter]:
        """All ids that somebody listens to."""
        return frozenset(each for some in self._filters.values() for each in some)

    def add(self, inbox: FrameInbox, filters: tuple[Filter, ...]) -> None:
        """Let an inbox have the frames with some ids."""
        self._filters[inbox] = filters
        self.clear()

    def remove(self, inbox: FrameInbox) -> None:
        """Let an inbox have nothing more."""
        self._filters.pop(inbox, None)
        self.clear()

    def fail(self, error: Exception) -> None:
        """Forget all inboxes, and let them raise an error."""
        inboxes, self._filters = tuple(self._filters), {}
        self.clear()
        for inbox in inboxes:
            inbox.fail(error)
