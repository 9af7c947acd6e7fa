"""The CAN bus on a socket: SocketCAN as far as it goes without the kernel's CAN.

A pair of sockets carries the frames of ``linux/can.h``; the bus of python-can is its own
``SocketcanBus``. The real thing is in ``tests/kernel``.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import struct
from collections.abc import Callable
from typing import Any

import can
import pytest
from can.interfaces.socketcan import SocketcanBus
from tests.buses.can.asked import ANSWER, Asked

from esair.buses import CanBus, CanState
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.testing import BusContract

pytestmark = pytest.mark.real_clock

CLASSIC = struct.Struct("=IB3x8s")
EXTENDED, REMOTE, ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000


class Socket(socket.socket):
    """A socket that fails when it is told to."""

    sick_to_read = 0
    sick_to_send: OSError | None = None
    reads = 0

    def recv(self, *arguments: Any) -> bytes:
        self.reads += 1
        if self.sick_to_read:
            raise OSError(self.sick_to_read, os.strerror(self.sick_to_read))
        return super().recv(*arguments)

    def send(self, *arguments: Any) -> int:
        if self.sick_to_send is not None:
            raise self.sick_to_send
        return super().send(*arguments)


class Wire:
    """Everything beyond the robot's socket."""

    def __init__(self) -> None:
        self.plugged = True
        self.near: Socket | None = None
        self.far: socket.socket | None = None
        self.options: dict[str, Any] = {}

    def connect(self) -> Socket:
        if not self.plugged:
            raise OSError(errno.ENODEV, "no such device")
        if self.far is not None:
            self.far.close()
        near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.near = Socket(fileno=near.detach())
        return self.near

    def send(self, number: int, data: bytes = b"", length: int | None = None) -> None:
        length = len(data) if length is None else length
        self.far.send(CLASSIC.pack(number, length, data))

    async def take(self) -> tuple[int, bytes]:
        """Take a frame of the robot."""
        assert self.far is not None
        self.far.setblocking(False)
        async with asyncio.timeout(5):
            packed = await asyncio.get_running_loop().sock_recv(self.far, 72)
        number, length = struct.unpack_from("=IB", packed)
        return number, packed[8 : 8 + length]

    def unplug(self) -> None:
        self.plugged = False
        if self.far is not None:
            self.far.close()
            self.far = None


class Node(SocketcanBus):
    """python-can's own bus, on a socket of ours."""

    def __init__(self, wire: Wire, **options: Any) -> None:
        wire.options = options
        self.socket = wire.connect()
        self.channel = self.channel_info = "pair0"
        self._bcm_sockets = {}
        self._periodic_tasks = []
        self._is_shutdown = False


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch):
    """Have the interface ``pair`` lead to a wire."""
    wire = Wire()
    monkeypatch.setattr(
        can, "Bus", lambda channel, interface, **options: Node(wire, **options)
    )
    yield wire
    wire.unplug()


@pytest.fixture
def make() -> Callable[..., CanBus]:
    """Make a bus on the wire."""
    return lambda **options: CanBus(
        name="drive", interface="pair", channel="pair0", **options
    )


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(5):
        while not condition():  # noqa: ASYNC110 - a thread makes it true
            await asyncio.sleep(0.001)


async def test_frames_go_both_ways(wire: Wire, make: Callable[..., CanBus]) -> None:
    """Standard and extended ids, empty and full frames."""
    bus = make()
    await bus.open()
    standard, extended = bus.frames(0x123), bus.frames(0x123, extended=True)

    wire.send(0x123, b"12345678")
    wire.send(0x123 | EXTENDED, b"")
    first = await standard.take(timeout=5)
    second = await extended.take(timeout=5)
    await bus.send(0x7FF, b"abc")
    await bus.send(0x1FFF_FFFF, b"", extended=True)

    assert first[:3] == (0x123, b"12345678", False)
    assert second[:3] == (0x123, b"", True)
    assert first.time == pytest.approx(asyncio.get_running_loop().time(), abs=5)
    assert await wire.take() == (0x7FF, b"abc")
    assert await wire.take() == (0x1FFF_FFFF | EXTENDED, b"")
    assert (bus.stats.sent, bus.stats.received) == (2, 2)
    await bus.close()


