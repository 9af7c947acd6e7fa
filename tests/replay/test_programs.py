"""A robot that a program makes, and a run in virtual time, are repeated by name."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from tests.replay import robots
from tests.replay.test_replay import verbs

import esair
from esair.cli._replay import show
from esair.exceptions import RecordingBrokenError
from esair.replay import Outcome, Replay, unrepeatable

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("REP-2")]

PROGRAM = """
import random
from pathlib import Path

import attrs

import esair
from helpers import GAIN


@attrs.frozen
class Pose:
    x: float


class Gps(esair.Sensor[Pose]):
    rate = 50.0

    async def read(self) -> Pose:
        return Pose(random.random())


class Wheel(esair.Actuator[Pose]):
    safe = Pose(0.0)
    command_timeout = 0.3

    async def write(self, command: Pose) -> None:
        pass


class Follow(esair.Reaction):
    gps = esair.reads(Pose)
    wheel = esair.writes(Pose)

    def react(self, gps: Pose) -> Pose:
        return Pose(GAIN * gps.x)


def make() -> esair.Robot:
    record = esair.Recording(Path("run.mcap"), min_free=0)
    return esair.Robot(
        resources=[Gps(), Wheel()], behaviors=[Follow()], record=record
    )


robot = make()
if __name__ == "__main__":
    esair.run(robot, duration=0.4)
    Path("ended").touch()
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a program, its module, and the recording of its run."""
    folder = tmp_path_factory.mktemp("program")
    (folder / "rover.py").write_text(PROGRAM)
    (folder / "helpers.py").write_text("GAIN = 0.5\n")
    subprocess.run([sys.executable, "rover.py"], cwd=folder, check=True, timeout=60)
    (folder / "ended").unlink()
    return folder


@pytest.mark.parametrize(
    "made_of",
    [
        pytest.param("rover.py", marks=pytest.mark.long),
        pytest.param("rover.py:robot", marks=pytest.mark.long),
        "rover:make",
    ],
)
@pytest.mark.long
def test_the_program_is_named_in_any_form(folder: Path, made_of: str) -> None:
    """Its own classes come back, nothing is recorded again, nothing is run to the end."""
    code, said = verbs(folder, "replay", "run.mcap", "--with", made_of)

    assert code == 0, said
    assert said.startswith("equal")
    assert {*os.listdir(folder)} >= {"run.mcap", "rover.py"}
    assert not [name for name in os.listdir(folder) if name in {"run-2.mcap", "ended"}]


@pytest.mark.long
def test_without_a_name_it_says_which(folder: Path) -> None:
    """A recording never runs a program by itself: it may be somebody else's."""
    code, said = verbs(folder, "replay", "run.mcap")

    assert code == 2
    assert f"name it: --with {folder / 'rover.py'}" in said


@pytest.mark.long
def test_what_was_changed_in_the_program_shows(folder: Path) -> None:
    """The class by its name, and the first thing that is decided otherwise."""
    (folder / "other.py").write_text(PROGRAM.replace("GAIN * gps.x", "gps.x"))
    code, said = verbs(folder, "replay", "run.mcap", "--with", "other.py")

    assert code == 3
    assert "changed since it was recorded: __main__.Follow" in said
    assert "follow does otherwise" in said


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("import nonsense", "nonsense"),
        ("print('hello')", "has not called esair.run"),
        ("raise SystemExit(7)", "before it ran a robot"),
    ],
)
def test_a_program_that_runs_no_robot_is_named(
    folder: Path, text: str, expected: str
) -> None:
    """Exit code 2, and one line."""
    (folder / "wrong.py").write_text(text)
    code, said = verbs(folder, "replay", "run.mcap", "--with", "wrong.py")

    assert code == 2
    assert "wrong.py" in said
    assert expected in said
    assert "Traceback" not in said


@pytest.mark.long
def test_calls_that_cannot_repeat_are_named_in_a_program(folder: Path) -> None:
    """``--check`` of a robot without a file."""
    code, said = verbs(folder, "replay", "run.mcap", "--check", "--with", "rover.py")

    assert (code, said) == (0, "nothing was found that could not be repeated\n")


