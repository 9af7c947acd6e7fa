"""SocketCAN of a real kernel: virtual interfaces, and an emulated USB adapter."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from tests.buses.can.asked import ANSWER, QUESTION, Asked

from esair.buses import CanBus, CanState
from esair.buses.can import ALL, Mask
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.testing import BusContract

pytestmark = pytest.mark.real_clock
with_usb = pytest.mark.kernel("built")

PATIENCE = 20.0
"""The guest has one slow processor."""

FRAME = struct.Struct("=IB3x8s")


def sh(command: str, *, check: bool = True) -> str:
    """Run a shell command as root of the guest."""
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, timeout=60, check=False
    )
    assert not check or done.returncode == 0, done.stderr
    return done.stdout.strip()


async def run(command: str) -> str:
    """Run a shell command while the event loop goes on."""
    return await asyncio.to_thread(sh, command)


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110 - the kernel makes it true
            await asyncio.sleep(0.01)


@pytest.fixture
def vcan() -> Iterator[str]:
    """An interface of its own for a test that hurts it."""
    name = "vcan9"
    sh(f"ip link add {name} type vcan && ip link set {name} up")
    yield name
    sh(f"ip link del {name}", check=False)


@pytest.fixture
def adapter() -> Iterator[Any]:
    """A USB adapter, plugged in; the rest of its bus is ``vcan1``."""
    from usb_parts import CanAdapter  # type: ignore[import-not-found]

    with CanAdapter(bus="vcan1") as adapter:
        end = time.monotonic() + PATIENCE
        while not Path("/sys/class/net/can0").exists():
            assert time.monotonic() < end, "the kernel has made no can0"
            time.sleep(0.02)
        sh("ip link set can0 type can bitrate 500000 && ip link set can0 up")
        yield adapter
    adapter._pipe.close()


class Far:
    """Another node, that takes and sends the kernel's own frames."""

    def __init__(self, channel: str, *, fd: bool = False) -> None:
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        if fd:
            self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self.socket.bind((channel,))
        self.socket.setblocking(False)

    def __enter__(self) -> Far:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, number: int, data: bytes = b"") -> None:
        self.socket.send(FRAME.pack(number, len(data), data))

    async def take(self) -> tuple[int, bytes]:
        async with asyncio.timeout(PATIENCE):
            packed = await asyncio.get_running_loop().sock_recv(self.socket, 72)
        number, length = struct.unpack_from("=IB", packed)
        return number, packed[8 : 8 + length]

    def take_all(self) -> list[tuple[int, bytes]]:
        found = []
        with contextlib.suppress(BlockingIOError):
            while True:
                number, length, data = FRAME.unpack(self.socket.recv(16))
                found.append((number, data[:length]))
        return found


class Answers:
    """A node in a thread that answers, until it is told to be silent."""

    def __init__(self, channel: str) -> None:
        self.silent = False
        self.latency = 0.0
        self._ended = False
        self._node = can.Bus(channel, interface="socketcan")
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended = True
        self._thread.join(PATIENCE)
        self._node.shutdown()

    def _serve(self) -> None:
        while not self._ended:
            with contextlib.suppress(can.CanError):
                message = self._node.recv(0.05)
                if message is None or self.silent:
                    continue
                if message.arbitration_id == 0x101:
                    self._send(0x181, b"pong")
                elif message.arbitration_id == QUESTION:
                    threading.Timer(
                        self.latency, self._send, (ANSWER, message.data)
                    ).start()

    def _send(self, number: int, data: bytes) -> None:
        with contextlib.suppress(can.CanError):  # it is unplugged
            self._node.send(
                can.Message(arbitration_id=number, data=data, is_extended_id=False)
            )


