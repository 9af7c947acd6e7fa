"""Nodes of python-can: this module and the two for its nodes know the package.

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

import attrs

from esair.buses._bus import BusStats, open_on
from esair.buses.can import _interfaces as _can_interface
from esair.buses.can._frame import (
    EXTENDED,
    CanState,
    Filter,
    Frame,
    FrameKind,
    FrameLink,
    FrameOpener,
)
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DriverStuckError,
    describe,
)
from esair.loop import Arrivals, CallRefused, Executor, clock_beside, clock_of

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


class Node:
    """What both kinds of nodes have in common."""

    state = CanState.ACTIVE

    def __init__(self, bus: Any, owner: Owner) -> None:
        self._bus = bus
        self._owner = owner
        self._loop = asyncio.get_running_loop()
        self._closed = False

    def _check(self) -> None:
        if self._closed:
            raise ConnectionError("the node is closed")

    async def _shut(self, shut: Callable[[], object]) -> None:
        with contextlib.suppress(DriverStuckError, BusyError):
            await self._owner.executor.call(shut, timeout=1.0)


class SocketNode(Node):
    """A node of SocketCAN, read and written by the event loop."""

    def __init__(self, bus: Any, state: CanState, owner: Owner) -> None:
        super().__init__(bus, owner)
        self.state = state
        self._time = clock_of(self._loop)
        self._socket: socket.socket = bus.socket
        self._mtu = FD.size if owner.fd else _CLASSIC.size
        self._fd_flags = _FD_FRAME | (_FD_SWITCH if owner.bitrate_switch else 0)
        self._may_have_missed = 0
        self._missed = 0
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
        self._check()
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
                    self._owner.executor.name,
                    f"the interface takes no frame of {len(data)} bytes: "
                    f"{describe(error)}",
                ) from error
            raise
        return True

    async def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._fd)
            await self._shut(lambda: shut_bus(self._bus))

    def _readable(self) -> None:
        with self._arrivals:
            self._read()

    def _read(self) -> None:
        now = self._time()
        read, size, received = self._socket.recv, self._mtu, self._owner.received
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
            self._owner.gone(error)
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
        self._owner.received(Frame(number & _NUMBER, data, extended, now, kind))

    def _read_and_count(self) -> bytes:
        """Read a frame, and how many had no room in the kernel until it came."""
        packed, extra, _, _ = self._socket.recvmsg(self._mtu, socket.CMSG_SPACE(4))
        for level, kind, value in extra:
            if (level, kind) == (socket.SOL_SOCKET, _SO_RXQ_OVFL):
                (total,) = struct.unpack("=I", value)
                self._owner.stats.dropped += (total - self._missed) & 0xFFFF_FFFF
                self._missed = total
        return packed


def shut_bus(bus: Any) -> None:
    with contextlib.suppress(Exception):  # whatever it says, nobody can act on it
        bus.shutdown()


POLL_PERIOD = 0.1
"""How often a reading thread looks whether it should end, in seconds."""

HEARTBEAT = 1.0
"""How often the reading thread must show that it is alive, in seconds."""

MISSED_BEATS = 3
"""After how many heartbeats without a sign of it the reading thread is given up."""


class ThreadNode(Node):
    """A node of an interface without a socket: one thread reads, the executor sends."""

    inbox_limit = 1024

    def __init__(
        self,
        bus: Any,
        owner: Owner,
        *,
        echoes: bool,
        decodes_errors: bool,
    ) -> None:
        import can

        super().__init__(bus, owner)
        self._can = can
        # can.BusABC.recv measures its time-out by the wall clock: set back by an hour,
        # it waits for an hour. What it calls does not.
        own_recv = type(bus).recv is not can.BusABC.recv
        self._recv = bus.recv if own_recv else bus._recv_internal  # noqa: SLF001
        self._own_recv = own_recv
        self._echoes = echoes
        self._decodes_errors = decodes_errors
        self._time = clock_beside(self._loop)
        self._wanted: frozenset[int] = frozenset()
        self._masks: tuple[Filter, ...] = ()
        self._incoming: collections.deque[Frame] = collections.deque(
            maxlen=self.inbox_limit
        )
        self._announced = False
        self._seen = [0, 0, 0]
        """Unheard, dropped and bad frames; only the thread adds."""
        self._counted = [0, 0, 0]
        self._beats = 0
        self._missed_beats = 0
        self._reader = threading.Thread(
            target=self._read, name=f"esair-{owner.executor.name}-reader", daemon=True
        )
        self._reader.start()
        self._watch = self._loop.call_later(HEARTBEAT, self._look_after, self._beats)

    def listen(self, filters: Collection[Filter] | None) -> None:
        wanted = (Filter(0, 0),) if filters is None else filters
        self._wanted = frozenset(each.key for each in wanted if each.is_exact)
        self._masks = tuple(each for each in wanted if not each.is_exact)

    async def send(self, frame: Frame, timeout: float) -> bool:
        self._check()
        try:
            # With a guard, a frame whose time is over does not leave late.
            return await self._owner.executor.call(
                self._send, frame, timeout=timeout, guard=lambda: not self._closed
            )
        except CallRefused:
            raise ConnectionError("the node is closed") from None

    async def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._watch.cancel()
            self._count()
            await self._shut(self._end)

    def _send(self, frame: Frame) -> bool:
        message = self._can.Message(
            arbitration_id=frame.id,
            data=frame.data,
            is_extended_id=frame.extended,
            is_fd=len(frame.data) > 8,
            bitrate_switch=self._owner.bitrate_switch and len(frame.data) > 8,
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
            number = message.arbitration_id
            if message.is_extended_id:
                number |= EXTENDED
            if number not in self._wanted and not any(
                number & mask == key for key, mask in self._masks
            ):
                self._seen[0] += 1
                return None
            if message.is_remote_frame:
                kind = FrameKind.REMOTE
            elif message.is_fd and not self._owner.fd:
                self._seen[2] += 1
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
            self._seen[1] += 1
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
            self._owner.received(self._incoming.popleft())

    def _count(self) -> None:
        """Add what the thread has counted, which only the event loop may do."""
        seen = self._seen.copy()
        new = [now - before for now, before in zip(seen, self._counted, strict=True)]
        self._counted = seen
        stats = self._owner.stats
        stats.received += sum(new)
        stats.unheard += new[0]
        stats.dropped += new[1]
        stats.bad_frames += new[2]

    def _look_after(self, beats: int) -> None:
        self._count()
        self._missed_beats = self._missed_beats + 1 if self._beats == beats else 0
        if self._missed_beats >= MISSED_BEATS:
            self._end_of_reading(ConnectionError("its reader does not come back"))
            return
        self._watch = self._loop.call_later(HEARTBEAT, self._look_after, self._beats)

    def _end_of_reading(self, error: Exception) -> None:
        if not self._closed:
            self._owner.gone(error)

    def _call(self, function: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *args)

    def _end(self) -> None:
        self._reader.join(2 * POLL_PERIOD)
        shut_bus(self._bus)


OPEN_TIMEOUT = 5.0
"""How long opening an interface may take, in seconds."""

_OWN_ERRORS: Final = frozenset(
    {"ixxat", "kvaser", "neovi", "nican", "nixnet", "pcan", "usb2can", "vector"}
)
"""Interfaces whose error frames have a form of their own, not that of the kernel."""


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
        bus, state = await open_on(
            executor,
            lambda: _open(executor.name, interface, channel, options),
            lambda opened: shut_bus(opened[0]),
            timeout=OPEN_TIMEOUT,
        )
        owner = Owner(executor, stats or BusStats(), received, gone, fd, bitrate_switch)
        try:
            if state is not None:
                return SocketNode(bus, state, owner)
            return ThreadNode(
                bus,
                owner,
                echoes=bool(options.get("receive_own_messages")),
                decodes_errors=interface not in _OWN_ERRORS,
            )
        except BaseException:  # the executor may be stuck
            threading.Thread(target=shut_bus, args=(bus,), daemon=True).start()
            raise

    return opener


def _open(
    owner: str, interface: str, channel: str, options: dict[str, Any]
) -> tuple[Any, CanState | None]:
    """Open an interface, blocking; its state is that of SocketCAN, or None."""
    import can

    if interface == "socketcan":
        # SocketcanBus forgets its descriptor when it cannot bind it.
        _look(owner, channel, options)
    try:
        bus: Any = can.Bus(channel=channel, interface=interface, **options)
    except (can.CanInterfaceNotImplementedError, ImportError) as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        told = f"cannot be used: {describe(error)}; python-can knows {known}"
        raise ConfigError(owner, "interface", f"{interface!r} {told}") from error
    except can.CanError as error:
        raise ConnectionError(describe(error)) from error
    except (TypeError, ValueError) as error:
        if isinstance(error, OSError):
            raise
        told = f"python-can's {interface!r} does not take them: {describe(error)}"
        raise ConfigError(owner, "options", told) from error
    try:
        if not _is_socket_can(bus):
            return bus, None
        if bus.socket.family != socket.AF_CAN:  # a stand-in without the kernel's CAN
            return bus, CanState.ACTIVE
        return bus, _look(owner, channel, options)
    except BaseException:
        shut_bus(bus)
        raise


def _look(owner: str, channel: str, options: dict[str, Any]) -> CanState:
    """Return the state of an interface of the kernel that is set up as it should be."""
    found = _can_interface.look_up(channel)
    if not found.is_up:
        raise ConnectionError(f"the interface is down: ip link set {channel} up")
    wanted, actual = options.get("bitrate"), found.bitrate
    if (
        wanted and actual and abs(actual - wanted) > 0.05 * actual
    ):  # rounded by its clock
        raise ConfigError(
            owner,
            "bitrate",
            f"{channel} is set to {actual}, not {wanted}: ip link set"
            f" {channel} down, then up type can bitrate {wanted}",
        )
    if options.get("fd") and found.mtu < FD.size:
        raise ConfigError(
            owner,
            "fd",
            f"{channel} is not set up for CAN FD: "
            f"ip link set {channel} type can ... dbitrate ... fd on",
        )
    return found.state


def _is_socket_can(bus: Any) -> bool:
    try:
        from can.interfaces.socketcan import SocketcanBus
    except ImportError:  # not on this system
        return False
    return isinstance(bus, SocketcanBus)
