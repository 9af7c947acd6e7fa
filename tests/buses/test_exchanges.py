"""Whose answer is what comes: late ones, lost ones, those of others."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from esair.buses import Exchanges
from esair.drivers.line import LineActuator, LineSensor
from esair.exceptions import DeviceLostError, DriverStuckError
from esair.testing import FakeSerial

pytestmark = pytest.mark.virtual_clock


class LateBoard:
    """Answers each line with its number, so many seconds later."""

    def __init__(self, line: FakeSerial, seconds: float) -> None:
        self.seconds = seconds
        self.lost = 0
        self.heard = 0
        self._line = line
        line.on_frame = self._hear

    def _hear(self, message: bytes) -> None:
        self.heard += 1
        if self.lost:
            self.lost -= 1
            return
        key = message.rstrip(b"?").partition(b"=")[0]
        mark = b"=" if message.endswith(b"?") else b":"
        answer = key + mark + b"%d" % self.heard
        asyncio.get_running_loop().call_later(self.seconds, self._line.say, answer)


@pytest.fixture
def line() -> FakeSerial:
    return FakeSerial("front", write_timeout=0.1)


@pytest.mark.promise("BUS-3")
async def test_silence_is_waited_for_as_long_as_something_is_owed(
    line: FakeSerial,
) -> None:
    """What was given up long before it was due is owed until then, and a while more."""
    exchanges = Exchanges(line, late_limit=0.1)
    loop = asyncio.get_running_loop()

    async def send(_left: float) -> None: ...

    asking = asyncio.ensure_future(exchanges.ask(send, b"a", timeout=0.5))
    await asyncio.sleep(0.01)
    asking.cancel()
    await asyncio.wait({asking})
    await exchanges.silence()
    assert loop.time() == pytest.approx(0.6, abs=0.02)


@pytest.mark.promise("ROB-5", "BUS-3")
def test_what_is_owed_ends_in_the_next_event_loop_too() -> None:
    """A robot that is run again has the same devices; its clock went with its loop."""
    exchanges = Exchanges(FakeSerial("front"), late_limit=0.05)

    async def send(_left: float) -> None: ...

    async def ask() -> None:
        with pytest.raises(TimeoutError):
            await exchanges.ask(send, b"a", timeout=0.01)

    async def wait() -> None:
        await exchanges.silence()
        assert not exchanges.unanswered

    asyncio.run(ask())
    assert exchanges.unanswered
    asyncio.run(wait())


@pytest.mark.promise("BUS-3")
async def test_a_late_answer_is_never_that_to_another_request(line: FakeSerial) -> None:
    """Twenty requests to a board that is slower than they wait: none is answered wrongly."""
    board = LateBoard(line, 0.15)
    await line.open()
    for _ in range(20):
        before = board.heard
        try:
            answer = await line.ask(b"range?", prefix=b"range=")
        except DriverStuckError:
            continue
        assert answer == b"range=%d" % (before + 1)
    assert line.stats.late >= 5
    board.seconds = 0.01
    await asyncio.sleep(0.3)
    assert await line.ask(b"range?") == b"range=%d" % board.heard
    await line.close()


@pytest.mark.promise("BUS-3")
@pytest.mark.parametrize("told", [False, True], ids=["asked", "told"])
async def test_cancelled_once_the_next_is_not_one_behind(
    line: FakeSerial, told: bool
) -> None:
    """As the driver of lines uses it: values, and acknowledgements."""
    board = LateBoard(line, 0.05)
    if told:
        part = LineActuator(name="speed", safe=0.0, ack=True, bus=line)

        async def use() -> float | None:
            return await part.write(1.0)
    else:
        use = LineSensor(name="range", ask=True, bus=line).read
    await line.open()
    cancelled = asyncio.create_task(use())
    await asyncio.sleep(0.01)
    cancelled.cancel()
    for number in range(2, 12):
        assert await use() == number
    assert board.heard == 11
    assert line.stats.late == 1
    await line.close()


@pytest.mark.promise("BUS-3")
async def test_an_answer_that_never_comes_is_owed_for_its_time(
    line: FakeSerial,
) -> None:
    """Then others of its kind are asked again; those of another kind never wait."""
    board = LateBoard(line, 0.01)
    board.lost = 1
    loop = asyncio.get_running_loop()
    await line.open()
    with pytest.raises(DriverStuckError):
        await line.ask(b"range?", prefix=b"range=")
    given_up = loop.time()
    assert await line.ask(b"speed?", prefix=b"speed=") == b"speed=2"
    assert loop.time() - given_up == pytest.approx(0.01)
    with pytest.raises(DriverStuckError):
        await line.ask(b"range?", prefix=b"range=")
    assert board.heard == 2
    assert await line.ask(b"range?", prefix=b"range=", timeout=1.0) == b"range=3"
    assert loop.time() - given_up == pytest.approx(0.41)
    await line.close()


async def test_numbers_tell_answers_apart_without_waiting(line: FakeSerial) -> None:
    """If they do not, what is late is still nobody's."""
    board = LateBoard(line, 0.01)
    board.lost = 1
    await line.open()
    loop = asyncio.get_running_loop()
    with pytest.raises(DriverStuckError):
        await line.ask(b"n?", answers=numbered(1))
    before = loop.time()
    assert await line.ask(b"n?", answers=numbered(2)) == b"n=2"
    assert loop.time() - before == pytest.approx(0.01)
    board.seconds = 0.15
    with pytest.raises(DriverStuckError):
        await line.ask(b"n?", answers=lambda _: True)
    assert await line.ask(b"n?", answers=lambda _: True, timeout=0.2) == b"n=4"
    assert line.stats.late == 1
    await line.close()


