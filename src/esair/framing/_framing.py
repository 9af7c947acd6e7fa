"""What every framing promises, and what bounds its work for garbage."""

from __future__ import annotations

import abc
from typing import Any, Self

from esair.exceptions import BadValueError
from esair.values import check_bytes, check_whole


class Framing(abc.ABC):
    """Cuts a stream of bytes into frames; pure code, one object per opening of a line.

    Whatever the bytes and however they are cut into chunks, the same payloads come
    out, nothing is raised, and what is kept is bounded by the longest frame. Each byte
    ends in a good frame, in `discarded`, or waits for the rest of its frame.

    Args:
        max_length: The longest payload, in bytes.

    Attributes:
        bad_frames: How many frames were thrown away: wrong checksum, wrong length,
            overlong, cut off or not decodable.
        discarded: How many bytes were thrown away because they belonged to no good
            frame.

    Raises:
        ConfigError: A parameter is wrong.
    """

    _made_with: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *args: Any, **keywords: Any) -> Self:
        """Remember the parameters, for `fresh`."""
        made = super().__new__(cls)
        made._made_with = args, keywords
        return made

    def __init__(self, *, max_length: int) -> None:
        self.max_length: int = check_whole("framing", "max_length", max_length, 1)
        self.bad_frames = 0
        self.discarded: int = 0
        self._buffer = bytearray()

    @abc.abstractmethod
    def feed(self, data: bytes) -> list[bytes]:
        """Take the bytes that arrived; return the payloads that are complete now."""

    @abc.abstractmethod
    def encode(self, payload: bytes) -> bytes:
        """Return the bytes on the wire for one payload.

        Raises:
            BadValueError: It is too long, or this framing cannot carry it.
        """

    def fresh(self) -> Self:
        """Return a new one with the same parameters and zero counters."""
        args, keywords = self._made_with
        return type(self)(*args, **keywords)

    def reset(self) -> None:
        """Forget a partial frame: after an opening, or after a silence."""
        self.discarded += len(self._buffer)
        self._buffer.clear()

    def _checked(self, payload: bytes, least: int = 0) -> bytes:
        payload = check_bytes("framing", "payload", payload)
        if not least <= len(payload) <= self.max_length:
            told = f"at most {self.max_length}"
            if len(payload) < least:
                told = f"at least {least}"
            raise BadValueError(
                "framing", "payload", f"expected {told} bytes, not {len(payload)}"
            )
        return payload


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


class Searching(Framing):
    """Looks for the beginning of a frame, place by place; for garbage in few places.

    After a bad frame the search goes on one byte later, so a good frame inside it is
    found. What begins inside a bad frame is not counted as bad once more.
    """

    def __init__(self, *, max_length: int) -> None:
        super().__init__(max_length=max_length)
        self._inside = 0  # how many of the next bytes are in a frame counted as bad
        self._left_out = 0
        self.looks: Looks = Looks()
        """Pays for the places that began no good frame."""

    def reset(self) -> None:
        super().reset()
        self._inside = self._left_out = 0
        self.looks.fill()

    def _begin(self, data: bytes) -> int:
        """Take more bytes; return the place in the buffer to look at first."""
        self._buffer += data
        return self._pass(0, self._left_out)

    def _good(self, at: int, end: int) -> int:
        """Have found a good frame; return the place to look at next."""
        self._inside = max(0, self._inside - (end - at))
        self.looks.earn(end - at)
        return end

    def _bad(self, at: int, end: int, cost: float) -> int:
        """Have found none, or a bad one; return the place to look at next."""
        if not self._inside:
            self.bad_frames += 1
            self._inside = end - at
        return self._pass(at, self.looks.pay(cost) or 1)

    def _pass(self, at: int, step: int) -> int:
        """Go further, as far as bytes have come; the rest is left out when it comes."""
        now = min(step, len(self._buffer) - at)
        self._left_out = step - now
        self._skip(now)
        return at + now

    def _skip(self, count: int) -> None:
        self.discarded += count
        self.looks.earn(count)
        self._inside = max(0, self._inside - count)
