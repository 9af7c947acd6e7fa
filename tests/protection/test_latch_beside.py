"""A guard that latches does so beside any other guard of the same actuator."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-9")]


class Belt(esair.Behavior):
    """Wants to move all the time."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(0.3)


class Stop(esair.Reaction):
    """Lets nothing pass while the door is open, and from then on."""

    door = esair.reads(float)
    wheels = esair.guards(float, latch=True, priority=1)

    def react(self, door: float, wheels: float) -> float | None:
        return wheels if door > 0.5 else None


def beside(kind: str, priority: int) -> esair.Reaction:
    """Return another guard: it looks at the same sensor, or crashes when that is lost."""
    reads = "dist" if kind == "crashes" else "door"

    class Beside(esair.Reaction):
        restart = esair.Restart(max=100)
        seen = esair.reads(float, name=reads)
        wheels = esair.guards(float, priority=priority)
        raises = False

        def react(self, seen: float, wheels: float) -> float | None:
            if self.raises:
                self.raises = False
                raise ValueError("once")
            return None if kind == "refuses" and seen < 0.5 else wheels

    return Beside(name="beside")


@pytest.mark.parametrize("priority", [0, 5])
@pytest.mark.parametrize("kind", ["sees no more", "crashes", "refuses"])
async def test_another_guard_does_not_keep_it_open(kind: str, priority: int) -> None:
    """It stops in the same turn, before or after: nothing moves until the reset."""
    wheels = FakeActuator("wheels", safe=0.0)
    door = FakeSensor("door", 1.0, type=float, rate=7.0)
    dist = FakeSensor("dist", 1.0, type=float, rate=20.0)
    other: Any = beside(kind, priority)
    behaviors = [Belt(), Stop(), other]
    async with esair.Robot(
        resources=[wheels, door, dist], behaviors=behaviors
    ) as robot:
        await asyncio.sleep(1.03)
        assert wheels.commands[-1] == 0.3
        other.raises = kind == "crashes"
        if kind == "refuses":
            door.feed(0.1)
        else:
            door.unplug()
        await asyncio.sleep(0.3)
        assert wheels.commands[-1] == 0.0
        told = len(wheels.commands)
        if kind == "refuses":
            door.feed(1.0)
        else:
            door.plug()
        await asyncio.sleep(4.0)
        assert 0.3 not in wheels.commands[told:]
        robot.behaviors.reset("stop")
        await asyncio.sleep(0.2)
        assert wheels.commands[-1] == 0.3


@pytest.mark.parametrize("rate", [None, 30.0, 130.0])
@pytest.mark.parametrize("loss", ["unplug", "stall"])
async def test_a_reaction_does_not_keep_it_open(loss: str, rate: float | None) -> None:
    """It is blind at the same moment, and keeps the belt still: that was moving then."""

    class Near(esair.Reaction):
        door = esair.reads(float)
        wheels = esair.writes(float, priority=50)

        def react(self, door: float) -> float | None:
            return None

    wheels = FakeActuator("wheels", safe=0.0)
    door = FakeSensor("door", 1.0, type=float, rate=50.0)
    near, stop = Near(), Stop()
    if rate is not None:
        near.rate = stop.rate = rate
    async with esair.Robot(resources=[wheels, door], behaviors=[Belt(), near, stop]):
        await asyncio.sleep(1.0)
        assert wheels.commands[-1] == 0.3
        getattr(door, loss)()
        await asyncio.sleep(0.5)
        door.resume()
        door.plug()
        await asyncio.sleep(1.0)
        assert wheels.commands[-1] == 0.0


async def test_what_did_not_move_latches_nothing() -> None:
    """Another guard that stops meanwhile is not enough."""
    wheels = FakeActuator("wheels", safe=0.0)
    door = FakeSensor("door", 1.0, type=float, rate=7.0)
    behaviors = [Stop(), beside("sees no more", 5)]
    async with esair.Robot(resources=[wheels, door], behaviors=behaviors) as robot:
        await asyncio.sleep(1.0)
        door.unplug()
        await asyncio.sleep(0.3)
        door.plug()
        await asyncio.sleep(2.0)
        assert "latched" not in str(robot.resources.why("wheels"))


@pytest.mark.parametrize("how", ["raises", "wants more", "wants the driver to stay"])
async def test_one_that_fails_while_something_moves_latches(how: str) -> None:
    """It has let nothing pass: when it is back, nothing moves until the reset."""

    class Fails(Stop):
        restart = esair.Restart(delay=0.1)

        def react(self, door: float, wheels: float) -> Any:
            if door < 0.5 and how == "raises":
                raise ValueError("a bug")
            if door < 0.5:
                return 2 * wheels if how == "wants more" else esair.HOLD
            return wheels

    wheels = FakeActuator("wheels", safe=0.0)
    door = FakeSensor("door", 1.0, type=float, rate=20.0)
    async with esair.Robot(
        resources=[wheels, door], behaviors=[Belt(), Fails(name="stop")]
    ) as robot:
        await asyncio.sleep(0.5)
        door.feed(0.1)
        await wheels.until(0.0)
        told = len(wheels.commands)
        door.feed(1.0)
        await asyncio.sleep(2.0)
        assert 0.3 not in wheels.commands[told:]
        robot.behaviors.reset("stop")
        await wheels.until(0.3, timeout=0.5)


@pytest.mark.promise("RS-6")
async def test_a_refusal_says_since_when_it_is_latched() -> None:
    """Not since when the guard has seen."""
    wheels = FakeActuator("wheels", safe=0.0)
    door = FakeSensor("door", 1.0, type=float, rate=20.0)
    hand = esair.Behavior(name="hand", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels, door], behaviors=[Stop(), hand]):
        port: Any = hand.wheels  # type: ignore[attr-defined]
        assert await port.write(0.3)
        await asyncio.sleep(0.72)
        door.feed(0.1)
        assert await port.write(0.3)
        await wheels.until(0.0)
        latched = esair.now()
        await asyncio.sleep(1.0)
        assert (await port.write(0.3)).since == pytest.approx(latched)
