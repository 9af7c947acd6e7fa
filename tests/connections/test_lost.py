"""What those get, again and again, who go on using a device that is lost."""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Awaitable, Callable

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Uses(esair.Behavior):
    """Reads the sonar and writes the wheels when a test says so."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)


async def depth_after(times: int, call: Callable[[], Awaitable[object]]) -> int:
    """Call so often; return how long the traceback of the last error is."""
    depth = 0
    for _ in range(times):
        try:
            await call()
        except esair.DeviceLostError as error:
            depth = len(list(traceback.walk_tb(error.__traceback__)))
    return depth


@pytest.mark.fault("D01", "D03")
async def test_the_error_of_a_lost_device_does_not_grow() -> None:
    """It is one error for all who ask while the device is lost, for hours maybe."""
    sonar, wheels, user = (
        FakeSensor("sonar", 1.0),
        FakeActuator("wheels", safe=0.0),
        Uses(),
    )
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]):
        sonar.unplug()
        wheels.unplug()
        await asyncio.sleep(0.1)

        for call in (user.sonar.read, lambda: user.wheels.write(0.1)):
            once = await depth_after(1, call)
            assert 0 < once == await depth_after(50, call)
