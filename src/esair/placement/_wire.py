"""Messages between a robot's process and a child: whole, bounded, plain data.

A message is a kind, a moment and items, whose values `esair.codec` has coded. What does not
fit into a packet goes as a file in memory beside it, so that no message is sent in part and
nobody waits for room.
Both sides call, answer and cancel in the same way (`Exchange`).
"""

from __future__ import annotations

import array
import asyncio
import contextlib
import fcntl
import os
import socket
import struct
from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple

from esair import messages
from esair.codec import LIMIT, CodecError, Kinds, decode, encode
from esair.connections import LastCommand
from esair.exceptions import (
    BadValueError,
    BusyError,
    EsairError,
    describe,
    line_of,
    told_traceback,
)
from esair.loop import Owner, raisable

CALLS: Final = 64
"""How many calls of one side may be in flight."""

ITEMS: Final = 16 * CALLS
"""How many items a message may have."""

PACKET: Final = 1 << 16
"""What is larger goes as a file in memory, in bytes."""

MESSAGE: Final = LIMIT
"""How many bytes all values of one message may have: its reader works so long at once."""

NOTE: Final = 4000
"""How many characters cross of a traceback, and of what an error says that is too large."""

RECORD: Final = "\x1e"
"""What a line begins with that is a record of the log."""

ALWAYS: Final = [
    *(each for each in vars(messages).values() if isinstance(each, type)),
    LastCommand,
]
"""The classes that cross whatever a component declares."""


class Op:
    """What an item says of a call, and with what kind of message it goes.

    A child is idle until a moment, or for ever (`NEVER`); else it goes on at once: its turn
    goes on, or, of a sync, its loop does not. A tick asks what time it is. A still one is
    idle, and each of its tasks waits for the end of a call.
    """

    CALL, CANCEL, DONE, FAIL = b"c", b"x", b"d", b"f"
    NEWS, WITHDRAWN = b"n", b"w"  # of a call before its end; of a request
    GO, IDLE, STILL, TURN, SYNC, TICK = b"g", b"i", b"q", b"t", b"s", b"k"


AWAITED: Final = {"read", "reading", "write", "configure", "operate"}
CALLED: Final = {"history", "why", "release"}
ASKED: Final = {"newest", "settings", "state", "max_age"}
"""What of a port in the robot is there in a child, too; some of it is awaited there."""

_FILE: Final = b"\0"
_HEAD: Final = struct.Struct("<cd")
_ITEM: Final = struct.Struct("<cqqddHI")
_open, _OPENED = _ITEM.unpack_from, _ITEM.size  # hot
_FILES: Final = socket.CMSG_SPACE(4 * 4)
_CUT: Final = int(socket.MSG_TRUNC)  # hot
_CLOSES: Final = int(socket.MSG_CMSG_CLOEXEC)  # hot
_new = tuple.__new__  # hot

End = Callable[[Any, BaseException | None], object]
"""What is called with the value or the error of a call."""


class Item(NamedTuple):
    """One thing that is told: a call, its end, or that it shall end.

    Attributes:
        op: One of `Op`.
        number: That of the call, given by the side that calls.
        verb: What is called; after a blank the port that is meant.
        data: Its arguments, if it has any, its value or its error, coded.
        scope: For which call of the robot a child makes this one.
        worked: How long the child had worked when it made this call, in seconds.
        ended: When what measures has ended, on the computer's monotonic clock; 0 of all
            else.
    """

    op: bytes
    number: int
    verb: str
    data: bytes
    scope: int = 0
    worked: float = 0.0
    ended: float = 0.0


