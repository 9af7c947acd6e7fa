"""A robot with processes of its own is repeated, however late those are this time."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.placement.pitfalls import Decides
from tests.replay.soak import folder_of_robot, recorded, told_by
from tests.replay.test_replay import verbs

import esair
from esair.journal import Kind
from esair.loop import Player, TapeWriter, TurnLoop
from esair.testing import FakeActuator, FakeSensor

pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.long,
    pytest.mark.xdist_group("placement"),
]

LATE = """
import sys, time
if "esair.placement._nursery" in " ".join(sys.orig_argv):
    time.sleep(2.0)
"""

IMPATIENT = """
import esair.loop._tape
from esair.cli import main
esair.loop._tape.PATIENCE = {}
main(["replay", "run.mcap"])
"""


@pytest.mark.promise("PLC-7", "REP-2")
async def test_a_repetition_waits_until_processes_can_be_made(tmp_path: Path) -> None:
    """How long that takes is not in the recording: on a busy computer it is longer."""
    told = await recorded("placed", 1, 1.0, tmp_path)
    assert told.code == 0, told.text
    (tmp_path / "sitecustomize.py").write_text(LATE)
    words = ["-c", IMPATIENT.format(1.0)]
    told = await told_by(tmp_path, *words, hash_seed=2, patience=60.0)
    assert told.text.startswith("equal"), told.text


@pytest.mark.promise("REP-2")
async def test_a_repetition_says_whom_it_has_not_waited_for(tmp_path: Path) -> None:
    """Else it would seem that who comes too late decides otherwise."""
    told = await recorded("placed", 1, 0.5, tmp_path)
    assert told.code == 0, told.text
    with (tmp_path / "robots.py").open("a") as module:
        module.write(LATE)
    words = ["-c", IMPATIENT.format(0.1)]
    told = await told_by(tmp_path, *words, hash_seed=2, patience=60.0)
    assert "was waited for in vain" in told.text, told.text


@pytest.mark.promise("PLC-7", "REP-2")
async def test_who_lived_elsewhere_for_one_run_does_so_in_its_repetition(
    tmp_path: Path,
) -> None:
    """The file says nothing of it; the recording does."""
    folder_of_robot(tmp_path)
    run = "run robot.toml --for 1.0 --record run.mcap --placement follow=process"
    code, said = await asyncio.to_thread(verbs, tmp_path, *run.split())
    assert code == 0, said
    code, said = await asyncio.to_thread(verbs, tmp_path, "replay", "run.mcap")
    assert (code, said[:5]) == (0, "equal"), said


@pytest.mark.promise("PLC-7", "REP-2")
def test_one_that_is_replaced_is_told_from_the_new_one() -> None:
    """It decides until that has decided; now the new one is the quicker of the two."""

    def play(loop: TurnLoop, tape: list[Any], *naps: float) -> list[Any]:
        sonar = FakeSensor("sonar", 1.0, type=float, rate=50.0)
        wheels = FakeActuator("wheels", safe=0.0, command_timeout=1.0)
        old, new = (Decides(*each) for each in zip((1.0, 2.0), naps, strict=True))
        old.placement = new.placement = "process"
        sent: list[Any] = []

        async def main() -> None:
            robot = esair.Robot(resources=[sonar, wheels], behaviors=[old])
            robot.journal.listen(
                lambda each: sent.append(each.value) if each.kind == Kind.SENT else None
            )
            if loop.player is None:
                loop.keep(TapeWriter(tape.append))
            else:
                loop.play()
            async with robot:
                await asyncio.sleep(0.1)
                await robot.behaviors.replace("decides", new)
                await asyncio.sleep(0.2)
            loop.keep(None)

        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(main())
        return sent

    tape: list[Any] = []
    live = play(TurnLoop(), tape, 0.0, 0.1)
    assert {1.0, 2.0} <= {*live}
    assert play(TurnLoop(player=Player(tape)), tape, 0.1, 0.0) == live


PUSHES = """
import time
import esair

class Eye(esair.Sensor[float]):
    period = 1.0
    placement = "process"

    def stream(self):
        while True:
            yield time.monotonic()
            time.sleep(0.02)

class Wheels(esair.Actuator[float]):
    safe = 0.0

    async def write(self, command):
        pass

class Follow(esair.Reaction):
    eye = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, eye: float) -> float:
        return 1.0 + eye % 1.0
"""

OF_IT = """
[robot]
name = "pushed"

[sensor.eye]
driver = "pushes:Eye"

[actuator.wheels]
driver = "pushes:Wheels"

[behavior.follow]
driver = "pushes:Follow"
"""


@pytest.mark.promise("PLC-7", "REP-2")
async def test_a_placed_driver_with_a_thread_is_recorded_exactly(
    tmp_path: Path,
) -> None:
    """What it gives is kept: whatever goes on in its process is not repeated."""
    (tmp_path / "pushes.py").write_text(PUSHES)
    (tmp_path / "robot.toml").write_text(OF_IT)
    run = "run robot.toml --for 1.0 --record run.mcap"
    code, said = await asyncio.to_thread(verbs, tmp_path, *run.split())
    assert code == 0, said
    code, said = await asyncio.to_thread(verbs, tmp_path, "replay", "run.mcap")
    assert (code, said[:5]) == (0, "equal"), said
    assert "compared up to there" not in said
