"""Code that is swapped in and out again and again leaves nothing behind."""

from __future__ import annotations

import asyncio
import gc
import types
import weakref
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock

SWAPS, SOAK_SWAPS = 150, 10_000

CODE = """
import asyncio
import esair

class Part(esair.Behavior):
    sonar = esair.reads(float)
    wheels = esair.writes(float)

    async def setup(self):
        self.child = asyncio.create_task(asyncio.sleep(1000))
        self.offer(self)

    async def run(self):
        async for value in self.sonar:
            await self.wheels.write(value)

class Turn(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=1)

    def react(self, sonar):
        return sonar

class Sonar(esair.Sensor[float]):
    async def read(self):
        return 1.0
"""


def fresh_module(number: int) -> types.ModuleType:
    """Load the same code anew, as a developer does who has changed it."""
    module = types.ModuleType(f"part_{number}")
    exec(CODE, vars(module))
    return module


@pytest.mark.promise("SUP-2")
@pytest.mark.fault("L11")
async def test_swaps_leave_no_old_code_behind(request: pytest.FixtureRequest) -> None:
    """Of all modules that were swapped out not one is still in memory."""
    swaps = SOAK_SWAPS if request.config.getoption("--esair-soak") else SWAPS
    sonar, wheels = FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)
    old: list[weakref.ref[Any]] = []
    async with esair.Robot(resources=[sonar, wheels]) as robot:
        module = fresh_module(0)
        await robot.behaviors.add(module.Part(name="part"))
        await robot.behaviors.add(module.Turn(name="turn"))
        for number in range(swaps):
            old += [weakref.ref(module), weakref.ref(module.Part)]
            module = fresh_module(number + 1)
            part, turn = module.Part(name="part"), module.Turn(name="turn")
            old += [weakref.ref(part), weakref.ref(turn)]
            await robot.behaviors.replace("part", part)
            await robot.behaviors.replace("turn", turn)
            if number % 10 == 0:
                await robot.resources.replace("sonar", module.Sonar())
                await asyncio.sleep(0.01)
        del part, turn, module
        for name in ("part", "turn"):
            await robot.behaviors.remove(name)
        await robot.resources.replace("sonar", FakeSensor("sonar", 1.0))
        await asyncio.sleep(1.0)
        gc.collect()

        assert [ref() for ref in old if ref() is not None] == []
        assert robot._behaviors.zombie_count == 0
