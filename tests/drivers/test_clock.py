"""The clock on the wall is a sensor: set in a test, kept in a recording."""

import asyncio
import time

import pytest

import esair
from esair.drivers.clock import Clock, FakeClock, WallTime


class Lamp(esair.Reaction):
    """On from seven to nine."""

    clock = esair.reads(WallTime)
    lamp = esair.writes(bool, blind="safe")

    def react(self, clock: WallTime) -> bool:
        return 7.0 <= clock.hours < 9.0


async def test_a_plan_of_the_day_is_tested_by_setting_the_clock(fake_actuator) -> None:
    """It goes with the robot's time, and a step forth or back counts at once."""
    clock = FakeClock("2026-03-29 06:59:58")
    lamp = fake_actuator("lamp", safe=False, command_timeout=3.0)

    async with esair.Robot(resources=[clock, lamp], behaviors=[Lamp()]):
        await asyncio.sleep(1.0)
        assert True not in lamp.commands
        await lamp.until(True, timeout=2.5)
        clock.set("2026-03-29 03:00:00")
        await lamp.until(False, timeout=1.5)


async def test_nobody_acts_on_a_clock_that_is_not_set(fake_actuator) -> None:
    """In 1970 it is lost, and what it switches is safe; it comes once it is set."""
    clock = FakeClock("1970-01-01 07:30:00")
    lamp = fake_actuator("lamp", safe=False, command_timeout=3.0)

    async with esair.Robot(resources=[clock, lamp], behaviors=[Lamp()]) as robot:
        await asyncio.sleep(1.5)
        assert robot.resources.query("clock").state is esair.ResourceState.LOST
        assert "it is not set" in str(robot.resources.query("clock").error)
        assert True not in lamp.commands
        clock.set("2026-03-29 07:30:00")
        await lamp.until(True, timeout=10.0)


@pytest.mark.parametrize(
    ("said", "offset", "hours", "weekday"),
    [
        ("2026-03-29 13:30:00", 3600.0, 13.5, 7),
        ("2026-03-30", -18_000.0, 0.0, 1),
        ("1970-01-01 00:00:00", 0.0, 0.0, 4),
    ],
)
def test_a_moment_is_told_as_people_say_it(said, offset, hours, weekday) -> None:
    """Hours, day and weekday are those of the zone."""
    moment = WallTime.of(said, offset)

    assert (moment.hours, moment.weekday, moment.date) == (hours, weekday, said[:10])
    assert str(moment).startswith(said)


def test_the_clock_of_this_computer_is_now() -> None:
    """In UTC, with the offset of its zone."""
    moment = Clock().read()

    assert abs(moment.unix - time.time()) < 5.0
    assert moment.offset == time.localtime().tm_gmtoff


def test_what_is_no_moment_is_told() -> None:
    """With what was expected."""
    with pytest.raises(esair.ConfigError, match="such as '2026-03-29 06:30'"):
        Clock(not_before="soon")
