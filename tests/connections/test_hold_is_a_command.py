"""Where `esair.HOLD` is the safe command it may be written, like any safe command."""

import asyncio
from typing import Any

import pytest

import esair
from esair.exceptions import BadValueError
from esair.journal import Event, Kind
from esair.plan import examine

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-12")]


class Arm(esair.Actuator[float]):
    """Goes to places, not too fast."""

    safe = esair.HOLD
    slew = 1.0
    limits = (0.0, 5.0)
    blocking = False

    def __init__(self, name: str | None = None) -> None:
        super().__init__(name=name)
        self.told: list[object] = []
        self.place: float | None = 1.0

    def write(self, command: float) -> float | None:
        self.told.append(command)
        return self.place if command is esair.HOLD else None


class Move(esair.Behavior):
    arm = esair.writes(float)

    async def run(self) -> None:
        await self.arm.write(1.0)
        await asyncio.sleep(0.5)
        await self.arm.write(esair.HOLD)
        await asyncio.sleep(0.5)
        await self.arm.write(5.0)
        await asyncio.get_running_loop().create_future()


async def test_it_stays_and_goes_on_from_there() -> None:
    """HOLD reaches the driver; how fast the next may be counts from where it stays."""
    arm = Arm()
    async with esair.Robot(resources=[arm], behaviors=[Move()]):
        await asyncio.sleep(1.05)
    commands = [each for each in arm.told if isinstance(each, float)]
    assert arm.told[:3] == [esair.HOLD, 1.0, esair.HOLD]
    assert commands[0] == 1.0
    assert 1.0 < commands[1] <= 1.5


class Deaf(Arm):
    """Says nothing, as it declares."""

    def write(self, command: float) -> None:  # type: ignore[override]
        self.told.append(command)


@pytest.mark.promise("PRO-12")
def test_check_names_a_slew_that_begins_nowhere() -> None:
    """Its first command after each opening leaves as it is."""
    said = {
        (finding.component, finding.field)
        for actuator in (Deaf(), Arm())
        for finding in examine(esair.Robot(resources=[actuator]).plan)
    }
    assert ("deaf", "slew") in said
    assert ("arm", "slew") not in said


class Wheels(Arm):
    """Has a number that is safe."""

    safe = 0.0


async def test_elsewhere_it_is_no_command() -> None:
    """It is refused where it comes from, and the driver does not see it."""
    wheels = Wheels()
    errors: list[Exception] = []

    class Drive(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            try:
                await self.wheels.write(esair.HOLD)
            except BadValueError as error:
                errors.append(error)

    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        await robot.ended()
    assert "expected float, not esair.HOLD" in str(errors[0])
    assert esair.HOLD not in wheels.told


class Place(Arm):
    """Says where it stays when it is asked for nothing else, once at most."""

    def write(self, command: float) -> float | None:
        place, self.place = super().write(command), None
        return place


async def test_after_a_halt_it_goes_on_from_where_it_was_told_to_be() -> None:
    """What it was told last is where it stays, unless its driver says otherwise."""
    arm = Place(name="arm")
    user: Any = esair.Behavior(name="user", writes={"arm": esair.writes(float)})
    async with esair.Robot(resources=[arm], behaviors=[user]) as robot:
        arm.place = None
        for _ in range(20):
            await user.arm.write(3.0)
            await asyncio.sleep(0.2)
        assert arm.told[-1] == 3.0
        await robot.halt("a test")
        assert arm.told[-1] is esair.HOLD
        robot.resume()
        await user.arm.write(0.0)
        last = arm.told[-1]
        assert isinstance(last, float)
        assert 2.7 < last <= 3.0


@pytest.mark.promise("PRO-5")
async def test_a_guard_of_places_is_not_asked_about_it(fake_sensor: Any) -> None:
    """What is safe passes no guard: it would crash over what is no place."""

    class Low(esair.Reaction):
        roof = esair.reads(float)
        arm = esair.guards(float)

        def react(self, roof: float, arm: float) -> float:
            return min(roof, arm)

    arm: Any = Arm()
    mover: Any = esair.Behavior(name="mover", writes={"arm": esair.writes(float)})
    robot = esair.Robot(
        resources=[arm, fake_sensor("roof", 2.0)], behaviors=[Low(), mover]
    )
    async with robot:
        await asyncio.sleep(0.2)
        assert await mover.arm.write(esair.HOLD)
        assert await mover.arm.write(1.0)
        assert robot.behaviors.query("low").restarts == 0


@pytest.mark.promise("AC-2")
async def test_one_that_fails_has_not_ended_the_motion() -> None:
    """Nobody writes any more, so it is told to stay once more, and moves until then."""

    class Slips(esair.Actuator[float]):
        safe = esair.HOLD

        def __init__(self) -> None:
            super().__init__()
            self.told: list[object] = []

        async def write(self, command: float) -> None:
            self.told.append(command)
            if self.told == [esair.HOLD, 1.0, esair.HOLD]:
                raise OSError("slipped")

    arm = Slips()
    user: Any = esair.Behavior(
        name="user", writes={"arm": esair.writes(float, name="slips")}
    )
    robot = esair.Robot(resources=[arm], behaviors=[user])
    events: list[Event] = []
    robot.journal.listen(events.append)
    async with robot:
        await user.arm.write(1.0)
        with pytest.raises(esair.DeviceFaultError, match="slipped"):
            await user.arm.write(esair.HOLD)
        await asyncio.sleep(1.0)
        assert arm.told == [esair.HOLD, 1.0, esair.HOLD, esair.HOLD]
    unanswered = [each.value for each in events if each.kind is Kind.UNANSWERED]
    assert unanswered == [1.0]