@pytest.mark.long
def test_a_fast_demo_is_repeated_with_its_world(tmp_path: Path) -> None:
    """On the virtual clock all happens again, in another process too."""
    words = ("demo", "--fast", "--seed", "5", "--record", "fast.mcap")
    code, said = verbs(tmp_path, *words, "--out", "demo.png")
    assert code == 0, said
    code, said = verbs(
        tmp_path, "replay", "fast.mcap", "--with", "demo", hash_seed=4711
    )

    assert code == 0, said
    assert said.startswith("equal")
    seconds = said.partition(" turns; ")[2].split()[0]
    assert float(seconds) > 5.0  # of the robot's time


@pytest.mark.long
def test_a_run_of_a_test_says_what_repeats_it(tmp_path: Path) -> None:
    """Its virtual time was made by the test: only that can make it again."""
    program = PROGRAM.replace(
        "    esair.run(robot, duration=0.4)",
        "    import asyncio\n    from esair.testing import VirtualLoop\n"
        "    esair.run(robot, duration=0.4, loop_factory=VirtualLoop)",
    )
    (tmp_path / "rover.py").write_text(program)
    (tmp_path / "helpers.py").write_text("GAIN = 0.5\n")
    subprocess.run([sys.executable, "rover.py"], cwd=tmp_path, check=True, timeout=60)
    code, said = verbs(tmp_path, "replay", "run.mcap", "--with", "rover.py")

    assert code == 2
    assert "its time was virtual: its own test or program repeats it" in said


@pytest.mark.parametrize(("equal", "code"), [(0, 2), (1, 0)])
def test_a_replay_that_has_compared_nothing_is_not_equal(
    capsys: pytest.CaptureFixture[str], equal: int, code: int
) -> None:
    """It says that nothing was compared, and why."""
    cut = "it has no end"
    outcome = Outcome(equal, None, turns=1, seconds=0.1, took=0.1, short=cut)

    assert show(outcome, Console()) == code
    out, err = capsys.readouterr()
    assert out.startswith("equal") is bool(equal)
    assert err == ("" if equal else f"esair: nothing was compared: {cut}\n")


async def _beside(first: Path, second: Path) -> None:
    async with robots.make(first):
        await asyncio.sleep(0.1)
        async with robots.make():
            await asyncio.sleep(0.2)
        async with robots.make():
            await asyncio.sleep(0.1)


async def _in_a_row(first: Path, second: Path) -> None:
    for path in (first, second):
        async with robots.make(path):
            await asyncio.sleep(0.2)


async def _after_one_without(first: Path, second: Path) -> None:
    async with robots.make():
        await asyncio.sleep(0.1)
        async with robots.make(second):
            await asyncio.sleep(0.1)


@pytest.mark.parametrize(
    ("program", "first", "second"),
    [
        (_beside, "another robot has begun in its event loop", None),
        (_in_a_row, None, "not exact: another robot was run"),
        (_after_one_without, None, "not exact: another robot was run"),
    ],
)
def test_one_run_of_a_loop_repeats_and_says_up_to_where(
    tmp_path: Path, program: Any, first: str | None, second: str | None
) -> None:
    """The turns of a loop are those of all its robots, recorded or not."""
    paths = tmp_path / "first.mcap", tmp_path / "second.mcap"
    with asyncio.Runner(loop_factory=esair.new_event_loop) as runner:
        runner.run(program(*paths))
    if first is not None:
        outcome = Replay(paths[0]).run(robots.make())
        assert outcome.divergence is None
        assert outcome.short == first
    if second is not None:
        with pytest.raises(RecordingBrokenError, match=second):
            Replay(paths[1])


ALONE = """
import os
import timeit

import esair


class Alone(esair.Reaction):
    rate = 10.0
    wheel = esair.writes(float)

    def react(self) -> float:
        gain = float(os.environ["GAIN"]) * float(os.getenv("MORE", "1"))
        return gain * (hash("wheel") % 7) + timeit.default_timer() + float(input())
"""


@pytest.mark.promise("REP-3")
def test_what_another_process_has_otherwise_is_named(tmp_path: Path) -> None:
    """Its environment, the hash of a text, what somebody types."""
    (tmp_path / "alone.py").write_text(ALONE)
    found = {each.call for each in unrepeatable(tmp_path / "alone.py")}

    alone = {"builtins.hash", "builtins.input", "os.environ", "os.getenv"}
    assert found == {*alone, "timeit.default_timer"}
