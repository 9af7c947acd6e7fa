"""The CAN bus on interfaces without a socket: a thread reads, the executor sends."""

from __future__ import annotations

import asyncio
import errno
import os
import queue
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import can
import pytest
from tests.patience import within

from esair.buses import CanBus, CanState
from esair.buses.can import ALL, Mask, _python_can
from esair.buses.can._interfaces import Interface
from esair.exceptions import (
    ConfigError,
    DeviceLostError,
    DriverStuckError,
)

pytestmark = pytest.mark.real_clock

PATIENCE = 10.0


class Scripted(can.BusABC):
    """An interface that does what a test says."""

    channel_info = "scripted"

    def __init__(self, channel: Any = None, **options: Any) -> None:
        self.options = options
        self.opening.wait(PATIENCE)
        super().__init__(channel)
        self.incoming: queue.Queue[Any] = queue.Queue()
        self.sent: list[can.Message] = []
        self.send_error: Exception | None = None
        self.go_on = threading.Event()
        self.go_on.set()
        self.shut = threading.Event()
        self.made.append(self)

    opening = threading.Event()
    made: list[Scripted]

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            found = self.incoming.get(timeout=timeout)
        except queue.Empty:
            return None, False
        if isinstance(found, BaseException):
            raise found
        if isinstance(found, threading.Event):
            found.wait(PATIENCE)
            return None, False
        return found, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.go_on.wait(PATIENCE)
        if self.send_error is not None:
            raise self.send_error
        self.sent.append(msg)

    def shutdown(self) -> None:
        super().shutdown()
        self.shut.set()


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Scripted]]:
    """Have every interface be scripted; yields those that were opened."""
    Scripted.made = []
    Scripted.opening.set()
    monkeypatch.setattr(
        can, "Bus", lambda channel, interface, **more: Scripted(channel, **more)
    )
    yield Scripted.made
    for each in Scripted.made:
        each.go_on.set()


@pytest.fixture
async def bus() -> AsyncIterator[CanBus]:
    made = CanBus(name="drive", interface="scripted", channel="x")
    yield made
    await made.close()


def message(number: int, data: bytes = b"", **more: Any) -> can.Message:
    more.setdefault("is_extended_id", False)
    return can.Message(arbitration_id=number, data=data, **more)


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not condition():  # noqa: ASYNC110 - a thread makes it true
            await asyncio.sleep(0.001)


async def test_frames_go_both_ways_through_python_can() -> None:
    """On the interface that python-can itself has for that."""
    channel = f"test-{os.getpid()}"
    bus = CanBus(name="drive", interface="virtual", channel=channel)
    await bus.open()
    other = can.Bus(channel, interface="virtual")
    inbox, extended = bus.frames(0x181), bus.frames(0x181, extended=True)

    other.send(message(0x181, b"\x01\x02"))
    other.send(message(0x181, b"\x03", is_extended_id=True))
    frame = await inbox.take(timeout=PATIENCE)
    second = await extended.take(timeout=PATIENCE)
    await bus.send(0x101, b"\x03", timeout=PATIENCE)
    sent = await asyncio.to_thread(other.recv, PATIENCE)

    assert (frame.id, frame.data, frame.extended) == (0x181, b"\x01\x02", False)
    assert (second.id, second.data, second.extended) == (0x181, b"\x03", True)
    assert sent is not None
    assert (sent.arbitration_id, bytes(sent.data)) == (0x101, b"\x03")
    assert bus.stats.unheard == 0
    other.shutdown()
    await bus.close()


