"""What comes from outside, and who goes on as soon as it is there."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

import pytest

import esair
from esair.loop import WAITS, Arrivals, LightTask, arrive

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("TURN-1")]


class Wire:
    """Brings messages in a callback of the loop, and a driver that waits for each."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.waiting: asyncio.Future[int] = self.loop.create_future()
        self.told: list[str] = []

    def drive(self) -> None:
        """Begin a call of a driver that waits for two messages."""

        async def driver() -> None:
            for _ in range(2):
                got = await self.waiting
                self.told.append(f"driver {got}")
                self.waiting = self.loop.create_future()

        light = LightTask(self.loop, "driver")
        assert light.begin(driver()) is WAITS
        light.then(lambda _value, error: self.told.append(f"ended {error}"))

    def bring(self, *messages: int) -> None:
        """Bring some messages in one callback."""
        with Arrivals.of(self.loop):
            for message in messages:
                self.told.append(f"came {message}")
                arrive(self.waiting, message)
        self.told.append("over")


async def in_callback(function: Callable[..., Any], *arguments: Any) -> None:
    """Call a function as the loop does, and wait for two turns."""
    asyncio.get_running_loop().call_soon(function, *arguments)
    await asyncio.sleep(0)
    await asyncio.sleep(0)


async def test_a_call_goes_on_in_the_callback_that_brings_its_answer() -> None:
    """No turn of the loop lies between."""
    wire = Wire()
    wire.drive()
    await in_callback(wire.bring, 1)
    await in_callback(wire.bring, 2)
    assert wire.told == [
        *("came 1", "driver 1", "over"),
        *("came 2", "driver 2", "ended None", "over"),
    ]


async def test_it_goes_on_when_all_that_came_is_there() -> None:
    """What came with its answer was there before it could ask for anything else."""
    wire = Wire()
    wire.drive()
    await in_callback(wire.bring, 1, 2)
    assert wire.told == ["came 1", "came 2", "driver 1", "over"]


async def test_a_task_goes_on_in_the_next_turn() -> None:
    """It may be anybody's; and nothing is stepped while one runs."""
    wire = Wire()

    async def waits() -> None:
        wire.told.append(f"task {await wire.waiting}")

    task = asyncio.create_task(waits())
    await asyncio.sleep(0)
    await in_callback(wire.bring, 1)
    await task
    assert wire.told == ["came 1", "over", "task 1"]

    wire.waiting, wire.told = wire.loop.create_future(), []
    wire.drive()
    wire.bring(2)
    assert wire.told == ["came 2", "over"]
    await asyncio.sleep(0)
    assert wire.told == ["came 2", "over", "driver 2"]


async def test_a_reader_goes_on_after_the_callback_that_has_brought_it() -> None:
    """In a turn of its own, as on every loop; the driver goes on at once."""
    wire = Wire()
    reading: asyncio.Future[str] = wire.loop.create_future()

    async def reader() -> None:
        wire.told.append(await reading)

    async def driver() -> None:
        arrive(reading, f"reads {await wire.waiting}")
        wire.told.append("published")

    task = asyncio.create_task(reader())
    await asyncio.sleep(0)
    light = LightTask(wire.loop, "driver")
    assert light.begin(driver()) is WAITS
    light.then(lambda _value, _error: None)
    await in_callback(wire.bring, 1)
    await task
    assert wire.told == ["came 1", "published", "over", "reads 1"]


async def test_what_came_before_others_began_to_come_is_not_lost() -> None:
    """One callback may bring what several parts of it bring by themselves."""
    wire = Wire()
    wire.drive()

    def bring_more() -> None:
        with Arrivals.of(wire.loop):
            arrive(wire.waiting, 1)
            with Arrivals.of(wire.loop):
                wire.told.append("more")
        wire.told.append("over")

    await in_callback(bring_more)
    assert wire.told == ["more", "driver 1", "over"]


async def test_who_was_cancelled_meanwhile_is_left_alone() -> None:
    """Neither its future nor anybody else suffers."""
    wire = Wire()

    def bring_and_cancel() -> None:
        with Arrivals.of(wire.loop):
            arrive(wire.waiting, 1)
            wire.waiting.cancel()
        wire.told.append("over")

    await in_callback(bring_and_cancel)
    assert wire.told == ["over"]


@pytest.mark.promise("BUS-3")
async def test_what_came_with_an_answer_answers_no_later_request(
    fake_serial: Any,
) -> None:
    """It was on the wire before the driver asked again."""
    line = fake_serial("line")
    line.on_write = lambda sent: b"1\n2\n" if sent == b"first\n" else b""

    class Asks(esair.Sensor[bytes]):
        deadline = 5.0

        async def read(self) -> bytes:
            first: bytes = await line.ask(b"first")
            with contextlib.suppress(esair.DriverStuckError):
                first += await line.ask(b"second", timeout=0.1)
            return first

    class User(esair.Behavior):
        asks = esair.reads(bytes)

    user = User()
    async with esair.Robot(
        resources=[Asks(bus=line, rate=0.01)], behaviors=[user]
    ) as robot:
        assert await user.asks.read(timeout=3.0) == b"1"
        assert line.stats.unheard == 1
        await robot.stop("seen")
