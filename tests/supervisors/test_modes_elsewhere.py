"""Modes beside what else a robot has: recordings, processes, torture, and who looks."""

from __future__ import annotations

import ast
import asyncio
import io
from pathlib import Path

import pytest
from rich.console import Console
from tests.placement.parts import Avoid, Sonar, Twist

import esair
from esair.journal import Kind
from esair.replay import Replay
from esair.seat import screen
from esair.testing import FakeActuator
from esair.torture import Step, survive


class Wheel(esair.Actuator[float]):
    """Takes what it is told."""

    safe = 0.0
    command_timeout = 0.2

    async def write(self, command: float) -> None:
        """Nothing is connected."""


class Drive(esair.Behavior):
    """Writes its speed."""

    wheel = esair.writes(float)
    speed = 0.1

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            await self.wheel.write(self.speed)


class Captain(esair.Behavior):
    """Goes to and fro between both modes."""

    async def run(self) -> None:
        for mode in ("dock", "explore", "dock"):
            await asyncio.sleep(0.12)
            await self.supervisor.switch(mode, reason="its turn")


def made(record: Path | None = None) -> esair.Robot:
    explore, dock = Drive(name="wander"), Drive(name="docking")
    dock.speed = 0.5
    return esair.Robot(
        resources=[Wheel()],
        behaviors=[explore, dock, Captain()],
        modes={"explore": ["wander"], "dock": ["docking"]},
        mode="explore",
        policies=[esair.Policy.behaviors(allow={"captain": "manage"})],
        record=None if record is None else esair.Recording(record, min_free=0),
    )


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MODE-3", "REP-2")
def test_a_run_with_modes_is_recorded_and_repeated(tmp_path) -> None:
    """Each change is an event, and the same code changes at the same turn again."""
    esair.run(made(tmp_path / "run.mcap"), duration=0.6)
    changes: list[object] = []
    again = made()
    again.journal.listen(changes.append, kinds=(Kind.MODE,))

    outcome = Replay(tmp_path / "run.mcap").run(again)

    assert outcome.divergence is None
    assert outcome.equal > 20
    assert len(changes) >= 3


@pytest.mark.virtual_clock
@pytest.mark.promise("MODE-1", "OPS-2")
async def test_who_looks_sees_the_mode_and_who_rests() -> None:
    """In the picture of `esair top` and the page, in `why`, and in its text."""
    async with made() as robot:
        await asyncio.sleep(0.05)
        await robot.behaviors.command("mode dock tired")
        status = ast.literal_eval(await robot.behaviors.command("status"))

        assert (status["mode"], status["modes"]) == ("dock", ["explore", "dock"])
        states = {each["name"]: each["state"] for each in status["behaviors"]}
        assert states["wander"] == "resting"
        assert states["docking"] == "running"
        console = Console(width=100, file=io.StringIO())
        console.print(screen.picture(status, console, height=30))
        text = console.file.getvalue()
        assert "mode dock" in text
        assert "resting" in text
        assert "wander" in str(robot.resources.why("wheel"))


@pytest.mark.real_clock
@pytest.mark.xdist_group("placement")
@pytest.mark.promise("MODE-2", "PLC-1")
async def test_a_placed_component_rests_and_comes_back() -> None:
    """What it moved is safe while it rests; it has no process then."""
    wheels: FakeActuator[Twist] = FakeActuator("wheels", safe=Twist(0.0, 0.0))
    robot = esair.Robot(
        resources=[Sonar(), wheels],
        behaviors=[Avoid()],
        modes={"look": ["avoid"], "rest": []},
        mode="look",
    )
    async with robot:
        assert robot.behaviors.query("avoid").pid is not None
        await robot.behaviors.switch("rest")
        assert robot.behaviors.query("avoid").state is esair.BehaviorState.RESTING
        assert robot.behaviors.query("avoid").pid is None
        assert wheels.commands[-1] == Twist(0.0, 0.0)
        await robot.behaviors.switch("look")
        assert robot.behaviors.query("avoid").pid is not None


@pytest.mark.promise("MODE-3", "TOR-1")
def test_torture_goes_from_mode_to_mode() -> None:
    """A switch amid a crash and a loss leaves nothing that moves wrongly."""
    survive(
        f"{__file__}:made",
        [
            Step(1, "switch", "dock"),
            Step(1, "crash", "docking"),
            Step(2, "switch", "explore"),
            Step(2, "unplugged", "wheel", lasts=1),
        ],
    )
