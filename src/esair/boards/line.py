"""The serial line of a board: the one writer and reader of it, and neither ever waits.

A computer that reads no more would hold up each step, on USB by half a second. So what is
said goes into one buffer, made once, and from there in small pieces as the port takes
them; what does not fit is left out whole, and counted.
"""

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

PIECE = 16
"""Bytes that are handed to the port at once. All that is said is filled up to a multiple
of it: a port that takes one byte then takes a whole piece, and never waits for room."""

AT_ONCE = 128
"""Bytes of a step at most: what a serial port holds by itself."""


def take_ctrl_c(byte: int) -> None:
    """Let a byte be Ctrl-C; -1 for none."""
    try:
        import micropython

        micropython.kbd_intr(byte)  # type: ignore[attr-defined]
    except (ImportError, AttributeError):
        pass


class Line:
    """The standard input and output of a board.

    Args:
        most: How many bytes it may send in one step.
        size: How many bytes may wait.
        streams: What tells that a byte has come, what reads it, what tells that some
            can go, and what writes them; those of the board unless given.

    Attributes:
        lost: How many lines or messages were left out, as there was no room.
    """

    def __init__(
        self, most: int = AT_ONCE, size: int = 768, streams: "Any" = None
    ) -> None:
        self.buffer: bytearray = bytearray(size)
        self.first: int = 0
        self.used: int = 0
        self.lost: int = 0
        self.most: int = max(PIECE, min(AT_ONCE, most))
        self.tells: bool = False  # whether this port tells when it takes something
        self.one: bytearray = bytearray(1)
        self.came, self.read, self.takes, self.write = streams or _streams()

    def byte(self) -> int:
        """Return the next byte that has come; -1 for none."""
        for _ in self.came(0):
            if self.read(self.one):
                return self.one[0]
        return -1

    def say(self, text: str) -> None:
        """Say a line of text."""
        data = text.encode()
        count = len(data) + 2
        count += -count % PIECE
        if self.has_room(count):
            at = self.used
            for each in data:
                self.buffer[at] = each
                at += 1
            self.used += count
            while at < self.used - 2:
                self.buffer[at] = 32
                at += 1
            self.buffer[at] = 13
            self.buffer[at + 1] = 10

    def has_room(self, count: int) -> bool:
        """Tell whether so many bytes more may wait; count what is left out."""
        if self.used + count > len(self.buffer):
            self.lost += 1
            return False
        return True

    def flush(self) -> None:
        """Hand on what the port takes now."""
        if not self.used:
            return
        at, end = self.first, min(self.used, self.first + self.most)
        try:
            while at < end:
                for _ in self.takes(0):
                    self.tells = True
                    break
                else:
                    if self.tells:
                        break
                self.write(self.buffer, at, PIECE)
                at += PIECE
        except OSError:  # nobody is there
            at = self.used
            self.lost += 1
        if at >= self.used:
            at = self.used = 0
        self.first = at


def _streams() -> "tuple[Any, ...]":
    """Return what tells that something has come, and reads it; and so for what goes.

    None of it waits.
    """
    try:
        if sys.implementation.name == "cpython":
            from esair.boards.stand_in import streams

            return streams()
    except ImportError:
        pass
    import select

    came: Any = select.poll()
    takes: Any = select.poll()
    came.register(sys.stdin, select.POLLIN)
    takes.register(sys.stdout, select.POLLOUT)
    stdin, stdout = sys.stdin.buffer, sys.stdout.buffer
    return came.ipoll, stdin.readinto, takes.ipoll, stdout.write  # type: ignore[union-attr]
