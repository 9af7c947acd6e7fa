"""Messages that end with a delimiter."""

from __future__ import annotations

from typing import Self

from esair.exceptions import BadValueError, ConfigError
from esair.framing._delimited import Delimited


class Lines(Delimited):
    r"""Messages that end with a delimiter, which is no part of the payload.

    A ``\r`` before a ``\n`` delimiter stays in the payload. A message longer than
    *max_length* is thrown away up to its delimiter and counts as one bad frame.

    Args:
        delimiter: What ends a message; a string stands for its UTF-8 bytes.
        max_length: The longest message without its delimiter, in bytes.

    Raises:
        ConfigError: A parameter is wrong.
    """

    def __init__(
        self, *, delimiter: bytes | str = b"\n", max_length: int = 4096
    ) -> None:
        if isinstance(delimiter, str):
            delimiter = delimiter.encode(errors="surrogateescape")
        if not isinstance(delimiter, bytes) or not delimiter:
            raise ConfigError(
                "framing", "delimiter", f"expected some bytes, not {delimiter!r:.80}"
            )
        super().__init__(
            delimiter=delimiter, max_length=max_length, max_frame=max_length
        )

    def feed(self, data: bytes) -> list[bytes]:
        """Take the bytes that arrived; return the messages that are complete now."""
        return self._cut(data)

    def encode(self, payload: bytes) -> bytes:
        """Return the payload and its delimiter.

        Raises:
            BadValueError: It is too long, or the delimiter would end it too early.
        """
        wire = self._checked(payload) + self.delimiter
        if wire.find(self.delimiter) != len(payload):
            raise BadValueError(
                "framing", "payload", f"the delimiter {self.delimiter!r} stands in it"
            )
        return wire

    def fresh(self) -> Self:
        """Return a new one with the same parameters and zero counters."""
        return type(self)(delimiter=self.delimiter, max_length=self.max_length)
