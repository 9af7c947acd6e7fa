"""What the supervisors count, keep and tell, each to the last one."""

from __future__ import annotations

import asyncio
from typing import Any

import attrs
import pytest

import esair
from esair.messages import BehaviorState
from esair.supervisors._life import RestartBudget
from esair.testing import FakeActuator

pytestmark = pytest.mark.virtual_clock


class Idle(esair.Behavior):
    """Does nothing."""


async def turns(count: int = 3) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


@pytest.mark.promise("BS-3")
async def test_every_delivery_is_counted_once() -> None:
    """A put at once, one that waited, a get of what lies there, one that waited."""

    class Small(Idle):
        inbox_size = 1

    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        puts = asyncio.create_task(a.put("b", 2))
        await turns()
        await b.receive()
        await puts
        a.offer(3)
        assert await b.get("a") == 3
        waits = asyncio.create_task(b.get("a"))
        await turns()
        a.offer(4)
        assert await waits == 4
        assert robot.journal.counts()["behaviors"]["delivered"] == 4


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M13")
async def test_what_a_cancelled_asker_did_not_take_is_the_next_ones() -> None:
    """It was cancelled in the instant of its delivery: the oldest stays the first."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        waits = asyncio.create_task(a.get("b"))
        await turns()
        b.offer(1)
        b.offer(2)
        waits.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waits
        assert [await a.get("b"), await a.get("b")] == [1, 2]


@pytest.mark.promise("BS-4")
async def test_what_the_new_one_offers_answers_who_waits_once() -> None:
    """It has offered it in its set-up, before it took the place of the old one."""

    class Offers(Idle):
        async def setup(self) -> None:
            self.offer("new")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Idle(name="b")]) as robot:
        waits = asyncio.create_task(a.get("b", interval=5.0))
        await turns()
        await robot.behaviors.replace("b", Offers())
        assert await waits == "new"
        with pytest.raises(esair.BehaviorUnavailableError):
            await a.get("b", interval=0.1)


@attrs.frozen
class Fetch(esair.Request[int]):
    number: int


@pytest.mark.promise("BS-9")
async def test_orders_that_wait_are_the_new_ones_work() -> None:
    """It is woken for them, though it began to wait before it had any."""

    class Busy(esair.Behavior):
        orders = esair.takes(Fetch)

        async def run(self) -> None:
            await asyncio.sleep(1000)

    class Works(Busy):
        async def run(self) -> None:
            async for order in self.orders:
                async with order:
                    order.answer(order.number + 1)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Busy(name="b")]) as robot:
        waits = asyncio.create_task(a.ask("b", Fetch(1), timeout=5.0))
        await turns()
        await robot.behaviors.replace("b", Works())
        assert await waits == 2


@pytest.mark.promise("BS-1")
async def test_one_that_is_removed_is_stopping_until_it_has_ended() -> None:
    """Who asks meanwhile sees it, and who wants something of it is told."""
    seen: list[BehaviorState] = []

    class Slow(Idle):
        async def teardown(self) -> None:
            seen.append(robot.behaviors.query("slow").state)
            await asyncio.sleep(0.1)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Slow()]) as robot:
        removal = asyncio.create_task(robot.behaviors.remove("slow"))
        await asyncio.sleep(0.05)
        with pytest.raises(esair.BehaviorRemovedError):
            await a.put("slow", 1)
        await removal
    assert seen == [BehaviorState.STOPPING]


@pytest.mark.promise("RS-6")
@pytest.mark.fault("B02")
async def test_a_restart_that_was_asked_for_begins_with_a_full_budget() -> None:
    """Number, pauses and count, all three."""
    budget = RestartBudget(esair.Restart(max=2, within=10.0, delay=0.5))
    assert [budget.spend(0.0), budget.spend(1.0), budget.spend(2.0)] == [0.5, 1.0, None]
    assert budget.count == 2
    budget.fill()
    assert budget.count == 0
    assert [budget.spend(3.0), budget.spend(4.0), budget.spend(5.0)] == [0.5, 1.0, None]
    assert budget.spend(13.5) == 0.5 * 2.0  # the one of 4.0 still counts


@pytest.mark.promise("RS-3")
async def test_an_operation_whose_device_was_replaced_while_it_waited_is_told() -> None:
    """It waited for the device's settings; it is not done by the one that went."""
    done: list[str] = []

    class Lamp(FakeActuator[float]):
        power = esair.setting(0.5, min=0.0, max=2.0)

        def __init__(self, number: str) -> None:
            super().__init__("lamp", safe=0.0)
            self.number = number

        async def apply(self, *, power: float) -> None:
            await asyncio.sleep(0.5)

        @esair.operation
        async def blink(self) -> None:
            done.append(self.number)

    user: Any = esair.Behavior(
        name="user", writes={"lamp": esair.writes(float, configure=True)}
    )
    async with esair.Robot(resources=[Lamp("old")], behaviors=[user]) as robot:
        changes = asyncio.create_task(user.lamp.configure(power=1.0))
        await turns()
        blinks = asyncio.create_task(user.lamp.operate("blink"))
        await turns()
        await robot.resources.replace("lamp", Lamp("new"))
        results = await asyncio.gather(changes, blinks, return_exceptions=True)
        assert isinstance(results[1], esair.DeviceLostError)
        assert "old" not in done
