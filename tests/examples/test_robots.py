"""Four robots as the docs have people write them: short, checked, and held to their limits."""

import asyncio
from pathlib import Path

import pytest
from robots import follow_line, greenhouse_plan, rover, sorter

import esair
from esair.config import check
from esair.drivers.bme280 import Climate
from esair.drivers.clock import FakeClock
from esair.drivers.gamepad import Pad
from esair.drivers.servo import Goal

ROBOTS = Path(__file__).parents[2] / "examples" / "robots"


@pytest.mark.parametrize(
    ("name", "lines"),
    [("follow_line", 40), ("greenhouse_plan", 70), ("sorter", 100), ("rover", 45)],
)
def test_a_robot_is_short(name, lines) -> None:
    """Every line of the program and of its file counts, gaps and docstrings too."""
    files = [ROBOTS / f"{name}.py", ROBOTS / f"{name}.toml"]

    assert sum(len(each.read_text("utf-8").splitlines()) for each in files) <= lines


@pytest.mark.parametrize("name", ["follow_line", "greenhouse_plan", "sorter", "rover"])
def test_its_file_has_no_mistake(name) -> None:
    """Every driver, port and guard of it fits."""
    for package in ("gpiozero", "dynamixel_sdk"):
        pytest.importorskip(package)

    report = check(ROBOTS / f"{name}.toml")

    assert [each for each in report.findings if each.severity == "error"] == []


async def test_the_line_follower_turns_to_the_line(fake_sensor, fake_actuator) -> None:
    """To the side that sees it; nothing near is driven at, but away from."""
    eyes = [fake_sensor(f"{side}_eye", False, rate=50) for side in ("left", "right")]
    ahead = fake_sensor("ahead", 1.0)
    wheels = [fake_actuator(side, safe=0.0) for side in ("left", "right")]
    guards = [
        follow_line.Clear(
            name=f"clear_{side}", guards={"wheel": esair.guards(float, name=side)}
        )
        for side in ("left", "right")
    ]
    robot = esair.Robot(
        resources=[*eyes, ahead, *wheels], behaviors=[follow_line.Follow(), *guards]
    )

    async with robot:
        await wheels[0].until(0.4, timeout=1.0)
        eyes[0].feed(True)
        await wheels[0].until(0.1, timeout=0.2)
        assert wheels[1].commands[-1] == 0.4
        ahead.feed(0.1)
        await wheels[1].until(0.0, timeout=0.2)
        assert wheels[0].commands[-1] == 0.0


async def test_the_greenhouse_keeps_its_limits(fake_sensor, fake_actuator) -> None:
    """By the hour; never when it is warm or wet, nor while that is not known."""
    clock = FakeClock("2026-03-29 06:59:58")
    air = fake_sensor("air", Climate(14.0, 0.6, 101_325.0))
    soil = fake_sensor("soil", 2.7)
    heater, pump, lamp = (
        fake_actuator(name, safe=False, command_timeout=3.0)
        for name in greenhouse_plan.PLAN
    )
    robot = esair.Robot(
        resources=[clock, air, soil, heater, pump, lamp],
        behaviors=[
            greenhouse_plan.NotTooWarm(),
            greenhouse_plan.NotTooWet(),
            greenhouse_plan.Plan(),
        ],
    )

    async with robot:
        await heater.until(True, timeout=3.0)
        await pump.until(True, timeout=5.0)
        soil.feed(2.2)
        await pump.until(False, timeout=0.5)
        air.unplug()
        await heater.until(False, timeout=0.5)
        clock.set("2026-03-29 16:30:00")
        await lamp.until(True, timeout=2.5)


async def test_the_sorter_waits_for_its_eyes_and_for_hands(
    fake_sensor, fake_actuator
) -> None:
    """Eyes that crash cost a look; a hand in the curtain keeps every joint where it is."""

    class Weak(sorter.Eyes):
        looked = 0

        def find(self) -> sorter.Seen:
            type(self).looked += 1
            if self.looked % 2:
                raise OSError("the camera library has crashed")
            return super().find()

    hand = fake_sensor("hand", False)
    joints = [
        fake_actuator(name, safe=esair.HOLD, command_timeout=0.5)
        for name in ("base", "lift")
    ]
    grip = fake_actuator("grip", safe=False, command_timeout=0.5)
    curtains = [
        sorter.Curtain(
            name=f"curtain_{name}", guards={"joint": esair.guards(Goal, name=name)}
        )
        for name in ("base", "lift")
    ]
    place = sorter.Place()
    robot = esair.Robot(
        resources=[hand, *joints, grip], behaviors=[Weak(name="eyes"), place, *curtains]
    )

    async with robot:
        await grip.until(True, timeout=30.0)
        hand.feed(True)
        await asyncio.sleep(0.1)
        told = [len(joint.commands) for joint in joints]
        await asyncio.sleep(1.0)
        for joint, known in zip(joints, told, strict=True):
            assert not any(isinstance(each, Goal) for each in joint.commands[known:])
        assert place.placed == 0
        hand.feed(False)
        await asyncio.sleep(6.0)
    assert place.placed >= 1
    assert Weak.looked >= 2


async def test_the_rover_goes_as_the_hand_says(fake_sensor, fake_actuator) -> None:
    """Slower before a wall; a silent pad stops it, a silent range finder lets it back off."""
    ahead = Pad({"x": 0.0, "y": 1.0}, frozenset(), held=True)
    back = Pad({"x": 0.0, "y": -1.0}, frozenset(), held=True)
    turn = Pad({"x": 0.5, "y": 1.0}, frozenset(), held=True)
    pad, wall = fake_sensor("pad", ahead), fake_sensor("ahead", 5.0)
    wheels = [
        fake_actuator(side, safe=0.0, limits=(-1.0, 1.0)) for side in ("left", "right")
    ]
    guards = [
        rover.KeepClear(
            name=f"clear_{side}", guards={"wheel": esair.guards(float, name=side)}
        )
        for side in ("left", "right")
    ]
    robot = esair.Robot(
        resources=[pad, wall, *wheels], behaviors=[rover.Teleop(), *guards]
    )

    async with robot:
        for wheel in wheels:
            await wheel.until(0.6, timeout=1.0)
        pad.feed(turn)
        await wheels[1].until(lambda told: told < 0.5, timeout=0.5)
        assert wheels[0].commands[-1] == 0.8
        wall.feed(0.45)
        await wheels[0].until(lambda told: 0.0 < told <= 0.21, timeout=0.5)
        wall.unplug()
        await wheels[0].until(0.0, timeout=0.5)
        pad.feed(back)
        await wheels[0].until(-0.6, timeout=0.5)
        pad.unplug()
        await wheels[0].until(0.0, timeout=0.5)
