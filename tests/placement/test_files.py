"""A module that no path leads to: the robot's process has found it by its file."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

import esair
from esair import config

pytestmark = [pytest.mark.virtual_clock, pytest.mark.xdist_group("placement")]

MODULE = """
import esair
from esair.testing import FakeActuator
from {beside} import SPEED


class Drive(esair.Behavior):
    placement = "process"
    wheels = esair.writes(float)

    async def run(self):
        async for _ in esair.every(0.05):
            await self.wheels.write(SPEED)


robot = esair.Robot(resources=[FakeActuator("wheels", safe=0.0)], behaviors=[Drive()])
"""


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("name", ["of_a_file", "json"])
async def test_a_component_of_a_file_lives_in_a_process(
    name: str, tmp_path: Path
) -> None:
    """What lies beside it is found, too; one of a known name has another in the robot."""
    (tmp_path / f"beside_{name}.py").write_text("SPEED = 0.5\n")
    (tmp_path / f"{name}.py").write_text(MODULE.format(beside=f"beside_{name}"))
    found = config.find_robot(f"{tmp_path / name}.py:robot")
    assert isinstance(found, esair.Robot)
    async with found as robot:
        await asyncio.sleep(0.3)
        (wheels,) = robot.plan.resources
        assert 0.5 in wheels.commands  # type: ignore[attr-defined]
        assert robot.behaviors.query("drive").restarts == 0
