"""Nodes of python-can. The only module that knows the package.

Where the interface is SocketCAN the event loop watches the socket, and frames are read
and written here: python-can makes two more system calls for each, fails on descriptors
above 1023, and takes four times as long. Every other interface gets a thread that reads,
and sends on the executor of the bus, because its ``send`` may block. Neither is python-can's
own Notifier, which goes silent after an error (python-can#1865).
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import errno
import socket
import struct
import threading
from collections.abc import Callable, Collection
from typing import Any, Final

from esair.buses._stats import BusStats
from esair.buses.can import _interface as _can_interface
from esair.buses.can._errors import CanState
from esair.buses.can._frame import EXTENDED, Frame, FrameKind, FrameLink, FrameOpener
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DriverStuckError,
    describe,
)
from esair.loop import CallRefused, Executor, clock_of

OPEN_TIMEOUT = 5.0
"""How long opening an interface may take, in seconds."""

POLL_PERIOD = 0.1
"""How often a reading thread looks whether it should end, in seconds."""

BATCH = 64
"""How many frames are read at once: a flood must not keep the event loop."""

FILTER_LIMIT = 512
"""How many ids the kernel can choose by (CAN_RAW_FILTER_MAX)."""

HEARTBEAT = 1.0
"""How often the reading thread must show that it is alive, in seconds."""

MISSED_BEATS = 3
"""After how many heartbeats without a sign of it the reading thread is given up."""

_OWN_ERRORS: Final = frozenset(
    {"ixxat", "kvaser", "neovi", "nican", "nixnet", "pcan", "usb2can", "vector"}
)
"""Interfaces whose error frames have a form of their own, not that of the kernel."""

_REMOTE: Final = 0x4000_0000
_ERROR: Final = 0x2000_0000
_NUMBER: Final = 0x1FFF_FFFF
_STANDARD: Final = 0x7FF

_HEAD: Final = struct.Struct("=IB")
_CLASSIC: Final = struct.Struct("=IB3x8s")
_FD: Final = struct.Struct("=IBB2x64s")
_FD_FRAME: Final = 0x04
_FD_SWITCH: Final = 0x01
_FILTER: Final = struct.Struct("=II")

_SO_RXQ_OVFL: Final = 40  # asm-generic/socket.h; the module socket has no name for it
_SO_TIMESTAMPNS: Final = 35


def python_can(
    interface: str,
    channel: str,
    *,
    executor: Executor,
    stats: BusStats | None = None,
    fd: bool = False,
    bitrate_switch: bool = False,
    **options: Any,
) -> FrameOpener:
    """Return what opens a node of one of python-can's interfaces.

    Args:
        interface: What python-can calls it.
        channel: Which of them.
        executor: The thread for the calls that may block; has the name of the bus.
        stats: Where frames are counted that were thrown away.
        fd: Whether frames may have up to 64 bytes.
        bitrate_switch: Whether the data of long ones are sent faster.
        **options: Further options of ``can.Bus``.
    """
    if fd:
        options = {**options, "fd": True}

    async def opener(
        received: Callable[[Frame], None], gone: Callable[[Exception], None]
    ) -> FrameLink:
        opening = _Opening(executor.name, interface, channel, options)
        try:
            bus, state = await executor.call(opening.make, timeout=OPEN_TIMEOUT)
        except BaseException:
            opening.abandon()
            raise
        counts = stats or BusStats()
        try:
            if state is not None:
                return _SocketNode(
                    bus,
                    state,
                    executor,
                    counts,
                    received,
                    gone,
                    fd=fd,
                    bitrate_switch=bitrate_switch,
                )
            return _ThreadNode(
                bus,
                executor,
                counts,
                received,
                gone,
                fd=fd,
                bitrate_switch=bitrate_switch,
                echoes=bool(options.get("receive_own_messages")),
                decodes_errors=interface not in _OWN_ERRORS,
            )
        except BaseException:
            opening.abandon()
            raise

    return opener


class _Opening:
    """One try to open an interface, on the executor."""

    def __init__(
        self, owner: str, interface: str, channel: str, options: dict[str, Any]
    ) -> None:
        self._owner = owner
        self._interface = interface
        self._channel = channel
        self._options = options
        self._bus: Any = None
        self._abandoned = False
        self._deciding = threading.Lock()

    def abandon(self) -> None:
        """Shut a bus that nobody waits for any more, also one that opens later."""
        with self._deciding:
            self._abandoned = True
            bus, self._bus = self._bus, None
        if bus is not None:  # the executor may be stuck
            threading.Thread(target=_shut, args=(bus,), daemon=True).start()

    def make(self) -> tuple[Any, CanState | None]:
        """Open the interface; blocks.

        Returns:
            The bus of python-can, and the state of its controller if it is SocketCAN.
        """
        bus = self._open()
        try:
            state = self._state(bus)
            with self._deciding:
                if self._abandoned:
                    raise ConnectionError("it took too long")
                self._bus = bus
        except BaseException:
            _shut(bus)
            raise
        return bus, state

    def _open(self) -> Any:
        try:
            import can
        except ImportError as error:
            raise ConfigError(
                self._owner, "interface", f"python-can is needed: {describe(error)}"
            ) from error
        if self._interface == "socketcan":
            # SocketcanBus forgets its descriptor when it cannot bind it.
            self._check(_can_interface.look_up(self._channel))
        try:
            return can.Bus(
                channel=self._channel, interface=self._interface, **self._options
            )
        except can.CanInterfaceNotImplementedError as error:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            raise ConfigError(
                self._owner,
                "interface",
                f"{self._interface!r} cannot be used: {describe(error)}; "
                f"python-can knows {known}",
            ) from error
        except ImportError as error:
            raise ConfigError(
                self._owner,
                "interface",
                f"{self._interface!r} needs another package: {describe(error)}",
            ) from error
        except (TypeError, ValueError) as error:
            if isinstance(error, OSError):
                raise
            raise ConfigError(
                self._owner,
                "options",
                f"python-can's {self._interface!r} does not take them: {describe(error)}",
            ) from error
        except can.CanError as error:
            raise ConnectionError(describe(error)) from error

    def _state(self, bus: Any) -> CanState | None:
        if not _is_socket_can(bus):
            return None
        if bus.socket.family != socket.AF_CAN:  # a stand-in without the kernel's CAN
            return CanState.ACTIVE
        found = _can_interface.look_up(self._channel)
        self._check(found)
        return found.state

    def _check(self, found: _can_interface.Interface) -> None:
        if not found.is_up:
            raise ConnectionError(
                f"the interface is down: ip link set {self._channel} up"
            )
        if self._options.get("fd") and found.mtu < _FD.size:
            raise ConfigError(
                self._owner,
                "fd",
                f"{self._channel} is not set up for CAN FD: "
                f"ip link set {self._channel} type can ... dbitrate ... fd on",
            )


def _is_socket_can(bus: Any) -> bool:
    try:
        from can.interfaces.socketcan import SocketcanBus
    except ImportError:  # not on this system
        return False
    return isinstance(bus, SocketcanBus)


class _SocketNode:
    """A node of SocketCAN, read and written by the event loop."""

    def __init__(
        self,
        bus: Any,
        state: CanState,
        executor: Executor,
        stats: BusStats,
        received: Callable[[Frame], None],
        gone: Callable[[Exception], None],
        *,
        fd: bool,
        bitrate_switch: bool,
    ) -> None:
        self.state = state
        self._bus = bus
        self._executor = executor
        self._stats = stats
        self._received = received
        self._gone = gone
        self._loop = asyncio.get_running_loop()
        self._time = clock_of(self._loop)
        self._socket: socket.socket = bus.socket
        self._mtu = _FD.size if fd else _CLASSIC.size
        self._fd_flags = _FD_FRAME | (_FD_SWITCH if bitrate_switch else 0)
        self._may_have_missed = 0
        self._missed = 0
        self._closed = False
        self._set_up()
        self._fd = self._socket.fileno()
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

    def listen(self, keys: Collection[int] | None) -> None:
        if self._closed or self._socket.family != socket.AF_CAN:
            return
        if keys is None or len(keys) > FILTER_LIMIT:
            filters = _FILTER.pack(0, 0)
        else:  # remote frames too: they are counted
            filters = b"".join(
                _FILTER.pack(key, EXTENDED | (_NUMBER if key & EXTENDED else _STANDARD))
                for key in keys
            )
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)

    async def send(self, frame: Frame, timeout: float) -> bool:
        if self._closed:
            raise ConnectionError("the node is closed")
        number, data = frame.id, frame.data
        if frame.extended:
            number |= EXTENDED
        if len(data) > 8:
            packed = _FD.pack(number, len(data), self._fd_flags, data)
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
            await self._executor.call(_shut, self._bus, timeout=1.0)

    def _readable(self) -> None:
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


class _ThreadNode:
    """A node of an interface without a socket: one thread reads, the executor sends."""

    inbox_limit = 1024
    state = CanState.ACTIVE

    def __init__(
        self,
        bus: Any,
        executor: Executor,
        stats: BusStats,
        received: Callable[[Frame], None],
        gone: Callable[[Exception], None],
        *,
        fd: bool,
        bitrate_switch: bool,
        echoes: bool,
        decodes_errors: bool,
    ) -> None:
        import can

        self._can = can
        self._bus = bus
        # can.BusABC.recv measures its time-out by the wall clock: set back by an hour,
        # it waits for an hour. What it calls does not.
        own_recv = type(bus).recv is not can.BusABC.recv
        self._recv = bus.recv if own_recv else bus._recv_internal  # noqa: SLF001
        self._own_recv = own_recv
        self._executor = executor
        self._stats = stats
        self._received = received
        self._gone = gone
        self._fd = fd
        self._bitrate_switch = bitrate_switch
        self._echoes = echoes
        self._decodes_errors = decodes_errors
        self._loop = asyncio.get_running_loop()
        self._time = clock_of(self._loop)
        self._closed = False
        self._wanted: frozenset[int] | None = frozenset()
        self._incoming: collections.deque[Frame] = collections.deque(
            maxlen=self.inbox_limit
        )
        self._announced = False
        self._counted = threading.Lock()
        self._unheard = self._dropped = self._bad = 0
        self._beats = 0
        self._missed_beats = 0
        self._reader = threading.Thread(
            target=self._read, name=f"esair-{executor.name}-reader", daemon=True
        )
        self._reader.start()
        self._watch = self._loop.call_later(HEARTBEAT, self._check, self._beats)

    def listen(self, keys: Collection[int] | None) -> None:
        self._wanted = None if keys is None else frozenset(keys)

    async def send(self, frame: Frame, timeout: float) -> bool:
        if self._closed:
            raise ConnectionError("the node is closed")
        try:
            # With a guard, a frame whose time is over does not leave late.
            return await self._executor.call(
                self._send, frame, timeout=timeout, guard=lambda: not self._closed
            )
        except CallRefused:
            raise ConnectionError("the node is closed") from None

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._watch.cancel()
        self._count()
        with contextlib.suppress(DriverStuckError, BusyError):
            await self._executor.call(self._end, timeout=1.0)

    def _send(self, frame: Frame) -> bool:
        message = self._can.Message(
            arbitration_id=frame.id,
            data=frame.data,
            is_extended_id=frame.extended,
            is_fd=len(frame.data) > 8,
            bitrate_switch=self._bitrate_switch and len(frame.data) > 8,
        )
        try:
            self._bus.send(message, timeout=0)
        except self._can.CanError as error:
            # ENOBUFS has a number; "Transmit buffer full" and a full queue have none.
            if error.error_code in {None, errno.EAGAIN, errno.ENOBUFS}:
                return False
            raise ConnectionError(describe(error)) from error
        return True

    def _read(self) -> None:
        while not self._closed:
            self._beats += 1
            try:
                message = self._recv(timeout=POLL_PERIOD)
                if not self._own_recv:
                    message, _ = message
                if message is None:
                    continue
                frame = self._frame(message)
            except BaseException as error:  # a driver may raise anything
                if not isinstance(error, Exception):
                    error = ConnectionError(f"its reader died: {describe(error)}")
                self._call(self._end_of_reading, error)
                return
            if frame is not None:
                self._put(frame)

    def _frame(self, message: Any) -> Frame | None:
        kind = FrameKind.DATA
        if message.is_error_frame:
            kind = FrameKind.ERROR
            if not self._decodes_errors:
                return Frame(0, b"", False, self._time(), kind)
        elif not (message.is_rx or self._echoes):
            return None  # what was sent from here, which nobody asked for
        else:
            wanted, number = self._wanted, message.arbitration_id
            if message.is_extended_id:
                number |= EXTENDED
            if wanted is not None and number not in wanted:
                with self._counted:
                    self._unheard += 1
                return None
            if message.is_remote_frame:
                kind = FrameKind.REMOTE
            elif message.is_fd and not self._fd:
                with self._counted:
                    self._bad += 1
                return None
        return Frame(
            message.arbitration_id,
            b"" if kind is FrameKind.REMOTE else bytes(message.data),
            message.is_extended_id and kind is not FrameKind.ERROR,
            self._time(),
            kind,
        )

    def _put(self, frame: Frame) -> None:
        if len(self._incoming) == self.inbox_limit:
            with self._counted:
                self._dropped += 1
        self._incoming.append(frame)
        if not self._announced:
            self._announced = True
            self._call(self._take)

    def _take(self) -> None:
        self._announced = False
        self._count()
        for _ in range(self.inbox_limit):  # what comes meanwhile is announced again
            if self._closed or not self._incoming:
                return
            self._received(self._incoming.popleft())

    def _count(self) -> None:
        """Add what the thread has counted, which only the event loop may do."""
        with self._counted:
            unheard, dropped, bad = self._unheard, self._dropped, self._bad
            self._unheard = self._dropped = self._bad = 0
        stats = self._stats
        stats.received += unheard + dropped + bad
        stats.unheard += unheard
        stats.dropped += dropped
        stats.bad_frames += bad

    def _check(self, beats: int) -> None:
        self._count()
        self._missed_beats = self._missed_beats + 1 if self._beats == beats else 0
        if self._missed_beats >= MISSED_BEATS:
            self._end_of_reading(ConnectionError("its reader does not come back"))
            return
        self._watch = self._loop.call_later(HEARTBEAT, self._check, self._beats)

    def _end_of_reading(self, error: Exception) -> None:
        if not self._closed:
            self._gone(error)

    def _call(self, function: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *args)

    def _end(self) -> None:
        self._reader.join(2 * POLL_PERIOD)
        _shut(self._bus)


def _shut(bus: Any) -> None:
    with contextlib.suppress(Exception):  # whatever it says, nobody can act on it
        bus.shutdown()
