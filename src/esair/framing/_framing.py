"""What every framing promises, and the checks of its parameters."""

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
