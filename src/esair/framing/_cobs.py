"""Frames of any bytes between zeros. The only module that knows the package cobs."""

from __future__ import annotations

from typing import Self

from esair.exceptions import ConfigError
from esair.framing._delimited import Delimited


class Cobs(Delimited):
    """Frames that end with a zero byte, stuffed so that no other byte is zero.

    There is no checksum in it: a damaged byte can give a wrong payload, so put a
    checksum into the payload. Nothing between two zeros is no frame. Needs the package
    ``cobs``: ``pip install 'esair[cobs]'``.

    Source: S. Cheshire and M. Baker, Consistent Overhead Byte Stuffing, 1999.

    Args:
        max_length: The longest payload, in bytes.

    Raises:
        ConfigError: A parameter is wrong, or the package is not installed.
    """

    def __init__(self, *, max_length: int = 1024) -> None:
        try:
            from cobs import cobs
        except ImportError:
            raise ConfigError(
                "framing",
                "cobs",
                "needs the package cobs: pip install 'esair[cobs]'",
            ) from None
        super().__init__(delimiter=b"\0", max_length=max_length, max_frame=0)
        self._max_frame = cobs.max_encoded_length(max_length)
        self._codec = cobs

    def feed(self, data: bytes) -> list[bytes]:
        """Take the bytes that arrived; return the payloads that are complete now."""
        payloads: list[bytes] = []
        cut = self._cut(data)
        pieces = list(filter(None, cut))
        self.discarded += len(cut) - len(pieces)
        for piece in pieces:
            try:
                payload: bytes = self._codec.decode(piece)
            except self._codec.DecodeError:
                self._drop(piece)
                continue
            if len(payload) > self.max_length:
                self._drop(piece)
            else:
                payloads.append(payload)
        return payloads

    def encode(self, payload: bytes) -> bytes:
        """Return the stuffed payload and a zero.

        Raises:
            BadValueError: It is too long.
        """
        encoded: bytes = self._codec.encode(self._checked(payload))
        return encoded + b"\0"

    def fresh(self) -> Self:
        """Return a new one with the same parameters and zero counters."""
        return type(self)(max_length=self.max_length)