class TestContract(Asked, BusContract):
    """The contract of buses, on an interface that goes and comes."""

    longest_stall = 3.0  # one slow processor has the kernel and all processes

    pytestmark = [pytest.mark.asyncio, pytest.mark.real_clock]  # noqa: RUF012

    @pytest.fixture(autouse=True)
    def _interface(self, vcan: str) -> Iterator[None]:
        self.channel = vcan
        self.answers = Answers(vcan)
        yield
        self.answers.close()

    def make(self) -> CanBus:
        return CanBus(name="drive", channel=self.channel)

    async def use(self, bus: Any) -> None:
        with bus.frames(0x181) as inbox:
            await bus.send(0x101, b"ping")
            try:
                assert (await inbox.take(timeout=2.0)).data == b"pong"
            except TimeoutError:
                raise DeviceLostError(bus.name, "nobody answered") from None

    async def unplug(self, bus: Any) -> None:
        await run(f"ip link set {self.channel} down")

    async def plug(self, bus: Any) -> None:
        await run(f"ip link set {self.channel} up")

    async def stall(self, bus: Any) -> None:
        self.answers.silent = True

    async def resume(self, bus: Any) -> None:
        self.answers.silent = False

    async def delay(self, bus: Any, seconds: float) -> None:
        self.answers.latency = seconds


async def test_frames_go_both_ways(vcan: str) -> None:
    """Standard and extended ids with one number are two, and both are carried."""
    bus = CanBus(name="drive", channel=vcan)
    await bus.open()
    standard, extended = bus.frames(0x123), bus.frames(0x123, extended=True)

    with Far(vcan) as far:
        far.send(0x123, b"12345678")
        far.send(0x123 | socket.CAN_EFF_FLAG, b"x")
        await bus.send(0x7FF, b"")
        await bus.send(0x1FFF_FFFF, b"abc", extended=True)

        assert (await standard.take(timeout=PATIENCE)).data == b"12345678"
        assert (await extended.take(timeout=PATIENCE))[:3] == (0x123, b"x", True)
        assert await far.take() == (0x7FF, b"")
        assert await far.take() == (0x1FFF_FFFF | socket.CAN_EFF_FLAG, b"abc")
    assert len(standard) == len(extended) == 0
    await bus.close()


async def test_frames_that_nobody_wants_do_not_wake_the_process(vcan: str) -> None:
    """The kernel keeps them; what was never wanted is not even counted."""
    bus = CanBus(name="drive", channel=vcan)
    await bus.open()
    wakes: list[None] = []
    link: Any = bus._outbox.link

    def readable() -> None:
        wakes.append(None)
        link._readable()

    link._loop.remove_reader(link._fd)
    link._loop.add_reader(link._fd, readable)

    with Far(vcan) as far:
        for number in range(50):
            far.send(number)
        far.send(0x20 | socket.CAN_EFF_FLAG)
        await asyncio.sleep(0.1)
        assert wakes == []
        with bus.frames(0x20) as inbox:
            far.send(0x20, b"now")
            far.send(0x20 | socket.CAN_EFF_FLAG, b"no")
            assert (await inbox.take(timeout=PATIENCE)).data == b"now"
        far.send(0x20, b"late")
        await asyncio.sleep(0.1)

    assert (bus.stats.received, bus.stats.unheard, len(wakes)) == (1, 0, 1)
    await bus.close()


