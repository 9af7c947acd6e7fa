"""The search of a picture in a process of its own, which crashes."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("PLC-3")
async def test_it_stands_still_and_drives_on(monkeypatch, capsys):
    """An abort in the library is a crash of the reaction: safe, started again, on."""
    import asyncio

    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.delitem(sys.modules, "placed_eyes", raising=False)
    import placed_eyes

    told = ""
    async with placed_eyes.robot as robot:
        for _ in range(400):
            told += capsys.readouterr().out
            if told.count("drives") == 2:
                break
            await asyncio.sleep(0.05)
        assert robot.behaviors.query("eyes").restarts == 1
        assert robot.behaviors.query("eyes").placement == "process"
        assert robot.resources.query("camera").placement == "process"

    assert told.splitlines()[:3] == ["drives", "stands still", "drives"]
    assert not runpy.run_path(str(EXAMPLES / "placed_eyes.py"))["robot"].stopped
