"""``esair top``, ``stop``, ``set`` and the others, as a user calls them."""

import contextlib
import fcntl
import json
import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.patience import within

pytestmark = pytest.mark.real_clock

MODULE = """
import json
import esair
import attrs

class Sonar(esair.Sensor[float]):
    rate = 20.0
    async def read(self) -> float:
        return 1.25

class Label(esair.Sensor[str]):
    rate = 20.0
    async def read(self) -> str:
        return "a\\x1b[2Jb\\ncd\\u202ee"

class Motor(esair.Actuator[float]):
    safe = 0.0
    top_speed = esair.setting(1.0, unit="m/s", min=0.1, max=2.0)
    async def write(self, command: float) -> None:
        with open("log.jsonl", "a") as file:
            file.write(json.dumps(command) + "\\n")
    @esair.operation
    async def home(self, turns: int, speed: float = 0.5) -> str:
        with open("homed.jsonl", "a") as file:
            file.write(json.dumps([turns, speed]) + "\\n")
        return "at home"

class Always(esair.Behavior):
    motor = esair.writes(float)
    async def run(self) -> None:
        async for _ in esair.every(0.02):
            await self.motor.write(1.0)

class Reads(esair.Behavior):
    sonar = esair.reads(float)
    label = esair.reads(str)
    async def run(self) -> None:
        async for _ in self.sonar:
            await self.label.read()
"""

FILE = """
[robot]
name = "{name}"
[sensor.sonar]
driver = "parts:Sonar"
[sensor.label]
driver = "parts:Label"
[actuator.motor]
driver = "parts:Motor"
[behavior.always]
driver = "parts:Always"
[behavior.reads]
driver = "parts:Reads"
"""


@pytest.fixture
def esair(esair_command, capsys):
    """Run a verb; return what it prints, and its error if it ends with a code."""

    def run(*words, code=0):
        capsys.readouterr()
        ended = esair_command(*words)
        out, err = capsys.readouterr()
        assert ended == code, out + err
        return out if code == 0 else out + err

    return run


