"""Frames of any bytes between zeros. The only module that knows the package cobs."""

from __future__ import annotations

import re
from collections.abc import Iterator

from esair.exceptions import ConfigError
from esair.framing._framing import Looks
from esair.framing._lines import Delimited

_NO_ZERO = re.compile(rb"[^\0]")


class Cobs(Delimited):
    """Frames that end with a zero byte, stuffed so that no other byte is zero.

    There is no checksum in it: a damaged byte can give a wrong payload, so put a
    checksum into the payload. Nothing between two zeros is no frame. Needs the package
    ``cobs``: ``pip install 'esair[cobs]'``.

    The work for garbage is bounded: after 2048 frames that cannot be decoded, one place in
    128 bytes is looked at until good ones have come again.

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
                "framing", "cobs", "needs the package cobs: pip install 'esair[cobs]'"
            ) from None
        super().__init__(delimiter=b"\0", max_length=max_length, max_frame=0)
        self._max_frame = cobs.max_encoded_length(max_length)
        self._codec = cobs
        self._leave = 0
        self.looks: Looks = Looks()
        """Pays for the frames that cannot be decoded."""

    def feed(self, data: bytes) -> list[bytes]:
        # Of so many bytes not all frames can be wrong before the reserve is used up.
        if not self._leave and self.looks.credit > len(data):
            cut = self._cut(data)
            found = [self._decoded(piece) for piece in cut if piece]
            self.discarded += len(cut) - len(found)
            self.looks.earn(len(data))
        else:
            found = list(self._search(data))
        return [payload for payload in found if payload is not None]

    def reset(self) -> None:
        super().reset()
        self._leave = 0
        self.looks.fill()

    def _search(self, data: bytes) -> Iterator[bytes | None]:
        """Go on behind what is left out, from one place to the next."""
        at = 0
        while at < len(data):
            if self._leave:
                left = min(self._leave, len(data) - at)
                self._leave -= left
                self.discarded += left + len(self._buffer)
                self._buffer.clear()
                self._skipping = True
                until = at + left
            elif data[at]:
                until = data.find(0, at) + 1 or len(data)
                for piece in self._cut(data[at:until]):
                    yield self._decoded(piece)
            else:  # many of them cost no more than one
                found = _NO_ZERO.search(data, at)
                until = found.start() if found else len(data)
                pieces = self._cut(data[at : at + 1])
                self.discarded += until - at - 1 + (pieces == [b""])
                for piece in filter(None, pieces):
                    yield self._decoded(piece)
            self.looks.earn(until - at)
            at = until

    def _decoded(self, piece: bytes) -> bytes | None:
        try:
            payload: bytes = self._codec.decode(piece)
        except self._codec.DecodeError:
            pass
        else:
            if len(payload) <= self.max_length:
                return payload
        self._drop(piece)
        self._leave += self.looks.pay()
        return None

    def encode(self, payload: bytes) -> bytes:
        """Return the stuffed payload and a zero.

        Raises:
            BadValueError: It is too long.
        """
        encoded: bytes = self._codec.encode(self._checked(payload))
        return encoded + b"\0"
