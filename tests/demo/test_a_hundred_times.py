"""Each device of the demo, pulled and put back a hundred times."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable

import pytest

import esair
from esair.buses import Frame
from esair.demo import Bumper, Odometry, RangeFinder, Scan, Touch, Travel, Twist, Wheels
from esair.drivers.mpu6050 import Motion, Mpu6050
from esair.drivers.wheel_motor import LEFT, RIGHT, command_id, decode_command
from esair.sim import SimCanBus, SimI2CBus, SimSerialBus, Simulation

LOST, FAILED = esair.ResourceState.LOST, esair.BehaviorState.FAILED

SIDES = {command_id(LEFT): LEFT, command_id(RIGHT): RIGHT}


class Drive(esair.Behavior):
    """Drives while it hears from every sensor."""

    ranges = esair.reads(Scan, max_age=0.5)
    bumper = esair.reads(Touch, max_age=0.5)
    odometry = esair.reads(Travel, max_age=0.5)
    imu = esair.reads(Motion, max_age=0.5)
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            for port in (self.ranges, self.bumper, self.odometry, self.imu):
                await port.read()
            await self.wheels.write(Twist(0.1, 0.0))


class Commands:
    """What each wheel was told, in order: whether it may move."""

    def __init__(self, simulation: Simulation) -> None:
        self.told: dict[int, list[bool]] = {LEFT: [False], RIGHT: [False]}
        simulation.on_frame = self._note

    def _note(self, _time: float, frame: Frame) -> None:
        side = SIDES.get(frame.id)
        if side is not None:
            self.told[side].append(decode_command(side, frame.data).enable)

    def moving_since(self, at: dict[int, int]) -> bool:
        return all(True in told[at[side] :] for side, told in self.told.items())

    def last(self) -> set[bool]:
        return {told[-1] for told in self.told.values()}


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(30):
        while not condition():  # noqa: ASYNC110 - the clock is virtual
            await asyncio.sleep(0.01)


DEVICES = pytest.mark.parametrize("which", ["front", "skirt", "drive", "body"])


@pytest.mark.long
@DEVICES
@pytest.mark.virtual_clock
@pytest.mark.promise("RES-2", "BUS-1")
@pytest.mark.fault("D01", "D04", "C01")
async def test_a_device_pulled_a_hundred_times(which: str) -> None:
    """Nothing is lost or left, and motion begins anew from the safe command."""
    await pull_and_put_back(which, 100)


@DEVICES
@pytest.mark.real_clock
@pytest.mark.long
async def test_a_device_on_a_real_wire(
    which: str, request: pytest.FixtureRequest
) -> None:
    """The same with descriptors and threads; a hundred times with --esair-soak."""
    await pull_and_put_back(
        which, 100 if request.config.getoption("--esair-soak") else 4
    )


async def pull_and_put_back(which: str, times: int) -> None:
    async with Simulation(seed=1) as simulation:
        buses = {
            "front": SimSerialBus(name="front", line="front"),
            "skirt": SimSerialBus(name="skirt", line="skirt"),
            "drive": SimCanBus(name="drive"),
            "body": SimI2CBus(name="body"),
        }
        resources: list[esair.Resource] = [
            RangeFinder(name="ranges", bus=buses["front"]),
            Bumper(bus=buses["skirt"]),
            Odometry(bus=buses["drive"]),
            Mpu6050(name="imu", bus=buses["body"]),
            Wheels(bus=buses["drive"]),
        ]
        wire, bus = getattr(simulation, which), buses[which]
        devices = [each.name for each in resources if each.bus is bus]
        commands = Commands(simulation)
        async with esair.Robot(resources=resources, behaviors=[Drive()]) as robot:

            def states() -> set[esair.ResourceState]:
                return {robot.resources.query(each).state for each in devices}

            def users() -> list[tuple[str, ...]]:
                return [robot.resources.query(each.name).users for each in resources]

            await until(lambda: commands.last() == {True})
            users_before, tasks_before = users(), len(asyncio.all_tasks())

            for _ in range(times):
                wire.unplug()
                await until(lambda: states() == {LOST})
                if which != "drive":
                    await until(lambda: commands.last() == {False})
                at = {side: len(told) for side, told in commands.told.items()}
                wire.plug()
                await until(functools.partial(commands.moving_since, at))
                for side, told in commands.told.items():
                    fresh = told.index(True, at[side])
                    assert told[fresh - 1] is False, "it moved before it was safe"

            assert users() == users_before
            # A reading may be under way; what is left over would stay.
            await until(lambda: len(asyncio.all_tasks()) <= tasks_before)
            assert bus.stats.lost == times
            assert robot.behaviors.query("drive").state is not FAILED
        assert commands.last() == {False}
