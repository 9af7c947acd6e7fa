"""The fake CAN bus does what a test tells it, on either clock."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from esair.buses import CanState, Frame
from esair.exceptions import BadValueError, DeviceFaultError, DeviceLostError
from esair.testing import FakeCan

Make = Callable[..., FakeCan]


async def test_it_feeds_and_remembers(fake_can: Make) -> None:
    """What a test feeds arrives; what the robot sends is remembered in order."""
    can = fake_can()
    await can.open()
    inbox, extended = can.frames(0x181), can.frames(0x181, extended=True)

    can.feed(0x181, b"one")
    can.feed(0x181, b"two", extended=True)
    can.feed(0x181, remote=True)
    await can.send(0x101, b"a")
    await can.send(0x102, b"b", extended=True)

    assert (await inbox.take()).data == b"one"
    assert (await extended.take()).data == b"two"
    await can.until(0x102)
    assert [frame[:3] for frame in can.sent] == [
        (0x101, b"a", False),
        (0x102, b"b", True),
    ]
    assert can.sent[-1:] == [can.sent[1]]
    assert can.stats.bad_frames == 1
    await can.close()


async def test_a_listener_listens_until_its_block_ends(fake_can: Make) -> None:
    """What comes later is nobody's."""
    can = fake_can()
    await can.open()
    with can.frames(0x181) as frames:
        can.feed(0x181, b"one")
        assert (await frames.take()).data == b"one"
    can.feed(0x181, b"two")
    assert [frame async for frame in frames] == []
    await can.close()


async def test_a_frame_for_a_closed_bus_is_lost(fake_can: Make) -> None:
    """As on a wire."""
    can = fake_can()
    can.feed(1, b"early")
    await can.open()
    inbox = can.frames(1)
    with pytest.raises(TimeoutError):
        await inbox.take(timeout=1)
    await can.close()


@pytest.mark.parametrize(("number", "data"), [(0x800, b""), (1, bytes(9)), (1, "text")])
async def test_it_feeds_no_frame_that_is_none(
    fake_can: Make, number: Any, data: Any
) -> None:
    """A test that is wrong is told so."""
    with pytest.raises(BadValueError):
        fake_can().feed(number, data)


async def test_it_answers(fake_can: Make) -> None:
    """With a frame, several, or what a function makes of the question."""
    can = fake_can()
    await can.open()
    inbox = can.frames(1, 2, 3, 4)
    forget = can.answer(0x10, Frame(1, b""))
    can.answer(0x20, [Frame(2, b""), Frame(3, b"")])
    can.answer(0x30, lambda frame: Frame(4, frame.data))
    can.answer(0x30, lambda _frame: None, extended=True)

    await can.send(0x10, b"")
    await can.send(0x20, b"")
    await can.send(0x30, b"echo")
    await can.send(0x30, b"other", extended=True)
    taken = [await inbox.take(timeout=1) for _ in range(4)]
    forget()
    await can.send(0x10, b"")
    with pytest.raises(TimeoutError):
        await inbox.take(timeout=1)

    assert [frame.id for frame in taken] == [1, 2, 3, 4]
    assert taken[3].data == b"echo"
    await can.close()


async def test_until_looks_at_the_newest_frame_of_each_id(fake_can: Make) -> None:
    """What was sent counts; an older frame with the same id does not."""
    can = fake_can()
    await can.open()
    await can.send(1, b"old")
    await can.send(1, b"new")
    await can.send(2, b"")
    await can.until(2)

    assert (await can.until(1)).data == b"new"
    with pytest.raises(TimeoutError, match=r"can: .* did not come in 0\.5 s"):
        await can.until(lambda frame: frame.data == b"old", timeout=0.5)
    waiting = asyncio.create_task(can.until(lambda frame: frame.data == b"next"))
    await asyncio.sleep(0)
    await can.send(1, b"next")
    assert (await waiting).id == 1
    await can.close()


async def test_a_full_buffer_costs_a_retry_each(fake_can: Make) -> None:
    """After so many there is room."""
    can = fake_can()
    await can.open()
    can.full(3)

    await can.send(1, b"")

    assert can.stats.retries == 3
    await can.close()


async def test_stalled_it_takes_and_gives_nothing(fake_can: Make) -> None:
    """Then it goes on with what waited."""
    can = fake_can()
    await can.open()
    inbox = can.frames(1)
    can.stall()

    can.feed(1, b"held")
    with pytest.raises(DeviceFaultError):
        await can.send(2, b"")
    with pytest.raises(TimeoutError):
        await inbox.take(timeout=1)
    can.resume()

    assert (await inbox.take(timeout=1)).data == b"held"
    await can.send(2, b"")
    await can.close()


async def test_unplugged_it_is_lost_until_it_is_plugged_in(fake_can: Make) -> None:
    """The arrival is told; nothing is opened by that."""
    can = fake_can()
    arrivals: list[None] = []
    can.on_arrival(lambda: arrivals.append(None))
    await can.open()
    for n in range(1, 4):
        can.unplug()
        can.unplug()
        assert not can.is_open
        with pytest.raises(DeviceLostError, match="unplugged"):
            await can.open()
        can.plug()
        can.plug()
        assert (len(arrivals), can.is_open) == (n, False)
        await can.open()
    assert can.stats.lost == 3
    await can.close()


async def test_it_fails_as_it_is_told(fake_can: Make) -> None:
    """After so many good calls, so many times; the error is the test's."""
    can = fake_can()
    await can.open()
    can.fail(RuntimeError("told"), after=1, times=2)

    await can.send(1, b"")
    for _ in range(2):
        with pytest.raises(RuntimeError, match="told"):
            await can.send(1, b"")
    await can.send(1, b"")
    await can.close()


async def test_error_frames_by_state_or_by_class(fake_can: Make) -> None:
    """A state is what people mean; a class is what the kernel sends."""
    can = fake_can()
    states: list[CanState] = []
    can.on_state(states.append)
    await can.open()

    for state in (CanState.WARNING, CanState.PASSIVE, CanState.ACTIVE):
        can.error_frame(state)
    can.error_frame(0x08, bytes((0, 0, 0x04)))
    await asyncio.sleep(0.01)
    assert "bit stuffing error" in can.stats.last_error
    can.error_frame(CanState.BUS_OFF)
    await asyncio.sleep(0.01)

    assert states == [
        CanState.WARNING,
        CanState.PASSIVE,
        CanState.ACTIVE,
        CanState.BUS_OFF,
    ]
    assert not can.is_open
    await can.close()


@pytest.mark.real_clock
async def test_it_works_on_the_real_clock_too(fake_can: Make) -> None:
    """It has no thread and no descriptor."""
    can = fake_can("drive")
    can.answer(1, Frame(2, b"pong"))
    await can.open()
    inbox = can.frames(2)
    await can.send(1, b"ping")
    assert (await inbox.take(timeout=5)).data == b"pong"
    await can.close()


async def test_a_flood_is_bounded_while_it_is_stalled(fake_can: Make) -> None:
    """What does not fit is counted."""
    can = fake_can()
    await can.open()
    can.stall()
    for _ in range(2000):
        can.feed(1, b"")
    assert len(can._held) == 1024
    assert can.dropped == 2000 - 1024
    can.resume()
    await can.close()
