"""A device on a serial line is pulled and plugged in again and again, in a robot."""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading

import pytest

import esair
from esair.drivers.line import LineActuator, LineSensor
from esair.drivers.line.fake import FakeBoard
from esair.testing import FakeSerial


class Follow(esair.Behavior):
    """Drives while it sees, whatever is pulled."""

    sight = esair.reads(float, max_age=1.0)
    speed = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            with contextlib.suppress(esair.DeviceLostError, esair.StaleReadingError):
                await self.speed.write(await self.sight.read() / 2)


async def replug(times: int, rest: float) -> None:
    line = FakeSerial("board")
    FakeBoard(line, {"sight": 1.0}, {"speed": 0.0}, period=0.02)
    resources = [
        LineSensor(name="sight", bus=line),
        LineActuator(name="speed", safe=0.0, bus=line),
    ]
    async with esair.Robot(resources=resources, behaviors=[Follow()]) as robot:
        await line.until(b"speed=0.5", timeout=10.0)
        tasks = len(asyncio.all_tasks())
        threads, descriptors = (
            threading.active_count(),
            len(os.listdir("/proc/self/fd")),
        )

        for _ in range(times):
            line.unplug()
            await asyncio.sleep(rest)
            line.sent.clear()
            line.plug()
            await line.until(b"speed=0.5", timeout=10.0)

            armed = list(line.sent)
            assert armed.index(b"speed=0") < armed.index(b"speed=0.5")

        assert line.stats.lost == times
        assert line.stats.opened == times + 1
        for name in ("sight", "speed"):
            assert robot.resources.query(name).state is esair.ResourceState.READY
        assert robot.behaviors.query("follow").restarts == 0
        assert threading.active_count() <= threads
        assert len(os.listdir("/proc/self/fd")) <= descriptors
        assert len(asyncio.all_tasks()) <= tasks + 2
    assert line.sent[-1] == b"speed=0"


@pytest.mark.long
@pytest.mark.virtual_clock
@pytest.mark.fault("D04", "D01")
@pytest.mark.promise("RES-2")
async def test_a_hundred_times_on_the_virtual_clock() -> None:
    """Safe is the first word each time; nothing is left over, nobody restarts."""
    await replug(100, rest=0.5)


@pytest.mark.real_clock
@pytest.mark.fault("D04", "D01", "D19")
@pytest.mark.promise("RES-2")
@pytest.mark.long
async def test_twenty_times_through_the_kernel() -> None:
    """The same with descriptors and a thread."""
    await replug(20, rest=0.05)
