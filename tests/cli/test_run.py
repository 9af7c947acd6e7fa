"""``esair run`` and ``esair sim``: exit codes, and every actuator safe at the end."""

import json
import logging
import re
import signal
import sys

import pytest

from esair.cli._log import shown_log

pytestmark = pytest.mark.real_clock

MODULE = """
import asyncio
import json
import logging
import os
import esair

def note(word):
    with open("log.jsonl", "a") as file:
        file.write(json.dumps(word) + "\\n")

class Motor(esair.Actuator[float]):
    safe = 0.0
    async def write(self, command: float) -> None:
        note(command)

class SimMotor(Motor):
    async def write(self, command: float) -> None:
        note(["sim", command])

class Gone(Motor):
    required = True
    async def open(self) -> None:
        raise ConnectionError("no such thing")

class Once(esair.Behavior):
    motor = esair.writes(float)
    async def run(self) -> None:
        await self.motor.write(1.0)

class Always(esair.Behavior):
    motor = esair.writes(float)
    async def run(self) -> None:
        async for _ in esair.every(0.02):
            await self.motor.write(1.0)
            import late_import  # found beside the file while it runs

class Chatter(esair.Behavior):
    motor = esair.writes(float)
    async def run(self) -> None:
        async for _ in esair.every(0.01):
            await self.motor.write(1.0)
            for _ in range(20):
                logging.getLogger("esair").warning("%s", "so much to say " * 20)

class Clumsy(esair.Behavior):
    async def run(self) -> None:
        things = ["one"]
        logging.getLogger("esair").warning("%d is no number", "x")
        logging.getLogger("esair").warning("there is %s", things)
        things.append("two")
        for thing in things:
            logging.getLogger("esair").warning("it was %s", thing)
        logging.getLogger("esair").warning("long" * 80)

class Which(esair.Behavior):
    async def run(self) -> None:
        note(type(asyncio.get_running_loop()).__module__)

class Crash(esair.Behavior):
    motor = esair.writes(float)
    restart = esair.Restart(max=0)
    async def run(self) -> None:
        await self.motor.write(1.0)
        raise RuntimeError("on purpose")
"""


@pytest.fixture
def folder(tmp_path):
    """A module and a robot.toml for one motor and one behavior."""
    (tmp_path / "parts.py").write_text(MODULE)
    (tmp_path / "late_import.py").write_text("")

    def write(behavior: str, motor: str = "Motor"):
        (tmp_path / "robot.toml").write_text(
            f'[actuator.motor]\ndriver = "parts:{motor}"\n'
            'sim = { driver = "parts:SimMotor" }\n'
            f'[behavior.it]\ndriver = "parts:{behavior}"\n'
        )
        return tmp_path

    return write


def sent(folder):
    """What the motor was told."""
    return [
        json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()
    ]


@pytest.mark.long
def test_a_robot_that_ends_by_itself_is_exit_code_0(folder, start) -> None:
    """All behaviors have ended; the motor is safe."""
    where = folder("Once")
    process = start("run", "robot.toml", cwd=where)
    _, log = process.communicate(timeout=60)

    assert process.returncode == 0, log
    assert 1.0 in sent(where)
    assert sent(where)[-1] == 0.0


@pytest.mark.long
def test_sim_uses_the_simulated_devices(folder, start) -> None:
    """The real driver is not called at all."""
    where = folder("Once")
    process = start("sim", "robot.toml", cwd=where)
    process.communicate(timeout=60)

    assert ["sim", 1.0] in sent(where)
    assert all(isinstance(each, list) for each in sent(where))


@pytest.mark.long
def test_a_time_can_be_set(folder, start) -> None:
    """``--for`` ends it in order."""
    where = folder("Always")
    process = start("run", "robot.toml", "--for", "0.3", cwd=where)
    _, log = process.communicate(timeout=60)

    assert process.returncode == 0, log
    assert sent(where).count(1.0) > 2
    assert sent(where)[-1] == 0.0


@pytest.mark.fault("O15")
@pytest.mark.long
def test_a_log_that_nobody_reads_holds_nothing_up(folder, start) -> None:
    """The pipe is full at once: the robot drives on, and ends in time and safe."""
    where = folder("Chatter")
    process = start("run", "robot.toml", "--for", "1.5", cwd=where)

    process.wait(timeout=60)  # without reading what it says

    assert process.returncode == 0
    assert sent(where).count(1.0) > 50
    assert sent(where)[-1] == 0.0


