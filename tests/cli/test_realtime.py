"""``--realtime`` of the command line, ``esair measure``, and what ``check`` says of it."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from esair.cli import _measure
from esair.cli._measure import BINS, BUSY, Late
from esair.loop import refusal

pytestmark = pytest.mark.real_clock

allowed = pytest.mark.skipif(
    bool(refusal(50)), reason=f"real time is not to be had here: {refusal(50)}"
)

MODULE = """
import esair

class Beam(esair.Sensor[float]):
    async def read(self) -> float:
        return 1.0

class Arm(esair.Actuator[float]):
    safe = 0.0
    async def write(self, command: float) -> None: ...

class Hold(esair.Reaction):
    rate = 100.0
    beam = esair.reads(float)
    arm = esair.writes(float)
    def react(self, beam: float) -> float:
        return beam
"""

ROBOT = """
[robot]
name = "held"
{more}
[sensor.beam]
driver = "{module}:Beam"
rate = 50
{sim}
[actuator.arm]
driver = "{module}:Arm"
{sim}
[behavior.hold]
driver = "{module}:Hold"
"""


@pytest.fixture
def robot(tmp_path: Path):
    """A robot.toml with a reaction at 100 Hz and a sensor at 50 Hz."""
    module = f"held_{tmp_path.name}"  # an import of this process
    (tmp_path / f"{module}.py").write_text(MODULE)

    def write(more="", sim="sim = {}"):
        file = tmp_path / "robot.toml"
        file.write_text(ROBOT.format(module=module, more=more, sim=sim))
        return file

    return write


def policy_of(pid: int) -> tuple[int, int]:
    policy = os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK
    return policy, os.sched_getparam(pid).sched_priority


@pytest.mark.long
@allowed
@pytest.mark.parametrize(
    ("words", "more", "priority"),
    [
        (["run", "robot.toml", "--realtime"], "", 50),
        (["run", "robot.toml", "--realtime=60"], "", 60),
        (["run", "robot.toml"], "realtime = 20", 20),
        (["sim", "robot.toml", "--realtime", "30"], "realtime = 20", 30),
    ],
)
def test_a_robot_of_a_file_is_in_real_time(robot, start, words, more, priority) -> None:
    """By the option, else by the file."""
    file = robot(more)
    process = start(*words, cwd=file.parent)
    end = time.monotonic() + 60.0
    while policy_of(process.pid) == (os.SCHED_OTHER, 0) and time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    assert policy_of(process.pid) == (os.SCHED_FIFO, priority)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30.0)
    assert process.returncode == 128 + signal.SIGTERM


def test_check_says_what_this_computer_gives(robot, esair_command, capsys) -> None:
    """Of a robot that asks for it; no word of one that does not."""
    assert esair_command("check", robot()) == 0
    assert "real time" not in capsys.readouterr().out
    assert esair_command("check", robot("realtime = 60")) == 0
    said = capsys.readouterr().out
    if refused := refusal(60):
        assert f"real time: not given here: {refused}" in said
    else:
        assert "real time: given here, with priority 60 and locked memory" in said


def test_check_refuses_what_is_no_priority(robot, esair_command, capsys) -> None:
    assert esair_command("check", robot("realtime = 99")) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "robot.realtime error: expected true, false or a priority of 1" in said


@pytest.mark.long
def test_measure_shows_every_step_and_leaves_nothing_behind(robot, start) -> None:
    """A column for each way; their lines add up to the steps of the reaction and polls."""
    file = robot()
    process = start(
        "measure", file, "--for", "1", "--load", "2", "--out", "m.png", cwd=file.parent
    )
    said, errors = process.communicate(timeout=120.0)
    assert process.returncode == 0, errors
    assert "1 s each, 2 busy processes beside" in said
    ways = 1 if refusal(50) else 2
    assert ("--realtime=50" in said) == (ways == 2)
    lines = [line for line in said.splitlines() if re.match(r" *(<=|>) \S+ ms", line)]
    assert len(lines) == len(BINS)
    made = [sum(int(line.split()[-1]) for line in lines)]
    (lost,) = [line for line in said.splitlines() if "steps lost" in line]
    of = [int(each) for each in re.findall(r"(\d+) of (\d+)", lost)[-1]]
    assert made == [of[1] - of[0]]
    assert of[1] > 60  # 100 steps and 50 polls, on a computer that may be busy
    assert (file.parent / "m.png").read_bytes().startswith(b"\x89PNG")


def test_a_step_that_waits_is_seen_where_it_is_late() -> None:
    """Each is in one line, at the edge too; p99 leaves the worst one out of a hundred."""
    late = Late("a", [0.00005, 0.0002, 0.00021, 3.0], lost=1)
    assert late.counts() == [1, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1]
    assert Late("b", [0.001] * 99 + [1.0]).share(0.5) == 1.0
    assert Late("b", [0.001] * 99 + [1.0]).share(1.0) == 1000.0


def test_measure_moves_no_hardware_unless_it_is_told(
    robot, esair_command, capsys
) -> None:
    """What has no simulation is refused, as `esair sim` refuses it."""
    assert esair_command("measure", robot(sim=""), "--for", "0.1") == 2
    assert "nothing stands for this device" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["--load", "-1"], ["--rate", "0"], ["--for", "-1"], ["--realtime=99"]]
)
def test_what_cannot_be_measured_is_refused(robot, esair_command, words) -> None:
    assert esair_command("measure", robot(), *words) in {1, 2}


def test_a_busy_process_says_nothing_of_ctrl_c() -> None:
    """The terminal interrupts it, too: its traceback is no word about the robot."""
    code = BUSY.replace("parent =", "print(flush=True)\nparent =")
    words = [sys.executable, "-I", "-S", "-c", code]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, stdout=pipe, stderr=pipe) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30.0)[1] == b""


def test_a_kind_of_picture_that_there_is_not_is_told_before(
    robot, esair_command, capsys, monkeypatch
) -> None:
    """Its ending says which kind it is."""
    monkeypatch.setattr(_measure, "busy", pytest.fail)
    assert esair_command("measure", robot(), "--out", "m.pgn") == 2
    assert "there is no 'pgn'; did you mean 'png'?" in capsys.readouterr().err


def test_a_picture_that_cannot_be_drawn_is_told_before(
    robot, esair_command, capsys, monkeypatch
) -> None:
    """Nobody waits for a measurement whose picture needs what is not installed."""
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr(_measure, "busy", pytest.fail)
    assert esair_command("measure", robot(), "--out", "m.png") == 2
    assert "esair[sim]" in capsys.readouterr().err
