"""The rover at its fence, on two serial lines that are fakes."""

import asyncio
import subprocess
import sys
from pathlib import Path

import gps_fence
import pytest

import esair
from esair.drivers.gps import Fix

SCRIPT = Path(gps_fence.__file__)


def metres(robot, home=48.1):
    newest = robot.sensors.channel("position").newest.value
    assert isinstance(newest, Fix)
    return (newest.latitude_deg - home) * gps_fence.METRES_PER_DEGREE


@pytest.mark.virtual_clock
@pytest.mark.long
async def test_it_stays_inside_the_fence(capsys) -> None:
    """For minutes: out to the fence, back half of the way, and out again."""
    gps, board = gps_fence.fake_lines()
    places = []

    async with gps_fence.make_robot(gps, board) as robot:
        await asyncio.sleep(1.0)
        for _ in range(200):
            await asyncio.sleep(1.0)
            places.append(metres(robot))

    assert 19.0 < max(places) < 22.0
    turns = [
        place
        for before, place, after in zip(places, places[1:], places[2:], strict=False)
        if before < place > after
    ]
    assert len(turns) > 3
    assert board.sent[-1] == b"speed=0"
    assert "48.1" in capsys.readouterr().out


@pytest.mark.virtual_clock
@pytest.mark.fault("D01", "D04")
async def test_without_a_position_it_stands() -> None:
    """The cable of the GPS is pulled: the motor is safe, until the position is back."""
    gps, board = gps_fence.fake_lines()

    async with gps_fence.make_robot(gps, board) as robot:
        await asyncio.sleep(12.0)
        assert board.sent[-1] == b"speed=-1"
        gps.unplug()
        await asyncio.sleep(2.0)
        assert robot.behaviors.query("fence").state is esair.BehaviorState.PARKED
        assert board.sent[-1] == b"speed=0"
        gps.plug()
        await asyncio.sleep(2.0)
        assert robot.behaviors.query("fence").state is esair.BehaviorState.RUNNING
        assert board.sent[-1] != b"speed=0"

    assert board.sent[-1] == b"speed=0"


@pytest.mark.long
@pytest.mark.real_clock
def test_it_runs_as_a_script() -> None:
    """In real time, through pseudo-terminals, without an error."""
    ended = subprocess.run(
        [sys.executable, "-W", "error", SCRIPT],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )

    assert ended.stderr == ""
    assert ended.returncode == 0
    assert len(ended.stdout.splitlines()) >= 5
