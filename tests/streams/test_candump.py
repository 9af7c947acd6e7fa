"""A recorded log of CAN frames, at full speed, into sensors of a DBC file.

``rover.log.gz`` was recorded with ``esair demo --fast --seed 3 --record rover.log``.
"""

from __future__ import annotations

import asyncio
import importlib.resources
import os
from pathlib import Path

import can
import pytest

import esair
from esair.buses import CanBus
from esair.drivers.dbc import DbcSensor
from esair.drivers.wheel_motor import database

LOG = Path(__file__).with_name("rover.log.gz")
DBC = Path(str(importlib.resources.files("esair.drivers") / "wheel_motor.dbc"))
MESSAGES = ("WheelFeedbackLeft", "WheelFeedbackRight")


def recorded() -> list[can.Message]:
    with can.LogReader(LOG) as messages:
        return list(messages)


def of(message: str, frames: list[can.Message]) -> list[can.Message]:
    number = database().get_message_by_name(message).frame_id
    return [frame for frame in frames if frame.arbitration_id == number]


def sensors_on(bus: CanBus) -> dict[str, DbcSensor]:
    return {
        message: DbcSensor(
            name=f"wheel_{number}", bus=bus, database=DBC, message=message
        )
        for number, message in enumerate(MESSAGES)
    }


async def nothing_more(robot: esair.Robot, sensors: dict[str, DbcSensor]) -> None:
    """Wait until everything that was sent was read or dropped."""
    before = -1
    while (now := sum(taken(robot, each) for each in sensors.values())) != before:
        before = now
        await asyncio.sleep(0.2)


def taken(robot: esair.Robot, sensor: DbcSensor) -> int:
    return robot.sensors.channel(sensor.name).sequence + sensor.dropped


async def check(
    robot: esair.Robot, sensors: dict[str, DbcSensor], frames: list[can.Message]
) -> None:
    """Every frame became a reading or was counted, and the newest one is the last."""
    for message, sensor in sensors.items():
        assert taken(robot, sensor) == len(of(message, frames))
    await check_newest(robot, sensors, frames)


async def check_newest(
    robot: esair.Robot, sensors: dict[str, DbcSensor], frames: list[can.Message]
) -> None:
    """What was dropped is older than what was read."""
    for message, sensor in sensors.items():
        mine = of(message, frames)
        right = await robot.resources.register("me", sensor.name, esair.Access.READ)
        newest = await robot.sensors.read(right, max_age=60.0)
        assert newest.value == sensor.codec.decode(bytes(mine[-1].data))
        assert sensor.bad_frames == 0


@pytest.mark.fault("C07")
async def test_a_log_fed_at_once(fake_can) -> None:
    """What does not fit is dropped, oldest first, and counted."""
    bus, frames = fake_can("drive"), recorded()
    sensors = sensors_on(bus)

    async with esair.Robot(resources=sensors.values()) as robot:
        for frame in frames:
            bus.feed(frame.arbitration_id, bytes(frame.data))
        await nothing_more(robot, sensors)

        await check(robot, sensors, frames)
        assert bus.stats.received == len(frames)
        assert bus.stats.unheard == len(frames) - sum(
            len(of(message, frames)) for message in MESSAGES
        )


@pytest.mark.long
async def test_a_log_fed_in_its_own_time(fake_can) -> None:
    """At the pace of the recording nothing is dropped at all."""
    bus, frames = fake_can("drive"), recorded()
    sensors = sensors_on(bus)

    async with esair.Robot(resources=sensors.values()) as robot:
        now = frames[0].timestamp
        for frame in frames:
            if frame.timestamp > now:
                await asyncio.sleep(frame.timestamp - now)
                now = frame.timestamp
            bus.feed(frame.arbitration_id, bytes(frame.data))
        await nothing_more(robot, sensors)

        await check(robot, sensors, frames)
        assert sum(sensor.dropped for sensor in sensors.values()) == 0


@pytest.mark.real_clock
async def test_a_log_through_python_can() -> None:
    """As fast as another node can send, over an interface of python-can."""
    channel, frames = f"log-{os.getpid()}", recorded()
    bus = CanBus(name="drive", interface="virtual", channel=channel)
    sensors = sensors_on(bus)

    async with esair.Robot(resources=sensors.values()) as robot:
        await asyncio.sleep(0.05)  # the sensors begin to listen
        with can.Bus(channel, interface="virtual") as other:

            def send() -> None:
                for frame in frames:
                    other.send(frame)

            await asyncio.to_thread(send)
        await nothing_more(robot, sensors)
        # Where the loop is slower than the other node, the reading thread drops too.
        by_thread = bus.stats.dropped - sum(each.dropped for each in sensors.values())
        read = sum(taken(robot, each) for each in sensors.values())
        assert read + by_thread == sum(len(of(each, frames)) for each in MESSAGES)
        assert bus.stats.received == len(frames)
        await check_newest(robot, sensors, frames)
