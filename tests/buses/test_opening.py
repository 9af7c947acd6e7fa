"""Opening a bus: shared by all who ask, ended by a close, and nothing left behind."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
from collections.abc import Iterator

import pytest

from esair.buses import Bus, I2CBus, Wire
from esair.exceptions import DeviceLostError
from esair.testing import FakeSerial


class Slow(Wire):
    """Opens when it is told to, in a thread, and counts what is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.begun = threading.Event()
        self.go = threading.Event()
        self.opened = threading.Event()
        self.closed = threading.Event()

    def open(self) -> Slow:
        self.begun.set()
        self.go.wait(30)
        self.opened.set()
        return self

    def close(self) -> None:
        self.closed.set()


@pytest.fixture
def slow() -> Iterator[Slow]:
    found = Slow()
    yield found
    found.go.set()


@pytest.mark.real_clock
@pytest.mark.fault("X09", "D21")
@pytest.mark.parametrize("finished", [False, True])
async def test_what_opens_after_a_close_is_closed(slow: Slow, finished: bool) -> None:
    """Also what is open, if the loop has not seen it yet: no descriptor is left."""
    bus = I2CBus(name="front", wire=slow)
    opening = asyncio.ensure_future(bus.open())
    assert await asyncio.to_thread(slow.begun.wait, 10)
    if finished:
        slow.go.set()
        assert slow.opened.wait(10)  # the thread is done, the loop has not looked

    await bus.close()
    slow.go.set()

    with pytest.raises(DeviceLostError, match="closed while it was opened"):
        await opening
    assert await asyncio.to_thread(slow.closed.wait, 10)
    assert not bus.is_open


