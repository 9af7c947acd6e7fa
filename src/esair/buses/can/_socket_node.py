"""A node of SocketCAN, read and written by the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import struct
from collections.abc import Callable, Collection
from typing import Any, Final

import attrs

from esair.buses._stats import BusStats
from esair.buses.can._errors import CanState
from esair.buses.can._frame import Frame, FrameKind
from esair.buses.can._ids import EXTENDED, Filter
from esair.exceptions import (
    BusyError,
    DeviceFaultError,
    DriverStuckError,
    describe,
)
from esair.loop import Arrivals, Executor, clock_of

BATCH = 64
"""How many frames are read at once: a flood must not keep the event loop."""

FILTER_LIMIT = 512
"""How many masks the kernel can choose by (CAN_RAW_FILTER_MAX)."""

_REMOTE: Final = 0x4000_0000
_ERROR: Final = 0x2000_0000
_NUMBER: Final = 0x1FFF_FFFF
_STANDARD: Final = 0x7FF
_HEAD: Final = struct.Struct("=IB")
_CLASSIC: Final = struct.Struct("=IB3x8s")
FD: Final = struct.Struct("=IBB2x64s")
_FD_FRAME: Final = 0x04
_FD_SWITCH: Final = 0x01
_FILTER: Final = struct.Struct("=II")

_SO_RXQ_OVFL: Final = 40  # asm-generic/socket.h; the module socket has no name for it
_SO_TIMESTAMPNS: Final = 35


@attrs.frozen
class Owner:
    """The bus of esair that a node is for."""

    executor: Executor
    stats: BusStats
    received: Callable[[Frame], None]
    gone: Callable[[Exception], None]
    fd: bool
    bitrate_switch: bool


class SocketNode:
    """A node of SocketCAN, read and written by the event loop."""

    def __init__(self, bus: Any, state: CanState, owner: Owner) -> None:
        self.state = state
        self._bus = bus
        self._executor = owner.executor
        self._stats = owner.stats
        self._received = owner.received
        self._gone = owner.gone
        self._loop = asyncio.get_running_loop()
        self._time = clock_of(self._loop)
        self._socket: socket.socket = bus.socket
        self._mtu = FD.size if owner.fd else _CLASSIC.size
        self._fd_flags = _FD_FRAME | (_FD_SWITCH if owner.bitrate_switch else 0)
        self._may_have_missed = 0
        self._missed = 0
        self._closed = False
        self._set_up()
        self._fd = self._socket.fileno()
        self._arrivals = Arrivals.of(self._loop)
        self._loop.add_reader(self._fd, self._readable)

    def _set_up(self) -> None:
        self._socket.setblocking(False)
        if self._socket.family != socket.AF_CAN:
            return
        # Nobody looks at the time stamps that python-can has asked for.
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 0)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self.listen(())

    def listen(self, filters: Collection[Filter] | None) -> None:
        if self._closed or self._socket.family != socket.AF_CAN:
            return
        if filters is None or len(filters) > FILTER_LIMIT:
            packed = _FILTER.pack(0, 0)
        else:  # remote frames too: they are counted
            packed = b"".join(_FILTER.pack(*each) for each in filters)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)

    async def send(self, frame: Frame, timeout: float) -> bool:
        if self._closed:
            raise ConnectionError("the node is closed")
        number, data = frame.id, frame.data
        if frame.extended:
            number |= EXTENDED
        if len(data) > 8:
            packed = FD.pack(number, len(data), self._fd_flags, data)
        else:
            packed = _CLASSIC.pack(number, len(data), data)
        try:
            self._socket.send(packed)
        except BlockingIOError:
            return False
        except OSError as error:
            # "Writable" says nothing about the queue of the interface (python-can#2004).
            if error.errno == errno.ENOBUFS:
                return False
            if error.errno in {errno.EINVAL, errno.EMSGSIZE}:
                raise DeviceFaultError(
                    self._executor.name,
                    f"the interface takes no frame of {len(data)} bytes: "
                    f"{describe(error)}",
                ) from error
            raise
        return True

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._loop.remove_reader(self._fd)
        with contextlib.suppress(DriverStuckError, BusyError):
            await self._executor.call(shut_bus, self._bus, timeout=1.0)

    def _readable(self) -> None:
        with self._arrivals:
            self._read()

    def _read(self) -> None:
        now = self._time()
        read, size, received = self._socket.recv, self._mtu, self._received
        batch = BATCH
        try:
            if self._may_have_missed:
                self._may_have_missed -= 1
                self._take(self._read_and_count(), now)
                batch -= 1
            for _ in range(batch):
                if self._closed:
                    return
                packed = read(size)
                number, length = _HEAD.unpack_from(packed)
                if number <= _STANDARD:
                    received(Frame(number, packed[8 : 8 + length], False, now))
                else:
                    self._take(packed, now)
        except BlockingIOError:
            return
        except Exception as error:  # whatever ends the reading is the loss of the bus
            self._loop.remove_reader(self._fd)
            self._gone(error)
            return
        self._may_have_missed = 2  # the number of frames that had no room comes late

    def _take(self, packed: bytes, now: float) -> None:
        number, length = _HEAD.unpack_from(packed)
        kind = FrameKind.DATA
        if number & _ERROR:
            kind = FrameKind.ERROR
        elif number & _REMOTE:
            kind = FrameKind.REMOTE
        data = b"" if kind is FrameKind.REMOTE else packed[8 : 8 + length]
        extended = bool(number & EXTENDED) and kind is not FrameKind.ERROR
        self._received(Frame(number & _NUMBER, data, extended, now, kind))

    def _read_and_count(self) -> bytes:
        """Read a frame, and how many had no room in the kernel until it came."""
        packed, extra, _, _ = self._socket.recvmsg(self._mtu, socket.CMSG_SPACE(4))
        for level, kind, value in extra:
            if (level, kind) == (socket.SOL_SOCKET, _SO_RXQ_OVFL):
                (total,) = struct.unpack("=I", value)
                self._stats.dropped += (total - self._missed) & 0xFFFF_FFFF
                self._missed = total
        return packed


def shut_bus(bus: Any) -> None:
    with contextlib.suppress(Exception):  # whatever it says, nobody can act on it
        bus.shutdown()