def numbered(number: int) -> Callable[[bytes], bool]:
    return lambda message: message == b"n=%d" % number


async def given_up(*asked: Coroutine[Any, Any, bytes]) -> None:
    """Send requests, and wait for none of them."""
    for each in asked:
        task = asyncio.ensure_future(each)
        await asyncio.sleep(0.001)
        task.cancel()
        await asyncio.wait({task})


@pytest.mark.promise("BUS-3")
async def test_an_answer_with_a_number_is_not_that_to_a_request_without(
    line: FakeSerial,
) -> None:
    """It was taken for the one that was owed; and what was owed, for the next one's."""
    await line.open()
    await given_up(line.ask(b"n?", prefix=b"n="))
    second = asyncio.ensure_future(line.ask(b"n?", prefix=b"n=", answers=numbered(2)))
    await asyncio.sleep(0.001)
    line.say(b"n=2")
    line.say(b"n=1")
    assert await second == b"n=2"
    await asyncio.sleep(0.001)
    assert line.stats.late == 1
    await line.close()


@pytest.mark.promise("BUS-3")
async def test_who_is_owed_a_number_is_owed_no_other(line: FakeSerial) -> None:
    """Else the answer to the oldest one would be the next one's."""
    await line.open()
    await given_up(
        line.ask(b"n?", prefix=b"n="),
        line.ask(b"n?", prefix=b"n=", answers=numbered(2)),
    )
    third = asyncio.ensure_future(line.ask(b"n?", prefix=b"n=", timeout=0.2))
    for seconds, message in ((0.01, b"n=2"), (0.02, b"n=1"), (0.03, b"n=3")):
        await asyncio.sleep(seconds)
        line.say(message)
    assert await third == b"n=3"
    assert line.stats.late == 2
    await line.close()


@pytest.mark.promise("BUS-3")
@pytest.mark.parametrize("late", [0.09, 0.3, 0.45])
@pytest.mark.parametrize("given_up", [0.0, 0.01, 0.095])
async def test_what_is_owed_counts_from_when_it_was_due(
    line: FakeSerial, late: float, given_up: float
) -> None:
    """Not from when it was given up: that may be at once, or after it has begun late."""
    board = LateBoard(line, late)
    await line.open()
    answered = 0
    for _ in range(30):
        asking = asyncio.ensure_future(line.ask(b"range?", prefix=b"range="))
        await asyncio.sleep(given_up)
        asking.cancel()
        await asyncio.wait({asking})
        for _ in range(3):
            before = board.heard
            try:
                answer = await line.ask(b"range?", prefix=b"range=", timeout=0.2)
            except DriverStuckError:
                continue
            assert answer == b"range=%d" % (before + 1)
            answered += 1
    assert answered or late > 0.2
    await line.close()


@pytest.mark.promise("BUS-3")
@pytest.mark.parametrize("outage", [0.0, 0.3, 60.0])
@pytest.mark.parametrize("late", [0.01, 0.05, 0.3])
async def test_what_is_owed_as_the_cable_is_pulled_is_owed_after_it(
    line: FakeSerial, late: float, outage: float
) -> None:
    """A device with power of its own answers as soon as it can: that is no other's answer."""
    board = LateBoard(line, 0.05)
    board.lost = 1
    await line.open()
    asked = asyncio.ensure_future(line.ask(b"range?"))
    await asyncio.sleep(0.01)
    line.unplug()
    await asyncio.wait({asked})
    assert isinstance(asked.exception(), DeviceLostError)
    await asyncio.sleep(outage)
    line.plug()
    asyncio.get_running_loop().call_later(late, line.say, b"range=1")
    await line.open()
    assert await line.ask(b"speed?") == b"speed=2"
    assert line.stats.late == 1
    await line.close()


async def test_who_is_owed_nothing_does_not_wait_after_a_replug(
    line: FakeSerial,
) -> None:
    """What was owed is owed once: the second replug costs nothing."""
    loop = asyncio.get_running_loop()
    line.answer(b"range?", b"range=1")
    await line.open()
    await given_up(line.ask(b"never?"))
    for waits in (0.4, 0.0):
        line.unplug()
        await asyncio.sleep(0.01)
        line.plug()
        before = loop.time()
        await line.open()
        assert loop.time() - before == pytest.approx(waits)
        assert await line.ask(b"range?") == b"range=1"
    await line.close()


async def test_a_loss_ends_those_too_who_wait_for_their_turn(line: FakeSerial) -> None:
    """They have asked on a line that is gone: nothing of theirs leaves on the next one."""
    await line.open()
    asked = [
        asyncio.ensure_future(line.ask(b"%d?" % number, timeout=5.0))
        for number in range(3)
    ]
    await asyncio.sleep(0.01)
    line.unplug()
    await asyncio.wait(asked, timeout=0.01)
    for each in asked:
        assert isinstance(each.exception(), DeviceLostError)
    line.plug()
    await line.open()
    await asyncio.sleep(1.0)
    assert list(line.sent) == [b"0?"]
    await line.close()