@pytest.mark.real_clock
@pytest.mark.fault("D21")
async def test_what_opens_too_late_is_closed(
    slow: Slow, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody waits for it any more; the next opening gets another."""
    monkeypatch.setattr("esair.buses._link_bus.OPEN_TIMEOUT", 0.05)
    bus = I2CBus(name="front", wire=slow)

    with pytest.raises(DeviceLostError, match=r"0\.05 s"):
        await bus.open()
    slow.go.set()

    assert await asyncio.to_thread(slow.closed.wait, 10)
    await bus.open()
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("D18", "D21")
async def test_what_is_closed_behind_too_many_calls_is_closed(slow: Slow) -> None:
    """A close is not one more call that could be refused."""
    slow.go.set()
    bus = I2CBus(name="front", wire=slow)
    await bus.open()
    stuck = threading.Event()
    bus.executor.limit = 1
    calls = [asyncio.ensure_future(bus.executor.call(stuck.wait, timeout=20))]
    await asyncio.sleep(0)
    while bus.executor.waiting:  # noqa: ASYNC110 - nobody tells
        await asyncio.sleep(0.001)
    calls.append(asyncio.ensure_future(bus.executor.call(stuck.wait, timeout=20)))
    await asyncio.sleep(0)
    assert bus.executor.waiting == bus.executor.limit

    await bus.close()
    stuck.set()

    assert await asyncio.to_thread(slow.closed.wait, 10)
    await asyncio.gather(*calls)


class Waiting(Bus):
    """A bus that opens when it is told to."""

    def __init__(self) -> None:
        super().__init__(name="front")
        self.go = asyncio.Event()
        self.ended = 0

    async def _open(self) -> None:
        try:
            await self.go.wait()
        finally:
            await asyncio.sleep(0.01)  # it tidies up
            self.ended += 1

    async def _close(self) -> None:
        return None


@pytest.mark.virtual_clock
@pytest.mark.fault("X09")
async def test_a_close_ends_the_opening_and_cancels_nobody_who_waits_for_it() -> None:
    """They are told; a task that is cancelled though nobody asked would just be gone."""
    bus = Waiting()
    waiting = [asyncio.ensure_future(bus.open()) for _ in range(2)]
    await asyncio.sleep(0.01)

    await bus.close()

    assert bus.ended == 1
    results = await asyncio.gather(*waiting, return_exceptions=True)
    assert [type(each) for each in results] == [DeviceLostError] * 2


@pytest.mark.virtual_clock
@pytest.mark.parametrize("turns", range(4))
async def test_a_bus_opens_again_right_after_a_close(turns: int) -> None:
    """Nobody joins the opening that the close has ended, maybe before it began."""
    bus = Waiting()
    first = asyncio.ensure_future(bus.open())
    for _ in range(turns):
        await asyncio.sleep(0)
    await bus.close()
    bus.go.set()

    await bus.open()

    assert bus.is_open
    with contextlib.suppress(DeviceLostError):  # unless it began after the close
        await first
    await bus.close()


class Deaf(Waiting):
    """Opens however often it is asked to give up, and then holds something."""

    holds = 0

    async def _open(self) -> None:
        while not self.go.is_set():
            with contextlib.suppress(asyncio.CancelledError):
                await self.go.wait()
        self.holds += 1

    async def _close(self) -> None:
        self.holds = 0


@pytest.mark.virtual_clock
@pytest.mark.promise("CALL-1")
@pytest.mark.parametrize("late", [0.1, 1.0], ids=["in time", "too late"])
async def test_an_opening_that_cannot_be_ended_opens_nothing(late: float) -> None:
    """The close has returned long ago; nobody would ever close what is open then."""
    bus = Deaf()
    opening = asyncio.ensure_future(bus.open())
    await asyncio.sleep(0.01)
    asyncio.get_running_loop().call_later(late, bus.go.set)
    await bus.close()

    with pytest.raises(DeviceLostError):
        await opening
    await asyncio.sleep(0.01)
    assert (bus.is_open, bus.holds, bus.stats.opened) == (False, 0, 0)

    await bus.open()
    assert (bus.is_open, bus.holds) == (True, 1)
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("X09")
async def test_whoever_gives_up_waiting_leaves_the_opening_to_the_others() -> None:
    """One of two who wait is cancelled: it is, and the other gets an open bus."""
    bus = Waiting()
    one, other = (asyncio.ensure_future(bus.open()) for _ in range(2))
    await asyncio.sleep(0.01)
    one.cancel()
    bus.go.set()
    await other

    assert one.cancelled()
    assert bus.is_open
    await bus.close()


@pytest.mark.skipif(sys.version_info < (3, 12), reason="eager tasks came with 3.12")
@pytest.mark.virtual_clock
@pytest.mark.fault("D04")
async def test_a_lost_bus_opens_again_in_a_loop_with_eager_tasks() -> None:
    """Its opening may be over before anybody has noted that it began."""
    loop = asyncio.get_running_loop()
    loop.set_task_factory(asyncio.eager_task_factory)
    bus = FakeSerial("front")
    await bus.open()
    bus.lost(DeviceLostError("front", "gone"))

    await bus.open()

    assert bus.is_open
    assert bus.stats.opened == 2
    await bus.close()


class Door(Bus):
    """Takes three turns to open and to close, and notes what is under way."""

    def __init__(self) -> None:
        super().__init__(name="door")
        self.doing: list[str] = []
        self.overlaps = 0

    async def _open(self) -> None:
        await self._do("open")

    async def _close(self) -> None:
        await self._do("close")

    async def _do(self, what: str) -> None:
        self.overlaps += bool(self.doing)
        self.doing.append(what)
        try:
            for _ in range(3):
                await asyncio.sleep(0)
        finally:
            self.doing.remove(what)


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-1")
@pytest.mark.parametrize("turns", range(1, 9))
async def test_an_opening_waits_for_a_close_that_is_under_way(turns: int) -> None:
    """Another close is the same one: nobody has the wire while somebody lets it go."""
    bus = Door()
    await bus.open()
    closes = [asyncio.ensure_future(bus.close()) for _ in range(2)]
    for _ in range(turns):
        await asyncio.sleep(0)
    await bus.open()
    await asyncio.wait(closes)
    assert bus.is_open
    assert bus.stats.opened == 2
    assert bus.overlaps == 0
    await bus.close()


class Broken(Bus):
    """Holds something open as soon as it begins to open, and can fail after that."""

    def __init__(self) -> None:
        super().__init__(name="broken")
        self.holds: list[str] = []
        self.fails = False

    async def _open(self) -> None:
        assert not self.holds, "the opening before has left something"
        self.holds.append("wire")
        if self.fails:
            raise DeviceLostError(self.name, "there is nothing at its other end")

    async def _close(self) -> None:
        self.holds.clear()


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-1")
@pytest.mark.parametrize("fails", [True, False], ids=["in its opening", "later"])
async def test_what_is_lost_is_let_go_at_once(fails: bool) -> None:
    """Nobody has to close or to open it for that; its opening finds nothing left."""
    bus = Broken()
    bus.fails = fails
    with contextlib.suppress(DeviceLostError):
        await bus.open()
    bus.lost(DeviceLostError(bus.name, "gone"))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert not bus.holds

    bus.fails = False
    await bus.open()
    assert bus.holds == ["wire"]
    await bus.close()


class Sluggish(Broken):
    """Takes three turns to open, and as many until it lets go."""

    async def _open(self) -> None:
        await super()._open()
        for _ in range(3):
            await asyncio.sleep(0)

    async def _close(self) -> None:
        for _ in range(3):
            await asyncio.sleep(0)
        await super()._close()


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-1")
@pytest.mark.parametrize("opens", range(6))
@pytest.mark.parametrize("turns", range(9))
async def test_a_close_that_is_cancelled_leaves_nothing(opens: int, turns: int) -> None:
    """Whatever it waits for; the next opening waits until all is let go."""
    bus = Sluggish()
    opening = asyncio.ensure_future(bus.open())
    for _ in range(opens):
        await asyncio.sleep(0)
    closing = asyncio.ensure_future(bus.close())
    for _ in range(turns):
        await asyncio.sleep(0)
    closing.cancel()
    await asyncio.wait({opening, closing})
    with contextlib.suppress(DeviceLostError):
        opening.result()

    await bus.open()
    assert bus.is_open
    assert bus.holds == ["wire"]
    await bus.close()
    assert not bus.holds