@pytest.mark.promise("BUS-4")
async def test_masks_and_ranges_are_chosen_by_in_the_kernel(vcan: str) -> None:
    """What nobody listens to does not reach the process; "all" has both kinds of ids."""
    bus = CanBus(name="drive", channel=vcan)
    await bus.open()
    masked = bus.frames(Mask(0x180, 0x780))
    ranged = bus.frames(range(0x1FE, 0x203))
    j1939 = bus.frames(Mask(0x00F00400, 0x03FFFF00), extended=True)

    with Far(vcan) as far:
        for number in (0x17F, 0x180, 0x1FF, 0x200, 0x202, 0x203):
            far.send(number)
        for number in (0x0CF00400, 0x18F00411, 0x0CF00500, 0x180):
            far.send(number | socket.CAN_EFF_FLAG)
        far.send(0x181, b"last")
        while (frame := await masked.take(timeout=PATIENCE)).data != b"last":
            assert frame.id in {0x180, 0x1FF}
        assert [(await ranged.take()).id for _ in range(len(ranged))] == [
            0x1FF,
            0x200,
            0x202,
        ]
        assert [(await j1939.take()).id for _ in range(len(j1939))] == [
            0x0CF00400,
            0x18F00411,
        ]
        assert (bus.stats.received, bus.stats.unheard) == (7, 0)
        every = bus.frames(ALL)
        far.send(0x700)
        far.send(0x700 | socket.CAN_EFF_FLAG)
        found = [await every.take(timeout=PATIENCE) for _ in range(2)]
        assert [each.extended for each in found] == [False, True]
    await bus.close()


async def test_more_ids_than_the_kernel_can_choose_by(vcan: str) -> None:
    """Then it gives all frames, and the bus chooses."""
    bus = CanBus(name="drive", channel=vcan)
    await bus.open()
    some = bus.frames(*range(512))
    more = bus.frames(*range(512, 600))

    with Far(vcan) as far:
        for number in (511, 599, 700, 1):
            far.send(number)

    assert [(await some.take(timeout=PATIENCE)).id for _ in range(2)] == [511, 1]
    assert (await more.take(timeout=PATIENCE)).id == 599
    assert (bus.stats.received, bus.stats.unheard) == (4, 1)
    more.close()
    with Far(vcan) as far:
        for number in (700, 2):
            far.send(number)
    assert (await some.take(timeout=PATIENCE)).id == 2
    assert bus.stats.received == 5
    await bus.close()


@pytest.mark.fault("C10")
async def test_a_remote_frame_is_no_data(vcan: str) -> None:
    """It is counted where data are expected."""
    bus = CanBus(name="drive", channel=vcan)
    await bus.open()
    inbox = bus.frames(0x20)

    with Far(vcan) as far:
        far.send(0x20 | socket.CAN_RTR_FLAG)
        far.send(0x20, b"data")

    assert (await inbox.take(timeout=PATIENCE)).data == b"data"
    assert bus.stats.bad_frames == 1
    await bus.close()


async def test_long_frames_with_can_fd(vcan: str) -> None:
    """64 bytes both ways; an interface without CAN FD is refused with the remedy."""
    await run(f"ip link set {vcan} down && ip link set {vcan} mtu 16 up")
    bus = CanBus(name="drive", channel=vcan, fd=True)
    with pytest.raises(ConfigError, match="fd on"):
        await bus.open()
    await bus.close()
    await run(f"ip link set {vcan} down && ip link set {vcan} mtu 72 up")
    await bus.open()
    inbox = bus.frames(1, length=64)

    with Far(vcan, fd=True) as far:
        await bus.send(2, bytes(range(64)))
        far.socket.send(struct.pack("=IBB2x64s", 1, 64, 0, bytes(range(64))))
        assert (await inbox.take(timeout=PATIENCE)).data == bytes(range(64))
        assert await far.take() == (2, bytes(range(64)))
    await bus.close()


@pytest.mark.fault("C01")
async def test_an_interface_that_goes_down_while_it_is_read(vcan: str) -> None:
    """One loss, nothing else; down cannot be opened, up can."""
    loop = asyncio.get_running_loop()
    stray: list[Any] = []
    loop.set_exception_handler(lambda _loop, context: stray.append(context))
    bus = CanBus(name="drive", channel=vcan)
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    inbox = bus.frames(1)
    assert bus._look() is not None

    await run(f"ip link set {vcan} down")

    with pytest.raises(DeviceLostError, match="down"):
        await inbox.take(timeout=PATIENCE)
    with pytest.raises(DeviceLostError):
        await bus.send(1, b"")
    with pytest.raises(DeviceLostError, match=f"ip link set {vcan} up"):
        await bus.open()
    assert bus._look() is None
    await run(f"ip link set {vcan} up")
    assert bus._look() is not None
    await bus.open()
    await bus.send(1, b"")
    assert len(told) == 1
    assert stray == []
    await bus.close()


