"""No frames at all."""

from __future__ import annotations

from esair.framing._framing import Framing


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