@pytest.mark.long
def test_a_line_that_cannot_be_shown_is_not_the_last_one(folder, start) -> None:
    """And each is shown as it was when it was said."""
    process = start("run", "robot.toml", cwd=folder("Clumsy"))
    _, log = process.communicate(timeout=60)

    assert process.returncode == 0
    assert "a line of 'esair' cannot be shown: TypeError: %d format" in log
    assert "there is ['one']" in log
    assert "it was two" in log
    assert "Traceback" not in log


@pytest.mark.long
def test_a_log_that_is_no_terminal_has_a_line_for_each_record(folder, start) -> None:
    """So that it can be searched, however long a line is."""
    process = start("run", "robot.toml", cwd=folder("Clumsy"))
    _, log = process.communicate(timeout=60)

    (line,) = (line for line in log.splitlines() if "longlong" in line)
    assert re.fullmatch(r"\d\d:\d\d:\d\d WARNING  (long){80}", line)


@pytest.mark.long
def test_nobody_needs_to_see_the_log(folder, start) -> None:
    """A service may start it with its error output closed."""
    where = folder("Once")
    code = (
        "import os, sys; os.close(2); "
        "os.execv(sys.executable, [sys.executable, '-m', 'esair', 'run', 'robot.toml'])"
    )
    process = start(cwd=where, code=code)
    process.communicate(timeout=60)

    assert process.returncode == 0
    assert sent(where)[-1] == 0.0


def test_a_full_disk_keeps_no_robot_from_running(folder, start) -> None:
    """What it says at its start has no room on it."""
    where = folder("Once")
    code = (
        "import os, sys; os.dup2(os.open('/dev/full', os.O_WRONLY), 2); "
        "os.execv(sys.executable, [sys.executable, '-m', 'esair', 'run', 'robot.toml'])"
    )
    process = start(cwd=where, code=code)
    process.communicate(timeout=60)

    assert process.returncode == 0
    assert 1.0 in sent(where)


def test_nothing_is_left_open_at_its_end(folder, start) -> None:
    """Whoever has Python's warnings as errors gets none of the command line."""
    where = folder("Once")
    words = ["-W", "error", "-m", "esair", "run", "robot.toml"]
    code = f"import os, sys; os.execv(sys.executable, [sys.executable, *{words}])"
    process = start(cwd=where, code=code)
    _, log = process.communicate(timeout=60)

    assert "stop: " in log
    assert "Warning" not in log


@pytest.mark.parametrize("behavior", ["Which", "Always"])
@pytest.mark.long
def test_it_runs_on_uvloop(folder, start, behavior) -> None:
    """``--loop uvloop`` changes the loop and nothing else."""
    pytest.importorskip("uvloop")
    where = folder(behavior)
    process = start("run", "robot.toml", "--loop", "uvloop", "--for", "0.3", cwd=where)
    _, log = process.communicate(timeout=60)

    assert process.returncode == 0, log
    assert ("uvloop" in sent(where)) == (behavior == "Which")
    assert (1.0 in sent(where)) == (behavior == "Always")
    assert [word for word in sent(where) if word != "uvloop"][-1] == 0.0


def test_a_loop_that_is_not_installed_is_exit_code_2(
    folder, esair_command, capsys, monkeypatch
) -> None:
    """The message says what to install."""
    monkeypatch.chdir(folder("Once"))
    monkeypatch.setitem(sys.modules, "uvloop", None)

    assert esair_command("run", "robot.toml", "--loop", "uvloop") == 2
    assert "pip install 'esair[uvloop]'" in capsys.readouterr().err


@pytest.mark.promise("ROB-2")
@pytest.mark.parametrize(
    "number",
    [
        signal.SIGINT,
        pytest.param(signal.SIGTERM, marks=pytest.mark.long),
        pytest.param(signal.SIGHUP, marks=pytest.mark.long),
    ],
)
def test_a_signal_makes_the_motor_safe(folder, start, number) -> None:
    """Exit code 128 plus the number, no traceback."""
    where = folder("Always")
    process = start("run", "robot.toml", cwd=where)
    while "Ctrl-C stops it" not in process.stderr.readline():
        assert process.poll() is None
    while not (where / "log.jsonl").exists() or 1.0 not in sent(where):
        assert process.poll() is None
    process.send_signal(number)
    _, log = process.communicate(timeout=60)

    assert process.returncode == 128 + number
    assert sent(where)[-1] == 0.0
    assert "Traceback" not in log