@pytest.mark.fault("C01")
async def test_an_interface_that_is_deleted_and_made_again(vcan: str) -> None:
    """The old socket would be silent for ever: the bus opens a new one."""
    bus = CanBus(name="drive", channel=vcan)
    told: list[BaseException] = []
    bus.on_lost(told.append)
    seen = {bus._look()}
    for _ in range(3):
        await bus.open()
        inbox = bus.frames(1)
        await run(f"ip link del {vcan}")
        with pytest.raises(DeviceLostError):
            await inbox.take(timeout=PATIENCE)
        with pytest.raises(DeviceLostError, match="cannot be opened"):
            await bus.open()
        assert bus._look() is None
        await run(f"ip link add {vcan} type vcan && ip link set {vcan} up")
        seen.add(bus._look())
    await bus.open()
    inbox = bus.frames(1)

    with Far(vcan) as far:
        far.send(1, b"new")
        assert (await inbox.take(timeout=PATIENCE)).data == b"new"

    assert len(told) == 3
    assert len(seen) == 4, "each arrival looks different from the one before"
    await bus.close()


@pytest.mark.fault("C07")
async def test_frames_that_had_no_room_in_the_kernel_are_counted(vcan: str) -> None:
    """What a flood leaves over is received or counted, none is forgotten."""
    count = 2000
    bus = CanBus(name="drive", channel=vcan)
    await bus.open()
    inbox = bus.frames(1, limit=4 * count)

    with Far(vcan) as far:
        for number in range(count):  # and the bus has no turn meanwhile
            far.send(1, struct.pack("<I", number))
        await until(lambda: len(inbox) and bus.stats.received == len(inbox))
        for _ in range(200):  # the kernel tells with a later frame
            far.send(1, b"last")
            await asyncio.sleep(0.001)
        await until(lambda: bus.stats.received + bus.stats.dropped == count + 200)

    assert bus.stats.dropped > 0
    await bus.close()


@with_usb
@pytest.mark.fault("C02")
async def test_bus_off_is_a_loss_until_somebody_starts_the_controller(
    adapter: Any,
) -> None:
    """Opening is refused meanwhile: a send would succeed and reach nobody."""
    bus = CanBus(name="drive", channel="can0")
    told: list[BaseException] = []
    states: list[CanState] = []
    bus.on_lost(told.append)
    bus.on_state(states.append)
    await bus.open()
    inbox = bus.frames(1)

    await asyncio.to_thread(adapter.tell, "bus_off")

    with pytest.raises(DeviceLostError, match="bus-off"):
        await inbox.take(timeout=PATIENCE)
    with pytest.raises(DeviceLostError):
        await bus.send(1, b"")
    with pytest.raises(DeviceLostError, match="ip link set can0 down"):
        await bus.open()
    assert bus._look() is None
    await asyncio.to_thread(adapter.tell, "acknowledge", True)
    await run("ip link set can0 down && ip link set can0 up")
    assert bus._look() is not None
    await bus.open()
    with Far("vcan1") as far:
        await bus.send(2, b"again")
        assert await far.take() == (2, b"again")
    assert len(told) == 1
    assert states == [CanState.BUS_OFF, CanState.ACTIVE]
    await bus.close()


