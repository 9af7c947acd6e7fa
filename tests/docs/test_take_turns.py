"""The robot of the page on turns."""

import asyncio
import importlib.util
from pathlib import Path

import pytest

from esair.config import check
from esair.testing import FakeActuator, FakeSensor

CODE = Path(__file__).parents[2] / "docs" / "code"


@pytest.mark.virtual_clock
async def test_it_explores_docks_and_charges() -> None:
    """Each mode begins when the one before has ended; the battery decides."""
    spec = importlib.util.spec_from_file_location("turns", CODE / "turns.py")
    assert spec is not None
    assert spec.loader is not None
    turns = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(turns)
    battery = FakeSensor("battery", 1.0)
    wheels = FakeActuator("wheels", safe=0.0)
    async with turns.make_robot(battery, wheels) as robot:
        await wheels.until(0.3, timeout=1.0)
        battery.feed(0.1)
        await wheels.until(0.1, timeout=1.0)
        assert robot.behaviors.mode == "dock"
        await asyncio.sleep(5.5)
        assert robot.behaviors.mode == "charge"
        assert wheels.commands[-1] == 0.0
        battery.feed(1.0)
        await wheels.until(0.3, timeout=1.0)
        assert robot.behaviors.mode == "explore"


def test_its_file_is_right() -> None:
    """The check finds no mistake, and warns of what moves without a guard."""
    assert check(CODE / "turns.toml").errors == 0
