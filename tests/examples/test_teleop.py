"""The rover that is driven by hand."""

import asyncio
import math

import pytest
import teleop
from teleop import Stick, Twist

import esair

AHEAD = Stick(held=True, ahead=1.0, left=0.0)


def rover(
    pad: esair.Sensor, ahead: esair.Sensor, wheels: esair.Actuator
) -> esair.Robot:
    return esair.Robot(
        resources=[pad, ahead, wheels], behaviors=[teleop.Teleop(), teleop.KeepClear()]
    )


@pytest.mark.virtual_clock
async def test_it_never_reaches_the_wall_and_stops_when_the_pad_is_silent(
    capsys,
) -> None:
    """Full ahead all the time: it slows down before the wall, then the pad falls silent."""
    corridor = teleop.Corridor()

    async with teleop.make_robot(corridor):
        await asyncio.sleep(5.9)
        # 0.6 m/s from 3 m on, until 0.95 m; from there exponentially to 0.2 m.
        seconds = 5.9 - 0.5 - (3.0 - 0.95) / 0.6
        least = 0.2 + 0.75 * math.exp(-0.8 * seconds)
        assert corridor.move() == pytest.approx(least, abs=0.01)
        assert corridor.twist.linear == pytest.approx(0.8 * (least - 0.2), abs=0.01)
        await asyncio.sleep(0.6)
        assert corridor.twist == teleop.Wheels.safe
        assert corridor.move() > 0.3


async def test_letting_go_of_the_button_stops_at_once(
    fake_sensor, fake_actuator
) -> None:
    """The dead man's button: who is not held stands."""
    pad, ahead = (
        fake_sensor("pad", AHEAD, rate=20.0),
        fake_sensor("ahead", 5.0, rate=20.0),
    )
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))

    async with rover(pad, ahead, wheels):
        await wheels.until(Twist(0.6, 0.0), timeout=1.0)
        pad.feed(Stick(held=False, ahead=1.0, left=0.0))
        await wheels.until(Twist(0.0, 0.0), timeout=0.01)


async def test_a_gap_in_the_radio_stops_within_its_limit(
    fake_sensor, fake_actuator
) -> None:
    """And what the stick said before the gap is not done after it."""
    pad, ahead = (
        fake_sensor("pad", AHEAD, rate=20.0),
        fake_sensor("ahead", 5.0, rate=20.0),
    )
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))

    async with rover(pad, ahead, wheels):
        await wheels.until(Twist(0.6, 0.0), timeout=1.0)
        pad.unplug()
        await wheels.until(Twist(0.0, 0.0), timeout=0.35)
        told = len(wheels.commands)
        await asyncio.sleep(3.0)
        assert not any(command.linear for command in wheels.commands[told:])


async def test_without_eyes_it_only_backs_off(fake_sensor, fake_actuator) -> None:
    """The guard's ``blind`` lets what leads away from what it cannot see."""
    pad, ahead = (
        fake_sensor("pad", AHEAD, rate=20.0),
        fake_sensor("ahead", 5.0, rate=20.0),
    )
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))

    async with rover(pad, ahead, wheels):
        await wheels.until(Twist(0.6, 0.0), timeout=1.0)
        ahead.unplug()
        await wheels.until(lambda twist: twist.linear == 0.0, timeout=0.1)
        pad.feed(Stick(held=True, ahead=-0.5, left=0.0))
        await wheels.until(Twist(-0.3, 0.0), timeout=0.5)
