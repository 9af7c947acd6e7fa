"""Messages between a robot's process and a child: whole, bounded, plain data.

A message is a list of items, coded by `esair.codec`. What does not fit into a packet goes
as a file in memory beside it, so that no message is sent in part and nobody waits for room.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import socket
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

from esair.codec import LIMIT, CodecError, Kinds, decode, encode
from esair.exceptions import BadValueError, EsairError, describe, told_traceback
from esair.loop import raisable

CALLS: Final = 64
"""How many calls of one side may be in flight."""

ITEMS: Final = 16 * CALLS
"""How many items a message may have."""

PACKET: Final = 1 << 16
"""What is larger goes as a file in memory, in bytes."""

MESSAGE: Final = 8 * LIMIT
"""How many bytes all values of one message may have."""

NOTE: Final = 4000
"""How many characters of a traceback cross with an error."""

_FILE: Final = b"\0"
_PLAIN: Final = Kinds()


class Item(NamedTuple):
    """One thing that is told: a call, its end, or that it shall end.

    Attributes:
        op: ``call``, ``cancel``, ``done`` or ``fail``.
        number: That of the call, given by the side that calls.
        verb: What is called.
        data: Its arguments, its value or its error, coded.
    """

    op: str
    number: int
    verb: str
    data: bytes


class Wire:
    """One end of the socket between a robot's process and a child."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def fileno(self) -> int:
        return self._end.fileno()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)  # a thread may wait for it
        self._end.close()

    def send(self, head: Any, items: Iterable[Item]) -> None:
        """Send a message.

        Raises:
            OSError: The other end is gone.
        """
        parts = [tuple(each) for each in items]
        data = encode((head, parts), _PLAIN, MESSAGE + PACKET)
        if len(data) <= PACKET:
            self._end.send(data)
            return
        file = os.memfd_create("esair-message", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            view = memoryview(data)
            while view:
                view = view[os.write(file, view) :]
            socket.send_fds(self._end, [_FILE], [file])
        finally:
            os.close(file)

    def receive(self) -> tuple[Any, list[Item]] | None:
        """Return the next message; None if the other end is gone.

        Raises:
            BlockingIOError: There is none, and the socket does not wait.
            CodecError: It is no message.
        """
        data, files, _, _ = socket.recv_fds(
            self._end, PACKET, 4, socket.MSG_CMSG_CLOEXEC
        )
        try:
            if data == _FILE and files:
                data = _contents(files[0])
        finally:
            for file in files:
                os.close(file)
        if not data:
            return None
        match decode(data, _PLAIN, MESSAGE + PACKET):
            case (head, list(parts)) if all(_is_item(each) for each in parts):
                if len(parts) > ITEMS:
                    raise CodecError(f"it has {len(parts)} items")
                return head, [Item(*each) for each in parts]
        raise CodecError("it is no message")


def _is_item(part: Any) -> bool:
    return type(part) is tuple and tuple(map(type, part)) == (str, int, str, bytes)


def _contents(file: int) -> bytes:
    """Read a file in memory: another kind of file could keep its reader waiting."""
    fcntl.fcntl(file, fcntl.F_GET_SEALS)
    size = os.fstat(file).st_size
    if size > MESSAGE + PACKET:
        raise CodecError(f"it has {size} bytes")
    return os.pread(file, size, 0)


class Values:
    """How the values of one component are coded.

    Args:
        name: Of the component, for errors.
        kinds: The classes that may cross.
    """

    def __init__(self, name: str, kinds: Kinds) -> None:
        self.name = name
        self.kinds = kinds

    def pack(self, verb: str, value: Any) -> bytes:
        """Return a value as bytes.

        Raises:
            BadValueError: It cannot cross: which field of it, and why.
        """
        try:
            return encode(value, self.kinds)
        except CodecError as error:
            what = f"between processes {error}"
            raise BadValueError(self.name, verb, what) from None

    def pack_error(self, error: BaseException) -> bytes:
        """Return an error, and where it was raised, as bytes."""
        is_plain = isinstance(error, EsairError | asyncio.CancelledError)
        wanted = error if is_plain else raisable(error)
        where = "" if is_plain else told_traceback(error)[-NOTE:]
        try:
            return encode((wanted, where), self.kinds)
        except CodecError:  # what it holds is no plain data
            return encode((RuntimeError(describe(error)), where), self.kinds)

    def unpack(self, data: bytes) -> Any:
        return decode(data, self.kinds)

    def unpack_error(self, data: bytes) -> BaseException:
        """Return an error; where it was raised is a note of it."""
        match decode(data, self.kinds):
            case (BaseException() as error, str(where)):
                if where:
                    error.add_note(f"in the process of {self.name}:\n{where}")
                return error
        raise CodecError("it is no error")