@pytest.mark.promise("BUS-4")
async def test_masks_ranges_and_all_of_another_interface() -> None:
    """The thread that reads chooses as the kernel would; extended ids are others."""
    channel = f"masks-{os.getpid()}"
    bus = CanBus(name="drive", interface="virtual", channel=channel)
    await bus.open()
    other = can.Bus(channel, interface="virtual")
    masked = bus.frames(Mask(0x180, 0x780))
    ranged = bus.frames(range(0x1FE, 0x203))
    for number in (0x17F, 0x180, 0x1FF, 0x200, 0x202, 0x203):
        other.send(message(number))
        other.send(message(number, is_extended_id=True))
    await until(lambda: bus.stats.received == 12)
    every = bus.frames(ALL)
    other.send(message(0x1234, is_extended_id=True))
    last = await every.take(timeout=PATIENCE)

    assert [(await masked.take()).id for _ in range(len(masked))] == [0x180, 0x1FF]
    assert [(await ranged.take()).id for _ in range(len(ranged))] == [
        0x1FF,
        0x200,
        0x202,
    ]
    assert (last.id, last.extended) == (0x1234, True)
    assert bus.stats.unheard == 8
    other.shutdown()
    await bus.close()


@pytest.mark.fault("C10")
async def test_every_kind_of_frame_is_counted(
    made: list[Scripted], bus: CanBus
) -> None:
    """Unheard, remote, too long without CAN FD, error; what fits arrives."""
    await bus.open()
    inbox = bus.frames(1)
    for each in (
        message(2),
        message(1, is_extended_id=True),
        message(1, is_remote_frame=True, dlc=8),
        message(1, bytes(12), is_fd=True),
        message(4, bytes((0, 0x08, 0, 0, 0, 0, 0, 0)), is_error_frame=True),
        message(1, b"good"),
    ):
        made[0].incoming.put(each)

    assert (await inbox.take(timeout=PATIENCE)).data == b"good"
    stats = bus.stats
    assert (stats.received, stats.unheard, stats.bad_frames, stats.errors) == (
        5,
        2,
        2,
        1,
    )
    assert bus.state is CanState.WARNING


@pytest.mark.parametrize(
    ("echoes", "heard"), [(False, [b"far"]), (True, [b"own", b"far"])]
)
async def test_what_the_adapter_echoes_is_heard_only_by_who_asks_for_it(
    made: list[Scripted], echoes: bool, heard: list[bytes]
) -> None:
    """A gs_usb adapter gives back each frame that it has sent."""
    bus = CanBus(
        name="drive", interface="gs_usb", channel="x", receive_own_messages=echoes
    )
    await bus.open()
    inbox = bus.frames(1)
    made[0].incoming.put(message(1, b"own", is_rx=False))
    made[0].incoming.put(message(1, b"far"))

    assert [(await inbox.take(timeout=PATIENCE)).data for _ in heard] == heard
    assert bus.stats.received == len(heard)
    await bus.close()


@pytest.mark.fault("C03")
async def test_error_frames_of_another_form_are_counted_and_no_more(
    made: list[Scripted],
) -> None:
    """What PCAN numbers 4 with 0x1B is no state of the controller."""
    bus = CanBus(name="drive", interface="pcan", channel="x", lost_when="warning")
    await bus.open()
    made[0].incoming.put(message(4, bytes((0, 0x1B, 0, 0)), is_error_frame=True))
    made[0].incoming.put(message(0x40, bytes(4), is_error_frame=True))
    await until(lambda: bus.stats.errors == 2)

    assert bus.is_open
    assert bus.state is CanState.ACTIVE
    assert bus.stats.dropped == 0
    await bus.close()


@pytest.mark.fault("C07")
async def test_frames_that_come_faster_than_the_loop_turns_are_counted(
    made: list[Scripted], bus: CanBus
) -> None:
    """The newest win, memory is bounded, and none is forgotten."""
    await bus.open()
    inbox = bus.frames(1, limit=5000)
    for number in range(3000):
        made[0].incoming.put(message(1, number.to_bytes(2, "big")))

    deadline = time.monotonic() + PATIENCE
    while not made[0].incoming.empty() and time.monotonic() < deadline:
        time.sleep(0.01)  # noqa: ASYNC251 - the loop has no turn
    await until(lambda: bus.stats.received == 3000)

    assert len(inbox) + bus.stats.dropped == 3000
    assert bus.stats.dropped >= 3000 - 1024 - 1
    taken = [await inbox.take() for _ in range(len(inbox))]
    assert taken[-1].data == (2999).to_bytes(2, "big")


