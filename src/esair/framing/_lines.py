"""Messages that end with a delimiter, and no messages at all."""

from __future__ import annotations

from esair.exceptions import BadValueError, ConfigError
from esair.framing._framing import Framing


class Delimited(Framing):
    """The common part of framings whose frames end with a delimiter."""

    def __init__(self, *, delimiter: bytes, max_length: int, max_frame: int) -> None:
        super().__init__(max_length=max_length)
        self.delimiter = delimiter
        self._max_frame = max_frame
        self._skipping = False

    def reset(self) -> None:
        super().reset()
        self._skipping = False

    def _cut(self, data: bytes) -> list[bytes]:
        """Return what stands before each delimiter; what is overlong is counted."""
        buffer, delimiter = self._buffer, self.delimiter
        if not (buffer or self._skipping) and len(data) <= self._max_frame:
            *pieces, rest = bytes(data).split(delimiter)  # as usual: whole messages
            buffer += rest
            return pieces
        tail = len(delimiter) - 1
        searched = max(0, len(buffer) - tail)
        buffer += data
        pieces = []
        if buffer.find(delimiter, searched) >= 0:
            total = len(buffer)
            *pieces, rest = bytes(buffer).split(delimiter)
            buffer[:] = rest
            if self._skipping:
                self._skipping = False
                self.discarded += len(pieces[0]) + len(delimiter)
                del pieces[0]
            if total > self._max_frame and pieces:
                pieces = [piece for piece in pieces if self._fits(piece)]
        # A delimiter that is cut over chunks can begin in the last bytes.
        if self._skipping or len(buffer) > self._max_frame + tail:
            self.bad_frames += not self._skipping
            self._skipping = True
            gone = max(0, len(buffer) - tail)
            self.discarded += gone
            del buffer[:gone]
        return pieces

    def _fits(self, piece: bytes) -> bool:
        if len(piece) <= self._max_frame:
            return True
        self._drop(piece)
        return False

    def _drop(self, piece: bytes) -> None:
        self.bad_frames += 1
        self.discarded += len(piece) + len(self.delimiter)


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


class Raw(Framing):
    """Every chunk is a payload as it comes, cut into bounded pieces.

    The line is free to cut and join what was sent: only the order of bytes holds.

    Args:
        max_length: The longest payload, in bytes.

    Raises:
        ConfigError: A parameter is wrong.
    """

    def __init__(self, *, max_length: int = 4096) -> None:
        super().__init__(max_length=max_length)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the bytes that arrived, in pieces of at most *max_length*."""
        size = self.max_length
        return [bytes(data[at : at + size]) for at in range(0, len(data), size)]

    def encode(self, payload: bytes) -> bytes:
        """Return the payload itself.

        Raises:
            BadValueError: It is empty or too long.
        """
        return self._checked(payload, least=1)
