"""The reflexes of reflex.toml, on simulated pins and without waiting."""

import asyncio
import sys
from pathlib import Path

import pytest

import esair
from esair.boards import stand_in

ROBOT = Path(__file__).parent / "reflex.toml"


@pytest.fixture
def pins(monkeypatch):
    """A board without anything connected."""
    for each in ("inputs", "outputs", "analog", "echoes"):
        monkeypatch.setattr(stand_in, each, {})
    monkeypatch.setitem(sys.modules, "machine", stand_in)
    return stand_in


@pytest.mark.virtual_clock
async def test_it_stops_on_a_computer(pins):
    """It cruises, and stands still while something is near."""
    pins.echoes[3] = 5000  # microseconds: 0.86 m

    async with esair.Robot.from_config(ROBOT):
        await asyncio.sleep(0.5)
        assert pins.outputs[16][-1] == 1_750_000  # half forward, in nanoseconds
        pins.echoes[3] = 1000
        await asyncio.sleep(0.5)
        assert pins.outputs[16][-1] == 1_500_000