@pytest.mark.fault("C06")
@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("network is down", errno.ENETDOWN),
        RuntimeError("a fault of the network is down in the driver"),
        SystemExit("network is down"),
    ],
)
async def test_a_reader_that_dies_is_a_loss(
    error: BaseException, made: list[Scripted], bus: CanBus
) -> None:
    """Whatever ends the reading thread reaches everybody who listens, once."""
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    inbox = bus.frames(1)

    made[0].incoming.put(error)

    with pytest.raises(DeviceLostError, match="network is down"):
        await inbox.take(timeout=PATIENCE)
    assert await asyncio.to_thread(made[0].shut.wait, PATIENCE), "it is shut at once"
    assert len(told) == 1
    await bus.open()
    assert len(made) == 2


@pytest.mark.fault("C06")
async def test_a_reader_that_hangs_is_a_loss(
    made: list[Scripted], bus: CanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driver that does not come back from its recv is found out by its heartbeat."""
    monkeypatch.setattr(_python_can, "HEARTBEAT", 0.3)
    await bus.open()
    inbox = bus.frames(1)
    hang = threading.Event()

    made[0].incoming.put(hang)

    with pytest.raises(DeviceLostError, match="does not come back"):
        await inbox.take(timeout=PATIENCE)
    hang.set()


@pytest.mark.fault("C06")
async def test_a_quiet_bus_is_no_dead_reader(
    made: list[Scripted], bus: CanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who waits for frames that do not come shows that it is alive."""
    monkeypatch.setattr(_python_can, "HEARTBEAT", 0.3)
    await bus.open()

    await asyncio.sleep(1.5)

    assert bus.is_open


@pytest.mark.fault("C09")
@pytest.mark.longer
async def test_a_wall_clock_that_is_set_back_keeps_nobody(
    made: list[Scripted], bus: CanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """python-can alone waits for all the time that the clock has lost, and so hangs."""
    lost = iter([1_000_000.0])
    monkeypatch.setattr("can.bus.time", lambda: next(lost, 0.0))
    await bus.open()
    inbox = bus.frames(1)
    await asyncio.sleep(0.3)

    made[0].incoming.put(message(1, b"still"))
    assert (await inbox.take(timeout=PATIENCE)).data == b"still"
    begin = time.monotonic()
    await bus.close()
    assert made[0].shut.is_set()
    assert within(2.0, time.monotonic() - begin)

    # The trap: recv() of the package, by the wall clock.
    lost = iter([1_000_000.0])
    bare = Scripted("bare")
    waiting = threading.Thread(target=bare.recv, args=(0.01,), daemon=True)
    waiting.start()
    await asyncio.to_thread(waiting.join, 0.3)
    assert waiting.is_alive()
    bare.incoming.put(message(1))
    await asyncio.to_thread(waiting.join, PATIENCE)


async def test_a_send_that_blocks_keeps_only_its_sender(
    made: list[Scripted], bus: CanBus
) -> None:
    """It ends at its deadline; what waited behind it is not sent late."""
    await bus.open()
    made[0].go_on.clear()
    loop = asyncio.get_running_loop()
    begin = loop.time()

    with pytest.raises(DriverStuckError):
        await bus.send(1, b"first", timeout=0.1)
    with pytest.raises(DriverStuckError):
        await bus.send(1, b"second", timeout=0.1)

    assert loop.time() - begin < PATIENCE / 2
    assert bus.is_open
    made[0].go_on.set()
    await bus.send(1, b"third", timeout=PATIENCE)
    assert [bytes(each.data) for each in made[0].sent] == [b"first", b"third"]


@pytest.mark.fault("C04")
@pytest.mark.parametrize("number", [None, errno.ENOBUFS, errno.EAGAIN])
async def test_a_full_queue_is_tried_again(
    number: int | None, made: list[Scripted], bus: CanBus
) -> None:
    """However the interface says it."""
    await bus.open()
    made[0].send_error = can.CanOperationError("Transmit buffer full", number)
    sending = asyncio.create_task(bus.send(1, b"x", timeout=PATIENCE))
    await until(lambda: bus.stats.retries > 2)

    made[0].send_error = None
    await sending

    assert len(made[0].sent) == 1


async def test_a_send_that_fails_otherwise_is_a_loss(
    made: list[Scripted], bus: CanBus
) -> None:
    """The error of the package is in the message."""
    await bus.open()
    made[0].send_error = can.CanOperationError("no such device", errno.ENODEV)

    with pytest.raises(DeviceLostError, match="no such device"):
        await bus.send(1, b"x", timeout=PATIENCE)

    assert not bus.is_open


async def test_an_interface_that_opens_too_late_is_shut_again(
    made: list[Scripted], bus: CanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody has it, so nobody would ever close it."""
    monkeypatch.setattr(_python_can, "OPEN_TIMEOUT", 0.1)
    Scripted.opening.clear()

    with pytest.raises(DriverStuckError):
        await bus.open()
    Scripted.opening.set()

    await until(lambda: made and made[0].shut.is_set())


@pytest.mark.parametrize("is_up", [True, False])
async def test_the_bit_rate_that_is_wanted_is_that_of_the_interface(
    monkeypatch: pytest.MonkeyPatch, *, is_up: bool
) -> None:
    """python-can passes it over there; at another one nobody on the bus is heard."""
    found = Interface(7, is_up, 16, CanState.ACTIVE, 250_000, has_controller=True)
    monkeypatch.setattr(_python_can._can_interface, "look_up", lambda _name: found)
    bus = CanBus(name="drive", channel="can0", bitrate=500_000)

    with pytest.raises(ConfigError if is_up else DeviceLostError) as caught:
        await bus.open()
    assert ("is set to 250000, not 500000: ip link set" in str(caught.value)) is is_up
    await bus.close()


async def test_options_reach_python_can(made: list[Scripted]) -> None:
    """Bit rates and such; and that frames may be long."""
    bus = CanBus(
        name="drive",
        interface="scripted",
        channel="x",
        bitrate=500_000,
        fd=True,
        bitrate_switch=True,
    )
    await bus.open()
    inbox = bus.frames(1)

    await bus.send(2, bytes(12), timeout=PATIENCE)
    await bus.send(3, bytes(8), timeout=PATIENCE)
    made[0].incoming.put(message(1, bytes(64), is_fd=True))

    assert made[0].options == {"bitrate": 500_000, "fd": True}
    assert [each.is_fd for each in made[0].sent] == [True, False]
    assert [each.bitrate_switch for each in made[0].sent] == [True, False]
    assert len((await inbox.take(timeout=PATIENCE)).data) == 64
    await bus.close()


@pytest.mark.parametrize(
    ("interface", "options", "field"),
    [
        ("there_is_none", {}, "interface"),
        ("virtual", {"port": "none"}, "options"),
    ],
)
async def test_what_python_can_does_not_know_is_a_mistake(
    interface: str, options: dict[str, Any], field: str
) -> None:
    """The error says which key of the bus is wrong, and what there is."""
    bus = CanBus(name="drive", interface=interface, channel="x", **options)

    with pytest.raises(ConfigError) as caught:
        await bus.open()

    assert (caught.value.component, caught.value.field) == ("drive", field)
    assert interface in str(caught.value)
    await bus.close()


async def test_an_interface_that_is_not_there_is_a_loss() -> None:
    """It may come: the devices on it wait for it."""
    bus = CanBus(name="drive", channel="nocan9")
    with pytest.raises(DeviceLostError, match="socketcan nocan9 cannot be opened"):
        await bus.open()
    assert bus._look() is None
    await bus.close()
