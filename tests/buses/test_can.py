"""The CAN bus on python-can's virtual interface, and on scripted links."""

from __future__ import annotations

import asyncio
import errno
import os
import threading
from collections.abc import Callable
from typing import Any

import can
import pytest

from esair.buses import CanBus, Frame, FrameLink
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceLostError,
    DriverStuckError,
)


class Link:
    """A node that does what a test says."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []
        self.full = 0
        self.error: Exception | None = None
        self.closed = 0
        self.opened = 0
        self.received: Callable[[Frame], None] = lambda _frame: None
        self.gone: Callable[[Exception], None] = lambda _error: None

    async def open(
        self, received: Callable[[Frame], None], gone: Callable[[Exception], None]
    ) -> FrameLink:
        self.opened += 1
        self.received, self.gone = received, gone
        return self

    async def send(self, frame: Frame) -> bool:
        if self.error is not None:
            raise self.error
        if self.full:
            self.full -= 1
            return False
        self.sent.append(frame)
        return True

    async def close(self) -> None:
        self.closed += 1


@pytest.mark.real_clock
async def test_frames_go_both_ways_through_python_can() -> None:
    """Without a descriptor one thread reads and another one writes."""
    channel = f"test-{os.getpid()}"
    bus = CanBus(name="drive", interface="virtual", channel=channel)
    await bus.open()
    other = can.Bus(channel, interface="virtual")
    inbox = bus.frames(0x181)

    other.send(
        can.Message(arbitration_id=0x181, data=b"\x01\x02", is_extended_id=False)
    )
    frame = await inbox.take(timeout=1)
    await bus.send(0x101, b"\x03")
    sent = await asyncio.to_thread(other.recv, 1.0)

    assert (frame.id, frame.data, frame.extended) == (0x181, b"\x01\x02", False)
    assert sent is not None
    assert (sent.arbitration_id, bytes(sent.data)) == (0x101, b"\x03")
    other.shutdown()
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("C06")
async def test_a_reader_that_dies_is_a_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever ends the reading thread reaches everybody who listens, once."""
    fail = threading.Event()

    class Broken(can.BusABC):
        channel_info = "broken"

        def __init__(self, channel: Any = None, **options: Any) -> None:
            super().__init__(channel, **options)

        def _recv_internal(self, timeout: float | None) -> tuple[None, bool]:
            if fail.wait(timeout):
                raise can.CanOperationError("network is down", errno.ENETDOWN)
            return None, False

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            raise NotImplementedError

    monkeypatch.setattr(can, "Bus", lambda channel, interface: Broken(channel))
    bus = CanBus(name="drive", interface="broken", channel="x")
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    inbox = bus.frames(1)
    reading = asyncio.create_task(inbox.take(timeout=2))
    await asyncio.sleep(0)

    fail.set()

    with pytest.raises(DeviceLostError, match="network is down"):
        await reading
    assert len(told) == 1
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("C01")
async def test_an_error_on_the_descriptor_is_told_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The descriptor is watched no more: one loss, no storm of callbacks."""
    near, far = os.pipe()
    calls = 0

    class Broken(can.BusABC):
        channel_info = "broken"

        def __init__(self, channel: Any = None, **options: Any) -> None:
            super().__init__(channel, **options)

        def fileno(self) -> int:
            return near

        def _recv_internal(self, timeout: float | None) -> tuple[None, bool]:
            nonlocal calls
            calls += 1
            raise can.CanOperationError("network is down", errno.ENETDOWN)

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            raise NotImplementedError

    monkeypatch.setattr(can, "Bus", lambda channel, interface: Broken(channel))
    bus = CanBus(name="drive", interface="broken", channel="x")
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()

    os.write(far, b"!")
    await asyncio.sleep(0.05)

    assert calls == 1
    assert len(told) == 1
    await bus.close()
    os.close(near)
    os.close(far)


@pytest.mark.real_clock
@pytest.mark.fault("C02")
async def test_bus_off_is_a_loss() -> None:
    """An error frame that says so ends the bus; others are counted."""
    channel = f"off-{os.getpid()}"
    bus = CanBus(name="drive", interface="virtual", channel=channel)
    await bus.open()
    inbox = bus.frames(1)
    other = can.Bus(channel, interface="virtual")

    other.send(
        can.Message(arbitration_id=0x04, is_error_frame=True, dlc=8, data=bytes(8))
    )
    other.send(
        can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8, data=bytes(8))
    )

    with pytest.raises(DeviceLostError, match="bus-off"):
        await inbox.take(timeout=1)
    assert bus.errors == 2
    other.shutdown()
    await bus.close()


@pytest.mark.virtual_clock
async def test_each_listener_gets_the_frames_with_its_ids() -> None:
    """What nobody listens to is counted."""
    link = Link()
    bus = CanBus(name="drive", opener=link.open)
    await bus.open()
    left, both = bus.frames(1), bus.frames(1, 2)

    for number in (1, 2, 3):
        link.received(Frame(number, b""))

    assert [frame.id for frame in (await left.take(),)] == [1]
    assert [(await both.take()).id, (await both.take()).id] == [1, 2]
    assert bus.unheard == 1
    both.close()
    link.received(Frame(2, b""))
    assert bus.unheard == 2
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("C07")
async def test_frames_that_nobody_takes_give_way_to_newer_ones() -> None:
    """Memory stays flat, whatever comes."""
    link = Link()
    bus = CanBus(name="drive", opener=link.open)
    await bus.open()
    inbox = bus.frames(1, limit=2)

    for number in range(10_000):
        link.received(Frame(1, number.to_bytes(2, "big")))

    assert len(inbox) == 2
    assert inbox.dropped == 9_998
    assert (await inbox.take()).data == (9_998).to_bytes(2, "big")
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("C04")
async def test_a_full_queue_is_tried_again_until_the_deadline() -> None:
    """A frame that finds room late is sent once; one that finds none is an error."""
    link = Link()
    bus = CanBus(name="drive", opener=link.open, send_timeout=0.1)
    await bus.open()
    loop = asyncio.get_running_loop()

    link.full = 3
    await bus.send(1, b"a")
    link.full = 10_000
    begin = loop.time()
    with pytest.raises(DriverStuckError, match=r"0\.1 s"):
        await bus.send(1, b"b")

    assert loop.time() - begin == pytest.approx(0.1, abs=1e-6)
    assert [frame.data for frame in link.sent] == [b"a"]
    await bus.close()


@pytest.mark.virtual_clock
async def test_a_newer_frame_makes_a_waiting_one_obsolete() -> None:
    """Of two commands with one id only the newer is sent."""
    link = Link()
    bus = CanBus(name="drive", opener=link.open)
    await bus.open()
    link.full = 1
    older = asyncio.create_task(bus.send(1, b"old"))
    await asyncio.sleep(0)

    await bus.send(1, b"new")

    with pytest.raises(BusyError):
        await older
    assert [frame.data for frame in link.sent] == [b"new"]
    assert bus.obsolete == 1
    await bus.close()


@pytest.mark.virtual_clock
async def test_a_failed_send_is_a_loss_of_the_bus() -> None:
    """The sender and everybody who listens learn of it."""
    link = Link()
    bus = CanBus(name="drive", opener=link.open)
    await bus.open()
    inbox = bus.frames(1)
    link.error = OSError(errno.ENETDOWN, "network is down")

    with pytest.raises(DeviceLostError, match="network is down"):
        await bus.send(1, b"")
    with pytest.raises(DeviceLostError):
        await inbox.take()
    assert not bus.is_open

    link.error = None
    await bus.open()
    await bus.send(1, b"again")
    assert (link.opened, link.closed) == (2, 1)
    await bus.close()


@pytest.mark.virtual_clock
async def test_what_a_former_opening_reports_is_ignored() -> None:
    """A late error of a link that was replaced does not take the new one down."""
    link = Link()
    bus = CanBus(name="drive", opener=link.open)
    await bus.open()
    former = link.gone
    former(ConnectionError("first"))
    await bus.open()

    former(ConnectionError("late"))

    assert bus.is_open
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("number", "data", "field"),
    [(0x800, b"", "id"), (-1, b"", "id"), (1, bytes(65), "data")],
)
async def test_what_is_no_frame_is_not_sent(
    number: int, data: bytes, field: str
) -> None:
    """The error names the part that is wrong."""
    link = Link()
    bus = CanBus(name="drive", opener=link.open)
    await bus.open()

    with pytest.raises(BadValueError) as caught:
        await bus.send(number, data)

    assert caught.value.field == field
    assert link.sent == []
    await bus.close()


async def test_a_bus_needs_a_channel() -> None:
    """Nothing is opened to find out."""
    with pytest.raises(ConfigError, match="channel"):
        CanBus(name="drive")
    bus = CanBus(name="drive", interface="there_is_none", channel="x")
    with pytest.raises(DeviceLostError, match="there_is_none"):
        await bus.open()
    await bus.close()
