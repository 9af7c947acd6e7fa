"""What has not come until a moment is over after all that is due at that moment."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import pytest

import esair
from esair.journal import Kind
from esair.loop import Deadlines, DeadMan, Order, Scheduler

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("TURN-2")]

MOMENT = 0.1


async def moment(order: tuple[str, ...]) -> list[str]:
    """Set what is due at one moment in some order; return the order of the effects."""
    loop = asyncio.get_running_loop()
    scheduler, deadlines, calls = Scheduler.of(loop), Deadlines.of(loop), []
    due = loop.time() + MOMENT

    def said(text: str) -> Any:
        return lambda *_: calls.append(text)

    setters = {
        "step": lambda: scheduler.at(due, said("step")),
        "deadline": lambda: deadlines.after(MOMENT, said("deadline")),
        "stale": lambda: deadlines.at(due, said("stale"), order=Order.STALE),
        "dead man": lambda: DeadMan(loop, lambda: due, said("dead man")).arm(),
    }
    for name in order:
        setters[name]()
    await asyncio.sleep(2 * MOMENT)
    return calls


async def test_one_moment_has_one_order_whatever_was_set_first() -> None:
    """A call that is over may still be told; the actuator is looked at last."""
    orders = ("step", "deadline", "stale", "dead man")
    for order in itertools.permutations(orders):
        assert await moment(order) == list(orders), order


class Beat(esair.Reaction):
    """Drives at each step."""

    rate = 5.0
    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return 1.0


async def drive(fake_sensor: Any, fake_actuator: Any, *, backwards: bool) -> list[Any]:
    """Let steps and the dead man of what they drive meet; return what was done."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=0.2)
    sonar = fake_sensor("sonar", 1.0, rate=5.0)
    resources = [wheels, sonar][:: -1 if backwards else 1]
    robot = esair.Robot(resources=resources, behaviors=[Beat()])
    done: list[Any] = []
    kinds = [Kind.SENT, Kind.SAFE, Kind.REFUSED]
    robot.journal.listen(
        lambda event: done.append((event.kind, event.component, event.value)),
        kinds=kinds,
    )
    async with robot:
        await asyncio.sleep(3.01)
        assert robot.journal.counts()["wheels"]["timeouts"] == 0
        return list(done)


async def test_a_step_comes_before_the_dead_man_of_the_same_moment(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Who writes once in each command timeout is heard of in time, in both orders."""
    forwards = await drive(fake_sensor, fake_actuator, backwards=False)
    backwards = await drive(fake_sensor, fake_actuator, backwards=True)
    assert forwards == backwards
    assert sum(each[0] is Kind.SENT for each in forwards) >= 15


class Receives(esair.Behavior):
    """Is handed something at the moment until which it waits for that."""

    restart = esair.Restart(max=0)
    had: Any = None

    async def hand(self) -> None:
        await asyncio.sleep(1.0)
        await self.put("receives", "in time")

    async def run(self) -> None:
        handing = asyncio.create_task(self.hand())
        self.had = await self.receive(timeout=1.0)
        await handing


@pytest.mark.promise("TURN-7", "BS-9")
async def test_what_is_put_at_the_last_moment_is_received() -> None:
    """The limit of a receive is over after all that happens at its moment."""
    receives = Receives()
    async with esair.Robot(behaviors=[receives]):
        await asyncio.sleep(2.0)
    assert receives.had == "in time"