async def test_long_frames_go_both_ways_with_can_fd(
    wire: Wire, make: Callable[..., CanBus]
) -> None:
    """python-can is told, and 64 bytes are one frame."""
    bus = make(fd=True)
    await bus.open()
    inbox = bus.frames(1, length=64)

    await bus.send(2, bytes(range(64)))
    wire.far.send(struct.pack("=IBB2x64s", 1, 64, 4, bytes(range(64))))
    frame = await inbox.take(timeout=5)

    assert await wire.take() == (2, bytes(range(64)))
    assert frame.data == bytes(range(64))
    assert wire.options == {"fd": True}
    await bus.close()


@pytest.mark.parametrize("switch", [False, True])
async def test_the_data_of_long_frames_may_be_sent_faster(
    wire: Wire, make: Callable[..., CanBus], switch: bool
) -> None:
    """The flag BRS of ``linux/can.h``; short frames are classic ones."""
    bus = make(fd=True, bitrate_switch=switch)
    await bus.open()

    await bus.send(2, bytes(12))
    await bus.send(3, bytes(8))
    assert wire.far is not None
    sent = [await asyncio.get_running_loop().sock_recv(wire.far, 72) for _ in range(2)]

    assert sent[0][5] == (0x05 if switch else 0x04)
    assert len(sent[1]) == CLASSIC.size
    await bus.close()


@pytest.mark.fault("C10")
async def test_remote_frames_of_an_id_are_no_data(
    wire: Wire, make: Callable[..., CanBus]
) -> None:
    """They are counted as bad frames where data are expected, and not handed out."""
    bus = make()
    await bus.open()
    inbox = bus.frames(1)

    wire.send(1 | REMOTE, b"", length=8)
    wire.send(1, b"data")

    assert (await inbox.take(timeout=5)).data == b"data"
    assert bus.stats.bad_frames == 1
    await bus.close()


@pytest.mark.fault("C01")
@pytest.mark.parametrize("number", [errno.ENETDOWN, errno.ENODEV])
async def test_an_interface_that_goes_down_is_one_loss(
    number: int, wire: Wire, make: Callable[..., CanBus]
) -> None:
    """It is told once, the socket is watched no more, and nothing storms."""
    loop = asyncio.get_running_loop()
    stray: list[Any] = []
    loop.set_exception_handler(lambda _loop, context: stray.append(context))
    bus = make()
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    inbox = bus.frames(1)
    near = wire.near
    before = near.reads

    near.sick_to_read = number
    wire.send(1)

    with pytest.raises(DeviceLostError, match=os.strerror(number)):
        await inbox.take(timeout=5)
    await until(lambda: near.fileno() == -1)
    assert near.reads == before + 1
    assert len(told) == 1
    assert stray == []
    await bus.close()


async def test_what_the_driver_of_the_socket_does_wrong_is_a_loss(
    wire: Wire, make: Callable[..., CanBus]
) -> None:
    """Also half a frame, which the kernel never gives."""
    bus = make()
    await bus.open()
    inbox = bus.frames(1)

    wire.far.send(b"abc")

    with pytest.raises(DeviceLostError):
        await inbox.take(timeout=5)
    await bus.close()


@pytest.mark.fault("C04")
@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
async def test_a_full_queue_is_tried_again(
    number: int, wire: Wire, make: Callable[..., CanBus]
) -> None:
    """ENOBUFS comes although the socket is writable; it means later, not never."""
    bus = make(send_timeout=5.0)
    await bus.open()
    wire.near.sick_to_send = OSError(number, "full")
    sending = asyncio.create_task(bus.send(1, b"a"))
    await until(lambda: bus.stats.retries > 2)
    assert bus.waiting == 1

    wire.near.sick_to_send = None
    await sending

    assert await wire.take() == (1, b"a")
    assert bus.waiting == 0
    await bus.close()


