"""The rover of the demo, with a sensor that is unplugged, is repeated from its recording."""

from __future__ import annotations

import asyncio
import importlib.resources
from pathlib import Path

import pytest

import esair
from esair.config import build, load
from esair.journal import Kind
from esair.loop import TurnLoop
from esair.recording import events_of
from esair.replay import Replay
from esair.sim import Simulation

pytestmark = pytest.mark.real_clock

FILE = Path(str(importlib.resources.files("esair.demo").joinpath("robot.toml")))


def rover(record: Path | None = None) -> esair.Robot:
    """Return the robot of the demo."""
    recording = None if record is None else esair.Recording(record, min_free=0)
    return build(
        load(FILE, simulated=True), lambda **o: esair.Robot(**o, record=recording)
    )


async def drive(robot: esair.Robot, simulation: Simulation | None) -> None:
    """Pull the range finder and the bumper out while it drives, and put them back."""
    async with robot:
        for seconds, plugged in ((0.4, False), (0.3, True), (0.5, True)):
            await asyncio.sleep(seconds)
            for line in (simulation.front, simulation.skirt) if simulation else ():
                (line.plug if plugged else line.unplug)()


@pytest.mark.long
@pytest.mark.promise("REP-2", "TURN-6")
def test_a_run_with_unplugged_sensors_is_repeated(tmp_path: Path) -> None:
    """Serial lines, CAN, I²C, a coroutine that plans: equal to the end."""
    path = tmp_path / "run.mcap"

    async def live() -> None:
        async with Simulation() as simulation:
            await drive(rover(path), simulation)

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(live())
    kinds = [event.kind for event in events_of(path)]
    assert kinds.count(Kind.DOWN) == 2
    assert kinds.count(Kind.READING) > 20

    outcome = Replay(path).run(rover(), lambda robot: drive(robot, None))
    assert outcome.divergence is None
    assert outcome.equal > 100