@pytest.fixture
def robot(tmp_path, monkeypatch, start):
    """Start a robot by its name; return its folder."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "sockets"))

    def run(name="rover", *words):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "parts.py").write_text(MODULE)
        (folder / "robot.toml").write_text(FILE.format(name=name))
        folder_process = start("run", "robot.toml", *words, cwd=folder)
        for _ in range(1200):
            if told(folder)[-1:] == [1.0]:
                return folder
            assert folder_process.poll() is None, folder_process.communicate()
            time.sleep(0.05)
        raise TimeoutError

    return run


def process_in(folder):
    """Return the first process that runs in a folder."""
    for number in sorted(int(each.name) for each in Path("/proc").glob("[0-9]*")):
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            if os.readlink(f"/proc/{number}/cwd") == str(folder):
                return number
    raise LookupError(folder)


def told(folder):
    path = folder / "log.jsonl"
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.mark.promise("OPS-2", "OPS-3")
@pytest.mark.longer
def test_a_robot_is_watched_and_steered(esair, robot):
    """Each verb does what it says, by what the motor was told."""
    folder = robot()

    shown = esair("top")
    assert re.search(r"motor +ready +always \(0\)", shown), shown
    sonar = re.search(r"sonar +ready +1.25 +(\d+)", shown)
    assert sonar, shown
    assert within(2, abs(int(sonar[1]) - 20)), shown
    status = json.loads(esair("top", "--json"))
    assert status["robot"] == "rover"
    assert "held by always" in esair("why", "motor")
    assert "held by always" in esair("why")
    assert esair("ros", code=1) == "it has no [ros]\n"
    assert "top_speed is 0.2 m/s (at least 0.1 m/s, at most 2 m/s)" in esair(
        "set", "motor.top_speed", "0.2"
    )
    assert "at most 2.0" in esair("set", "motor.top_speed", "3", code=1)

    out = esair("stop", "a cat")
    assert "halted: a cat" in out
    assert "motor: safe 0.0: answered" in out
    count = len(told(folder))
    assert told(folder)[-1] == 0.0
    time.sleep(0.2)
    assert len(told(folder)) == count
    assert "HALTED: a cat" in esair("top")
    esair("resume")
    time.sleep(0.2)
    assert told(folder)[-1] == 1.0
    # No reason at all keeps it from halting: several words, no text, far too much.
    for reason in (["a", "cat", "ran"], [os.fsdecode(b"caf\xe9")], ["x" * 100_000]):
        assert "halted: " in esair("stop", *reason)
        assert told(folder)[-1] == 0.0
        esair("resume")

    esair("remove", "always")
    time.sleep(0.1)
    assert told(folder)[-1] == 0.0
    esair("add", "always")
    time.sleep(0.2)
    assert told(folder)[-1] == 1.0
    esair("restart", "always")
    (folder / "parts.py").write_text("this is no Python")  # it is not loaded again
    told_now = esair("replace", "always")
    assert "its Python code is as the program has loaded it" in told_now
    assert "no such part" in esair("add", "nobody", code=1)
    assert "did you mean" in esair("why", "moter", code=1)


@pytest.mark.promise("OPS-2")
@pytest.mark.long
def test_a_terminal_that_cannot_draw_gets_the_table_once(robot):
    """As plain text: a screen that lives would show nothing there."""
    robot()
    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "esair", "top"]
    environment = {**os.environ, "TERM": "dumb"}
    top = subprocess.Popen(words, stdout=theirs, env=environment)
    assert top.wait(timeout=30) == 0
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    os.close(theirs)
    assert re.search(r"motor +ready +always", shown), shown
    assert "\x1b" not in shown


@pytest.mark.promise("OPS-2")
@pytest.mark.long
def test_an_operation_is_called_and_told(esair, robot):
    """By what the device did; what is wrong is told, and nothing is done."""
    folder = robot()
    assert esair("operate", "motor", "home", "turns=2") == "at home\n"
    told = esair("operate", "motor", "home", "turns=3", "speed=0.1", "--json")
    assert json.loads(told) == "at home"
    for words, expected in (
        (["home"], "turns"),
        (["home", "turns=x"], "int"),
        (["home", "turns=1", "sped=2"], "speed"),
        (["hoem", "turns=1"], "did you mean 'home'"),
    ):
        assert expected in esair("operate", "motor", *words, code=1)
    assert "name=value" in esair("operate", "motor", "home", "3", code=2)
    lines = (folder / "homed.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [[2, 0.5], [3, 0.1]]


@pytest.mark.long
@pytest.mark.promise("SEC-1")
def test_what_a_device_says_cannot_reach_the_terminal_raw(esair, robot):
    """No escape, line end or bidi character: they are shown as their numbers."""
    robot()

    for words in (("top",), ("top", "--json"), ("stop", "x\x1b[2J\u202ey")):
        shown = esair(*words)
        assert "\x1b" not in shown
        assert "\u202e" not in shown


@pytest.mark.promise("OPS-2")
@pytest.mark.parametrize(
    ("words", "told", "code"),
    [
        (["mute", "always", "nan", "x"], "expected finite numbers", 1),
        (["put", "always", "1e999"], "expected finite numbers", 1),
        (["ask", "always", "Go", "x=NaN"], "expected finite numbers", 1),
        (["put", "always", "{bad"], "begins as JSON, and is none", 2),
        (["put", "always", "[" * 5000 + "]" * 5000], "begins as JSON", 2),
    ],
)
def test_what_cannot_be_sent_is_told_in_a_line(
    esair, monkeypatch, tmp_path, words, told, code
):
    """A number or a text that no message can have, before anything reaches the robot."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (place := tmp_path / "esair").mkdir(mode=0o700)
    with (
        socket.socket(socket.AF_UNIX) as robot,
        (place / "rover.lock").open("w") as lock,
    ):
        fcntl.flock(lock, fcntl.LOCK_EX)
        robot.bind(str(place / "rover.sock"))
        robot.listen()
        (line,) = esair(*words, code=code).splitlines()
    assert told in line


@pytest.mark.promise("OPS-2")
@pytest.mark.long
def test_several_robots_are_told_apart_by_name(esair, robot):
    """Without a name it says which there are; --all stops every one."""
    one, two = robot("one"), robot("two")

    error = esair("resume", code=2)
    assert "one, two" in error
    esair("stop", "--robot", "one")
    assert told(one)[-1] == 0.0
    assert told(two)[-1] == 1.0
    esair("stop", "--all")
    assert told(two)[-1] == 0.0
    assert "did you mean 'one'" in esair("resume", "--robot", "onne", code=2)