@pytest.mark.long
def test_a_behavior_that_fails_for_good_is_exit_code_1(folder, start) -> None:
    """Its error is one block, its actuator safe; the traceback is there on demand."""
    where = folder("Crash")
    process = start("run", "robot.toml", cwd=where)
    _, log = process.communicate(timeout=60)

    assert process.returncode == 1
    what, place, todo = log.splitlines()[-3:]
    assert "RuntimeError: on purpose" in what
    assert place.startswith("  where: ")
    assert todo.startswith("  to do: ")
    assert "Traceback" not in log
    assert sent(where)[-1] == 0.0

    process = start("run", "robot.toml", "--traceback", cwd=where)
    assert "Traceback" in process.communicate(timeout=60)[1]


@pytest.mark.long
@pytest.mark.parametrize(
    ("option", "package", "extra"),
    [("--record", "foxglove", "record"), ("--page", "starlette", "page")],
)
def test_an_extra_that_is_not_installed_is_exit_code_2(
    folder, start, option, package, extra
) -> None:
    """The installation cannot be used as asked: nothing is moved."""
    where = folder("Once")
    without = f"import sys; sys.modules[{package!r}] = None; import esair.cli as cli"
    process = start(
        "run", "robot.toml", option, cwd=where, code=f"{without}; cli.main()"
    )
    _, log = process.communicate(timeout=60)

    assert process.returncode == 2, log
    assert f"pip install 'esair[{extra}]'" in log.splitlines()[-1]
    assert not (where / "log.jsonl").exists()


@pytest.mark.long
def test_a_required_device_that_is_not_there_is_exit_code_1(folder, start) -> None:
    """The robot does not start, and says why in a line."""
    process = start("run", "robot.toml", cwd=folder("Once", "Gone"))
    _, log = process.communicate(timeout=60)

    assert process.returncode == 1
    assert "no such thing" in log.splitlines()[-1]
    assert "Traceback" not in log


def test_a_broken_configuration_is_exit_code_2(folder, start) -> None:
    """Every mistake in a line, nothing opened."""
    where = folder("Onec")
    with (where / "robot.toml").open("a") as file:
        file.write("[robot]\nnmae = 1\n")
    process = start("run", "robot.toml", cwd=where)
    _, told = process.communicate(timeout=60)

    assert process.returncode == 2
    first, second, last = told.splitlines()
    assert first.startswith("robot.toml:5: behavior.it.driver: ")
    assert second.startswith("robot.toml:7: robot.nmae: ")
    assert last == "2 mistakes; nothing was opened, nothing moved"
    assert not (where / "log.jsonl").exists()


@pytest.mark.parametrize("verb", ["run", "sim", "check"])
def test_a_link_to_itself_is_no_configuration(
    esair_command, capsys, tmp_path, verb
) -> None:
    """It is told as every file that cannot be read."""
    (tmp_path / "robot.toml").symlink_to("robot.toml")

    assert esair_command(verb, str(tmp_path / "robot.toml")) == 2
    assert "it cannot be read: Too many levels" in capsys.readouterr().err


def test_each_wrong_value_of_an_option_is_told(folder, start) -> None:
    """At once, as exit code 2, and nothing is opened."""
    where = folder("Once")
    words = ["--for=-1", "--page", "[::1]:70000", "--realtime=99"]
    places = ["--placement", "it=moon", "--placement", "nobody=process"]

    process = start("run", "robot.toml", *words, *places, cwd=where)
    _, told = process.communicate(timeout=60)

    assert process.returncode == 2
    assert [line.split(": ")[1] for line in told.splitlines()] == [
        "--for",
        "page",
        "command line",
        "--placement",
        "no component is named 'nobody'; there are it, motor",
    ]
    assert not (where / "log.jsonl").exists()


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf"])
def test_a_time_that_makes_no_sense_is_exit_code_2(
    folder, esair_command, capsys, monkeypatch, seconds
) -> None:
    """Before anything is opened."""
    where = folder("Once")
    monkeypatch.chdir(where)

    assert esair_command("run", "robot.toml", f"--for={seconds}") == 2
    assert "--for: expected seconds > 0" in capsys.readouterr().err
    assert not (where / "log.jsonl").exists()


@pytest.mark.parametrize("verbose", [False, True])
@pytest.mark.usefixtures("capsys")
def test_what_is_logged_afterwards_is_as_before(*, verbose: bool) -> None:
    """A program that runs a robot as the command line does keeps its own levels."""
    names = ("", "esair", "asyncio")
    before = [logging.getLogger(name).level for name in names]

    with shown_log(verbose=verbose):
        inside = logging.getLogger("esair").level

    assert inside == (logging.DEBUG if verbose else logging.INFO)
    assert [logging.getLogger(name).level for name in names] == before
