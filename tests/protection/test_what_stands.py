"""What stands on the wire: looked at again by guards, and never left half done."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from tests.supervisors.actors import turns

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Scale(esair.Reaction):
    """Lets as much pass as its sensor says."""

    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float:
        return wheels * sonar


class OneAtATime(FakeActuator[float]):
    """Counts the calls that are in it at a time."""

    inside = most = 0

    async def write(self, command: float) -> None:
        self.inside += 1
        self.most = max(self.most, self.inside)
        try:
            await super().write(command)
        finally:
            self.inside -= 1


def writer(**terms: Any) -> Any:
    return esair.Behavior(name="user", writes={"wheels": esair.writes(float, **terms)})


@pytest.mark.promise("PRO-8", "CALL-1")
async def test_less_of_what_is_in_flight_leaves_when_that_has_ended() -> None:
    """A device has one call at a time, whatever its guards say meanwhile."""
    sonar, user = FakeSensor("sonar", 1.0, type=float), writer()
    wheels = OneAtATime("wheels", safe=0.0, command_timeout=9.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Scale(), user]):
        await user.wheels.write(0.1)
        wheels.slow(0.05)
        writing = asyncio.create_task(user.wheels.write(0.8))
        for share in (0.5, 0.25):
            await asyncio.sleep(0.01)
            sonar.feed(share)
        await writing
        await asyncio.sleep(0.2)
        assert wheels.commands == [0.0, 0.1, 0.8, 0.2]
        assert wheels.most == 1


@pytest.mark.promise("PRO-8")
async def test_a_command_changes_no_faster_after_a_guard_has_made_less_of_it() -> None:
    """How fast it may change counts from when the device was told less."""
    sonar, user = FakeSensor("sonar", 1.0, type=float), writer()
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=9.0, slew=1.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Scale(), user]):
        await asyncio.sleep(1.0)
        await user.wheels.write(0.8)
        await asyncio.sleep(1.0)
        sonar.feed(0.5)
        await asyncio.sleep(0.1)
        sonar.feed(1.0)
        await asyncio.sleep(0.1)
        assert wheels.commands == [0.0, 0.8, 0.4]
        assert (await user.wheels.write(0.8)).command == pytest.approx(0.6)


@pytest.mark.promise("AC-4", "CALL-4")
@pytest.mark.parametrize("later", range(8))
async def test_safe_is_sent_again_after_a_motion_however_close_to_it(
    later: int,
) -> None:
    """The old motion ends in the turn in which safe has landed, or around it."""

    class Late(esair.Actuator[float]):
        safe = 0.0
        deadline = 0.05
        command_timeout = 9.0

        def __init__(self) -> None:
            super().__init__(name="wheels")
            self.does: list[float] = []
            self.go = asyncio.Event()

        async def write(self, command: float) -> None:
            while command and not self.go.is_set():
                try:
                    await self.go.wait()
                except asyncio.CancelledError:
                    continue  # it was given up, and goes on
            if command:
                await turns(later)
            elif self.does:  # the opening was told before
                await asyncio.sleep(0.01)
                self.go.set()
            self.does.append(command)

    wheels, user = Late(), writer()
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        with pytest.raises(esair.DriverStuckError):
            await user.wheels.write(1.0)
        robot.halt("a test")
        await asyncio.sleep(0.5)
        assert 1.0 in wheels.does
        assert wheels.does[-1] == 0.0


@pytest.mark.promise("PRO-2")
async def test_a_replacement_that_is_given_up_holds_nothing() -> None:
    """What it would have kept still moves, also where the old one has no word."""

    class Old(esair.Reaction):
        sonar = esair.reads(float)
        arm = esair.writes(float)

        def react(self, sonar: float) -> float:
            return 0.0

    class New(Old):
        eye = esair.reads(float)
        wheels = esair.writes(float, priority=50)

        def react(self, sonar: float, eye: float) -> Any:  # type: ignore[override]
            return {}

    parts = FakeSensor("sonar", 1.0, type=float), FakeSensor("eye", 1.0, type=float)
    arms = [FakeActuator(name, safe=0.0) for name in ("arm", "wheels")]
    user = writer()
    async with esair.Robot(
        resources=[*parts, *arms], behaviors=[Old(name="it"), user]
    ) as robot:
        assert await user.wheels.write(1.0)
        parts[1].stall()
        replacing = asyncio.create_task(robot.behaviors.replace("it", New()))
        await asyncio.sleep(0.1)
        refused = await user.wheels.write(1.0)
        assert (refused.holder, bool(refused)) == ("it", False)
        replacing.cancel()
        await asyncio.sleep(0.1)
        assert await user.wheels.write(1.0)
        assert not robot.actuators.protections.of("wheels")


@pytest.mark.promise("PRO-8", "PRO-9")
@pytest.mark.parametrize("before", ["nobody", "another"])
async def test_who_comes_when_nobody_guards_judges_what_stands(before: str) -> None:
    """What has latched it is that command, not one of former guards, or none at all."""

    class Latch(Scale):
        wheels = esair.guards(float, latch=True)
        asked: tuple[float, ...] = ()

        def react(self, sonar: float, wheels: float) -> float:
            self.asked += (wheels,)
            return super().react(sonar, wheels)

    sonar, user = FakeSensor("sonar", 0.5, type=float), writer()
    wheels: Any = FakeActuator("wheels", safe=0.0, command_timeout=9.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        if before == "another":
            await robot.behaviors.add(Scale(name="before"))
            await user.wheels.write(-0.4)
            await robot.behaviors.remove("before")
        await user.wheels.write(0.8)
        latch = Latch(name="latch")
        await robot.behaviors.add(latch)
        await asyncio.sleep(0.3)
        assert wheels.commands[-1] == 0.0
        robot.behaviors.reset("latch")
        assert latch.asked == (0.8,)