async def test_a_frame_that_the_interface_does_not_take_is_a_fault(
    wire: Wire, make: Callable[..., CanBus]
) -> None:
    """The bus goes on: a CAN FD frame for a classic interface says nothing about it."""
    bus = make()
    await bus.open()
    wire.near.sick_to_send = OSError(errno.EINVAL, "invalid argument")

    with pytest.raises(DeviceFaultError, match="no frame of 3 bytes"):
        await bus.send(1, b"abc")

    assert bus.is_open
    wire.near.sick_to_send = None
    await bus.send(1, b"abc")
    await bus.close()


async def test_a_send_to_an_interface_that_is_down_is_a_loss(
    wire: Wire, make: Callable[..., CanBus]
) -> None:
    """Whoever sends and whoever listens learn of it, and the socket is closed."""
    bus = make()
    await bus.open()
    inbox = bus.frames(1)
    wire.near.sick_to_send = OSError(errno.ENETDOWN, "network is down")

    with pytest.raises(DeviceLostError, match="network is down"):
        await bus.send(1, b"")
    with pytest.raises(DeviceLostError, match="network is down"):
        await inbox.take(timeout=5)

    await until(lambda: wire.near.fileno() == -1)
    await bus.close()


@pytest.mark.fault("C02")
async def test_bus_off_closes_the_socket(
    wire: Wire, make: Callable[..., CanBus]
) -> None:
    """Nothing is left that could be sent by whoever starts the controller again."""
    bus = make()
    await bus.open()
    inbox = bus.frames(1)

    wire.send(ERROR | 0x40, bytes(8))

    with pytest.raises(DeviceLostError, match="bus-off"):
        await inbox.take(timeout=5)
    assert bus.state is CanState.BUS_OFF
    with pytest.raises(DeviceLostError):
        await bus.send(1, b"")
    await until(lambda: wire.near.fileno() == -1)
    await bus.close()


@pytest.mark.fault("C07")
async def test_a_flood_does_not_keep_the_loop(
    wire: Wire, make: Callable[..., CanBus]
) -> None:
    """Whatever the socket holds, others have their turn after a batch of frames."""
    bus = make()
    await bus.open()
    inbox = bus.frames(1, limit=1000)
    for _ in range(200):
        wire.send(1, b"x")
    turns = []

    while bus.stats.received < 200:
        await asyncio.sleep(0)
        turns.append(bus.stats.received)

    assert len(inbox) == 200
    assert max(b - a for a, b in zip([0, *turns], turns, strict=False)) <= 64
    await bus.close()


class TestSocket(Asked, BusContract):
    """The contract of buses, with a socket that the event loop watches."""

    pytestmark = [pytest.mark.asyncio, pytest.mark.real_clock]  # noqa: RUF012

    wire: Wire

    @pytest.fixture(autouse=True)
    def _wire(self, wire: Wire) -> None:
        self.wire = wire
        self.silent = False

    def make(self) -> CanBus:
        return CanBus(name="drive", interface="pair", channel="pair0")

    async def use(self, bus: Any) -> None:
        with bus.frames(0x181) as inbox:
            await bus.send(0x101, b"ping")
            if not self.silent:
                with contextlib.suppress(AttributeError, OSError):  # it is unplugged
                    assert await self.wire.take() == (0x101, b"ping")
                    self.wire.send(0x181, b"pong")
            try:
                assert (await inbox.take(timeout=0.3)).data == b"pong"
            except TimeoutError:
                raise DeviceLostError(bus.name, "nobody answered") from None

    async def unplug(self, bus: Any) -> None:
        self.wire.unplug()

    async def plug(self, bus: Any) -> None:
        self.wire.plugged = True

    async def stall(self, bus: Any) -> None:
        self.silent = True

    async def resume(self, bus: Any) -> None:
        self.silent = False

    async def delay(self, bus: Any, seconds: float) -> None:
        far, loop = self.wire.far, asyncio.get_running_loop()
        assert far is not None

        def answer() -> None:
            data = far.recv(72)[8:9]
            if data:  # it is not closed
                loop.call_later(seconds, self.wire.send, ANSWER, data)

        loop.add_reader(far, answer)
