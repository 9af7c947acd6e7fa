"""The page on what can go wrong when a behavior reads."""

import asyncio
import importlib.util
import re
from pathlib import Path

import pytest

import esair
from esair.testing import FakeSensor

DOCS = Path(__file__).parents[2] / "docs"


def watch():
    spec = importlib.util.spec_from_file_location(
        "reading", DOCS / "code" / "reading.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Watch()


@pytest.mark.virtual_clock
async def test_one_except_is_enough() -> None:
    """Unplugged, silent, removed: no value, a reason, and a value again afterwards."""
    sonar, behavior = FakeSensor("sonar", 1.5, type=float, rate=10.0), watch()
    async with esair.Robot(resources=[sonar], behaviors=[behavior]) as robot:
        await asyncio.sleep(1.0)
        for wrong, right in ((sonar.unplug, sonar.plug), (sonar.stall, sonar.resume)):
            assert (behavior.distance, behavior.trouble) == (1.5, "")
            wrong()
            await asyncio.sleep(3.0)
            assert behavior.distance is None
            assert "sonar" in behavior.trouble
            right()
            await asyncio.sleep(12.0)
        await robot.resources.remove("sonar")
        await asyncio.sleep(1.0)
        assert "removed" in behavior.trouble
        await robot.resources.add(FakeSensor("sonar", 2.5, type=float, rate=10.0))
        await asyncio.sleep(1.0)
        assert behavior.distance == 2.5
        assert robot.behaviors.query("watch").restarts == 0


def test_the_table_is_true() -> None:
    """Each error of it is an OSError; the two lines below it name the others."""
    page = (DOCS / "how-to" / "read-and-fail.md").read_text(encoding="utf-8")
    named = re.findall(r"^\| `(\w+)` \|", page, re.M)
    assert len(named) == 5
    assert all(issubclass(getattr(esair, name), OSError) for name in named)
    for name in ("StaleReadingError", "DriverStuckError"):
        assert issubclass(getattr(esair, name), TimeoutError)
    for name in ("DeviceLostError", "ResourceRemovedError"):
        assert issubclass(getattr(esair, name), ConnectionError)
    for name in ("UnknownNameError", "BadValueError"):
        assert f"`{name}`" in page
        assert not issubclass(getattr(esair, name), OSError)
    assert issubclass(esair.NotRegisteredError, PermissionError)
