"""What every framing promises, and the checks of its parameters."""

from __future__ import annotations

import abc
from typing import Self

from esair.exceptions import BadValueError, ConfigError


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

    def __init__(self, *, max_length: int) -> None:
        if type(max_length) is not int or max_length < 1:
            raise ConfigError(
                "framing",
                "max_length",
                f"expected a number of bytes from 1, not {max_length!r:.80}",
            )
        self.max_length = max_length
        self.bad_frames = 0
        self.discarded = 0
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

    @abc.abstractmethod
    def fresh(self) -> Self:
        """Return a new one with the same parameters and zero counters."""

    def reset(self) -> None:
        """Forget a partial frame: after an opening, or after a silence."""
        self.discarded += len(self._buffer)
        self._buffer.clear()

    def _checked(self, payload: bytes) -> bytes:
        if not isinstance(payload, bytes | bytearray | memoryview):
            raise BadValueError(
                "framing", "payload", f"expected bytes, not {payload!r:.80}"
            )
        payload = bytes(payload)
        if len(payload) > self.max_length:
            raise BadValueError(
                "framing",
                "payload",
                f"expected at most {self.max_length} bytes, not {len(payload)}",
            )
        return payload
