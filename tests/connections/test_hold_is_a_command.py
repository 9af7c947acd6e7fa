"""Where `esair.HOLD` is the safe command it may be written, like any safe command."""

import asyncio

import pytest

import esair
from esair.exceptions import BadValueError

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-12")]


class Arm(esair.Actuator[float]):
    """Goes to places, not too fast."""

    safe = esair.HOLD
    slew = 1.0
    limits = (0.0, 5.0)
    blocking = False

    def __init__(self) -> None:
        super().__init__()
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


@pytest.mark.promise("ROB-4")
async def test_nobody_slews_from_where_nobody_knows(user_of) -> None:
    """Until its driver has said where it stays, at each opening, commands are refused."""
    arm, user = Arm(), user_of("user", arm=esair.writes(float))
    arm.place = None
    async with esair.Robot(resources=[arm], behaviors=[user]) as robot:
        refused = await user.arm.write(3.0)
        assert not refused
        assert "has not said where it stays" in refused.rule
        arm.place = 2.0
        assert await user.arm.write(esair.HOLD)
        assert 2.0 <= (await user.arm.write(3.0)).command <= 2.2
        arm.place = None
        arm.report_lost()
        await asyncio.sleep(1.0)
        assert robot.resources.query("arm").losses == 1
        assert not await user.arm.write(3.0)


class Deaf(Arm):
    """Says nothing, as it declares."""

    def write(self, command: float) -> None:  # type: ignore[override]
        self.told.append(command)


async def test_a_driver_that_never_says_where_it_stays_has_no_slew() -> None:
    """It is a mistake, before the robot starts."""
    with pytest.raises(ExceptionGroup) as mistakes:
        await esair.Robot(resources=[Deaf()]).__aenter__()
    assert mistakes.group_contains(esair.ConfigError, match="deaf: slew: begins where")


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