@with_usb
@pytest.mark.fault("C04", "C05")
async def test_nobody_acknowledges(adapter: Any) -> None:
    """The error says so, in time; the kernel and the adapter hold some frames, not more."""
    bus = CanBus(name="drive", channel="can0", send_timeout=0.3)
    await bus.open()
    await asyncio.to_thread(adapter.tell, "acknowledge", False)
    loop = asyncio.get_running_loop()

    sent = 0
    begin = loop.time()
    with pytest.raises(DeviceFaultError, match="acknowledges"):  # noqa: PT012 - which?
        while True:
            begin = loop.time()
            await bus.send(1, struct.pack("<I", sent))
            sent += 1
    took = loop.time() - begin

    assert 0.3 <= took < PATIENCE
    assert sent <= 32  # ten in the queue of the interface, and those in the adapter
    assert bus.is_open
    assert bus.stats.sent == sent
    assert bus.stats.discarded == 1
    await bus.close()


@with_usb
@pytest.mark.fault("C03")
async def test_states_of_the_controller_are_told(adapter: Any) -> None:
    """Warning and passive are events; the bus goes on."""
    bus = CanBus(name="drive", channel="can0")
    states: list[CanState] = []
    bus.on_state(states.append)
    await bus.open()

    for bits in (0x08, 0x20, 0x40):
        await asyncio.to_thread(
            adapter.tell, "error", 0x04, bytes((0, bits)) + bytes(6)
        )
    await until(lambda: len(states) == 3)

    assert states == [CanState.WARNING, CanState.PASSIVE, CanState.ACTIVE]
    with Far("vcan1") as far:
        await bus.send(1, b"on")
        assert await far.take() == (1, b"on")
    assert (bus.stats.lost, bus.stats.errors) == (0, 3)
    await bus.close()


@with_usb
async def test_an_adapter_in_a_bad_state_is_seen_when_it_is_opened(
    adapter: Any,
) -> None:
    """A socket tells only what changes; the kernel knows what is."""
    await asyncio.to_thread(adapter.tell, "error", 0x04, bytes((0, 0x20)) + bytes(6))
    await until(lambda: "ERROR-PASSIVE" in sh("ip -details link show can0"))
    bus = CanBus(name="drive", channel="can0")
    strict = CanBus(name="strict", channel="can0", lost_when="passive")

    await bus.open()
    assert bus.state is CanState.PASSIVE
    with pytest.raises(DeviceLostError, match="error-passive"):
        await strict.open()

    await strict.close()
    await bus.close()


@with_usb
@pytest.mark.fault("C01")
async def test_an_adapter_that_is_unplugged(adapter: Any) -> None:
    """One loss; plugged in again the same bus works."""
    bus = CanBus(name="drive", channel="can0")
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    inbox = bus.frames(1)

    await asyncio.to_thread(adapter.unplug)
    with pytest.raises(DeviceLostError):
        await inbox.take(timeout=PATIENCE)
    await until(lambda: bus._look() is None)
    await asyncio.to_thread(adapter.plug)
    await until(lambda: Path("/sys/class/net/can0").exists())
    await run("ip link set can0 type can bitrate 500000 && ip link set can0 up")
    assert bus._look() is not None
    await bus.open()

    with Far("vcan1") as far:
        await bus.send(2, b"back")
        assert await far.take() == (2, b"back")
    assert len(told) == 1
    await bus.close()


async def test_python_can_alone_goes_silent(vcan: str) -> None:
    """The trap: its asyncio notifier hears of no loss, and its reader waits on."""
    loop = asyncio.get_running_loop()
    stray: list[Any] = []
    loop.set_exception_handler(lambda _loop, context: stray.append(context))
    node = can.Bus(vcan, interface="socketcan")
    reader = can.AsyncBufferedReader()
    notifier = can.Notifier(node, [reader], loop=loop)
    waiting = asyncio.ensure_future(reader.get_message())

    await run(f"ip link del {vcan}")
    await until(lambda: stray)
    await asyncio.sleep(0.2)

    assert not waiting.done()
    assert stray[0]["exception"].error_code in {errno.ENETDOWN, errno.ENODEV}
    waiting.cancel()
    await asyncio.wait({waiting})
    notifier.stop()
    node.shutdown()