class Wire:
    """One end of the socket between a robot's process and a child."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self.size = 0
        """How many bytes the message had that came last."""

    def fileno(self) -> int:
        return self._end.fileno()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)  # a thread may wait for it
        self._end.close()

    def send(self, kind: bytes, moment: float, items: Iterable[Item] = ()) -> None:
        """Send a message.

        Raises:
            OSError: The other end is gone.
        """
        parts = [_HEAD.pack(kind, moment)]
        for op, number, verb, coded, scope, worked, ended in items:
            name = verb.encode()
            head = _ITEM.pack(op, number, scope, worked, ended, len(name), len(coded))
            parts += head, name, coded
        data = b"".join(parts)
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

    def receive(self) -> tuple[bytes, float, list[Item]] | None:
        """Return the next message, as it is sent; None if the other end is gone.

        Raises:
            BlockingIOError: There is none, and the socket does not wait.
            CodecError: It is no message.
        """
        data, beside, flags, _ = self._end.recvmsg(PACKET, _FILES, _CLOSES)
        if beside:
            data = _contents(data, beside)
        if not data:
            return None
        if flags & _CUT:
            raise CodecError("it is no message")
        try:
            kind, moment = _HEAD.unpack_from(data)
            items: list[Item] = []
            place, end = _HEAD.size, len(data)
            self.size = end
            while place < end and len(items) <= ITEMS:
                op, number, scope, worked, ended, name, size = _open(data, place)
                begin = place + _OPENED
                value = begin + name
                place = value + size
                verb, coded = data[begin:value].decode(), data[value:place]
                item = op, number, verb, coded, scope, worked, ended
                items.append(_new(Item, item))
        except (struct.error, UnicodeDecodeError):
            raise CodecError("it is no message") from None
        if place != end or len(items) > ITEMS:
            raise CodecError("it is no message")
        return kind, moment, items


def _contents(data: bytes, beside: list[tuple[int, int, bytes]]) -> bytes:
    """Read a file in memory: another kind of file could keep its reader waiting."""
    files = array.array("i")
    for _, _, each in beside:
        files.frombytes(each[: len(each) // 4 * 4])
    try:
        if data != _FILE or not files:
            return data
        fcntl.fcntl(files[0], fcntl.F_GET_SEALS)
        size = os.fstat(files[0]).st_size
        if size > MESSAGE + PACKET:
            raise CodecError(f"it has {size} bytes")
        return os.pread(files[0], size, 0)
    finally:
        for file in files:
            os.close(file)


def packed(name: str, kinds: Kinds, verb: str, value: Any) -> bytes:
    """Return a value as bytes.

    Raises:
        BadValueError: It cannot cross: which field of it, and why.
    """
    try:
        return encode(value, kinds)
    except CodecError as error:
        told = f"between processes {error}; placement = 'task' has no such bound"
        raise BadValueError(name, verb, told) from None


class Exchange:
    """The calls of one side, and what it does for those of the other.

    Args:
        name: Of the component, for errors.
        kinds: The classes that may cross.
        loop: Where it works.
        owner: Of the tasks in which it works on calls of the other side.
    """

    def __init__(self, name: str, kinds: Kinds, loop: Any, owner: Owner) -> None:
        self.name = name
        self.who = "it"
        """What errors of its code call it that say nothing of a driver or a reaction."""
        self.kinds = kinds
        self.loop = loop
        self.owner = owner
        self.queue: list[Item] = []
        """What the other side is told next."""
        self.calls: dict[int, End] = {}
        """What hears of the ends of the own calls, by their number."""
        self.newest = 0
        """The number of the newest own call."""
        self.tasks: dict[int, Any] = {}
        """What works on calls of the other side, by their number."""

    def ask(
        self,
        end: End,
        verb: str,
        args: tuple[Any, ...],
        options: dict[str, Any],
        scope: int = 0,
        worked: float = 0.0,
    ) -> int:
        """Call the other side; return the number of the call.

        Raises:
            BadValueError: What is asked cannot cross.
            BusyError: Too many calls are in flight.
        """
        if len(self.calls) >= CALLS:
            raise BusyError(self.name, "number of calls between its processes", CALLS)
        data = b""
        if args or options:
            data = self.pack(verb, (options or None, *args))
        self.newest = number = self.newest + 1
        self.calls[number] = end
        self.tell(_new(Item, (Op.CALL, number, verb, data, scope, worked, 0.0)))
        return number

    def tell(self, item: Item) -> None:
        """Tell the other side something with the next message."""
        self.queue.append(item)

    def answer(
        self, number: int, value: Any, error: BaseException | None, ended: float = 0.0
    ) -> None:
        """Tell the other side the end of its call."""
        if error is None:
            try:
                data = b"" if value is None else self.pack("answer", value)
                self.tell(_new(Item, (Op.DONE, number, "", data, 0, 0.0, ended)))
                return
            except Exception as unfit:
                error = unfit
        self.tell(Item(Op.FAIL, number, "", self.pack_error(error)))

    def over(
        self,
        number: int,
        task: Any,
        value: Any,
        error: BaseException | None,
        ended: float = 0.0,
    ) -> None:
        """The work on a call of the other side has ended."""
        self.owner.leave(task)
        if self.tasks.pop(number, None) is not None:
            self.answer(number, value, error, ended)

    def opened(self, item: Item) -> tuple[Any, BaseException | None]:
        """Return the value of an item, or the error that it is, or why it is none."""
        try:
            if item.op == Op.FAIL:
                return None, self.unpack_error(item.data)
            return decode(item.data, self.kinds) if item.data else None, None  # hot
        except CodecError as error:
            return None, BadValueError(self.name, item.verb or "answer", str(error))

    def ended(self, number: int, value: Any, error: BaseException | None) -> None:
        """Take the end of a call of its own."""
        if (end := self.calls.pop(number, None)) is not None:
            end(value, error)

    def message(self) -> list[Item]:
        """Take of the queue what goes into one message; the rest goes later."""
        taken, self.queue = self.queue, []
        if len(taken) < 2:
            return taken
        size = 0
        for count, each in enumerate(taken):
            size += len(each.data)
            if count and (size > MESSAGE or count == ITEMS):
                self.queue = taken[count:]
                return taken[:count]
        return taken

    def pack(self, verb: str, value: Any) -> bytes:
        return packed(self.name, self.kinds, verb, value)

    def unpack(self, data: bytes) -> Any:
        return decode(data, self.kinds)

    def pack_error(self, error: BaseException) -> bytes:
        """Return an error, where it was raised, and by which line, as bytes."""
        is_plain = isinstance(error, EsairError | asyncio.CancelledError)
        place = "" if is_plain else told_traceback(error)[-NOTE:], line_of(error)[:NOTE]
        if isinstance(error, StopIteration):  # no future takes it
            error = raisable(error, self.who)
        try:
            return encode((error, *place), self.kinds)
        except CodecError:  # what it holds is no plain data, or too much
            told = RuntimeError(describe(error)[:NOTE])
            return encode((told, *place), self.kinds)

    def unpack_error(self, data: bytes) -> BaseException:
        """Return an error; where it was raised is a note of it."""
        match decode(data, self.kinds):
            case (BaseException() as error, str(where), str(line)):
                vars(error)["_line"] = line
                told = where and f"in the process of {self.name}:\n{where}"
                for note in told.splitlines():  # each a line of its own where shown
                    error.add_note(note)
                return error
        raise CodecError("it is no error")


def make(recipe: dict[str, Any], kind: Any) -> Any:
    """Make a component of its class, and what that is given."""
    if recipe["options"] is None:  # of ESAIR MIN, whose classes keep what they get
        made = kind.__new__(kind)
        vars(made).update(recipe["fields"])
        return made
    return kind(*recipe["args"], **recipe["options"])