@pytest.mark.promise("OPS-3")
@pytest.mark.long
def test_who_does_not_answer_holds_up_the_halt_of_nobody_else(esair, robot):
    """``stop --all`` tells all at once, and names who has not answered."""
    one, two = robot("one"), robot("two")
    stuck = process_in(one)
    os.kill(stuck, signal.SIGSTOP)
    try:
        shown = esair("stop", "--all", code=1)
    finally:
        os.kill(stuck, signal.SIGCONT)
    assert "'one' has not answered" in shown
    assert told(two)[-1] == 0.0


@pytest.mark.promise("OPS-3")
@pytest.mark.long
def test_who_stops_a_frozen_robot_hears_that_soon(robot, start, tmp_path):
    """And not when its answer is given up: there may be a switch to run to."""
    stuck = process_in(robot())
    os.kill(stuck, signal.SIGSTOP)
    try:
        begin = time.monotonic()
        stop = start("stop", cwd=tmp_path)
        assert "'rover' does not answer" in stop.stderr.readline()
        assert within(5.0, time.monotonic() - begin)
    finally:
        os.kill(stuck, signal.SIGCONT)
    assert "halted" in stop.stdout.readline()
    assert stop.wait(10.0) == 0


@pytest.mark.promise("OPS-2")
@pytest.mark.long
def test_the_log_of_a_robot_is_followed(esair, robot, start, tmp_path):
    """``log -f`` shows what happens from then on."""
    robot()
    follower = start("log", "-f", "-k", "halted", cwd=tmp_path)
    for _ in range(60):
        esair("stop", "a cat")
        if select.select([follower.stdout], [], [], 0.5)[0]:
            break
    assert "a cat" in follower.stdout.readline()


@pytest.mark.long
def test_a_name_that_nobody_has_is_told_before_the_log_is_followed(
    robot, start, tmp_path
):
    """A follower of a misspelled component would wait for ever."""
    robot()
    follower = start("log", "-f", "-c", "motr", cwd=tmp_path)
    assert "did you mean 'motor'" in follower.stderr.readline()


@pytest.mark.long
@pytest.mark.promise("OPS-1")
@pytest.mark.fault("O18")
def test_a_second_start_is_refused(esair, robot, start):
    """The same file again: it says that it runs; the first goes on."""
    folder = robot()
    count = len(told(folder))

    second = start("run", "robot.toml", cwd=folder)
    _, error = second.communicate(timeout=60)
    assert second.returncode == 1
    assert "runs already" in error
    assert len(told(folder)) > count
    assert told(folder)[-1] == 1.0
    assert "halted" in esair("stop")


@pytest.mark.promise("REC-1")
@pytest.mark.long
def test_a_run_is_recorded_with_what_the_operator_did(esair, robot):
    """``--record`` without a path records to this folder; the stop is in the file."""
    folder = robot("rover", "--record")
    esair("stop", "a cat")
    esair("resume")
    time.sleep(0.6)
    (file,) = folder.glob("*.mcap")
    lines = esair("log", str(file), "-k", "operator", "--json").splitlines()
    acts = [json.loads(line)["value"]["act"] for line in lines]
    assert acts == ["stop", "resume"]


def test_a_long_request_is_waited_for(esair, monkeypatch):
    """A client waits longer than what it asks for may take."""
    waits = {}

    class Robot:
        name = "rover"

        def do(self, act, fields, timeout):
            waits[act] = timeout
            return "done"

    monkeypatch.setattr(
        "esair.cli._steer.connect", lambda _: contextlib.nullcontext(Robot())
    )

    assert esair("put", "planner", "3", "--interval", "60") == "done\n"
    assert esair("ask", "docking", "Dock", "--timeout", "90") == "done\n"
    assert waits["put"] > 60.0
    assert waits["ask"] > 90.0


def test_without_a_robot_it_says_so(esair, tmp_path, monkeypatch):
    """Exit code 2, one line."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for words in (["top"], ["stop"], ["why", "x"], ["stop", "--all"], ["view"]):
        assert "no robot runs here" in esair(*words, code=2)
