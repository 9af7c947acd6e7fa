"""``esair min build --board c|avr``: what is written, how much it takes, what examples get."""

import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.chips import avr, demo, robots

from esair.cli import main
from esair.config import load
from esair.exceptions import ConfigError
from esair.firmware.c import build
from esair.firmware.c._scope import in_c

pytestmark = [pytest.mark.promise("MIN-7"), pytest.mark.real_clock]

ROOT = Path(__file__).parents[2]
REFLEX = ROOT / "docs" / "code" / "reflex.toml"

GCC = ["gcc", *robots.FLAGS]


@pytest.mark.parametrize("board", ["c", "avr"])
@pytest.mark.parametrize("arm", ["always", "pin:7", "host"])
def test_four_files_that_compile(tmp_path, capsys, board, arm) -> None:
    out = tmp_path / "out"
    words = [
        "min",
        "build",
        str(REFLEX),
        "--out",
        str(out),
        "--board",
        board,
        "--arm",
        arm,
    ]
    with pytest.raises(SystemExit, match="0"):
        main(words)

    files = sorted(
        str(each.relative_to(out)) for each in out.rglob("*") if each.is_file()
    )
    assert files == ["main.c", "robot/robot.c", "robot/robot.h", "robot/robot.ino"]
    kind = {"c": "double", "avr": "float"}[board]
    assert f"20 steps per second; it counts with {kind}" in capsys.readouterr().out
    program = out / "robot.out"
    sources = [out / "main.c", out / "robot" / "robot.c"]
    subprocess.run([*GCC, *sources, "-o", program, "-lm"], check=True)
    text = "a 1\ns 1 0.3 1\ns 1 0.1 1\n"
    said = subprocess.run(
        [program], input=text, capture_output=True, text=True, check=True
    )
    safe, half = "wheels 0x0p+0\n", "wheels 0x1p-1\n"
    assert (
        said.stdout == f"{safe}{half}= 1 0 0\n{safe}= 2 0 1\n{safe}"
    )  # faults, refused


def test_a_start_is_not_armed(tmp_path) -> None:
    """Unless the file says so: what comes from a reset stands still."""
    build(REFLEX, tmp_path)
    program = tmp_path / "robot.out"
    sources = [tmp_path / "main.c", tmp_path / "robot" / "robot.c"]
    subprocess.run([*GCC, *sources, "-o", program, "-lm"], check=True)
    said = subprocess.run(
        [program], input="s 1 0.3 1\n", capture_output=True, text=True, check=True
    )
    assert said.stdout.splitlines() == ["wheels 0x0p+0", "= 1 0 1", "wheels 0x0p+0"]


@pytest.mark.skipif(not shutil.which("g++"), reason="needs g++")
def test_the_sketch_is_one_of_c_plus_plus(tmp_path) -> None:
    """With what Arduino declares; every stub says that it has done nothing."""
    build(
        demo.rover(tmp_path), tmp_path / "out", target="avr", watchdog=0.5, arm="pin:7"
    )
    folder = tmp_path / "out" / "robot"
    text = (folder / "robot.ino").read_text()
    assert "wdt_enable(WDTO_500MS)" in text
    (folder / "avr").mkdir()
    (folder / "avr" / "wdt.h").write_text(
        "#define WDTO_500MS 5\nvoid wdt_enable(int);\nvoid wdt_reset();\n"
    )
    arduino = (
        "#include <stdint.h>\nuint32_t millis(); void delay(uint32_t); int digitalRead(int);\n"
        "void pinMode(int, int);\n#define LOW 0\n#define INPUT_PULLUP 2\n"
    )
    (folder / "robot.cpp").write_text(arduino + text)
    subprocess.run(
        ["g++", "-fsyntax-only", "-I", folder, folder / "robot.cpp"], check=True
    )
    assert text.count("return false;") == 3


@pytest.mark.long
def test_the_same_robot_gives_the_same_text(tmp_path) -> None:
    """In each process, whatever the order of its sets."""
    actuators = [f"wheel_{n}" for n in range(6)]
    (tmp_path / "six.py").write_text(
        "from esair.minimal import Actuator, Reaction, Sensor, reads, writes\n"
        "class Button(Sensor):\n    def read(self) -> bool: return False\n"
        "class Wheel(Actuator):\n    safe = 0\n    def write(self, command): pass\n"
        "class Go(Reaction):\n    button = reads(bool)\n    wheel_0 = writes(int)\n"
        "    def react(self, button):\n        return 1 if button else None\n"
    )
    tables = [f'[actuator.{name}]\ndriver = "six:Wheel"\n' for name in actuators]
    tables += ['[sensor.button]\ndriver = "six:Button"\n']
    tables += ['[behavior.go]\ndriver = "six:Go"\n']
    (tmp_path / "robot.toml").write_text("".join(tables))
    texts = set()
    for seed in "12":
        words = ["min", "build", str(tmp_path / "robot.toml"), "--board", "c"]
        subprocess.run(
            [sys.executable, "-m", "esair", *words, "--out", str(tmp_path / seed)],
            env={**os.environ, "PYTHONHASHSEED": seed},
            check=True,
        )
        texts.add((tmp_path / seed / "robot" / "robot.c").read_text())

    assert len(texts) == 1


def test_no_floats_where_the_reactions_have_none(tmp_path) -> None:
    (tmp_path / "floatless.py").write_text(
        "from esair.minimal import Actuator, Reaction, Sensor, guards, reads, writes\n"
        "class Button(Sensor):\n    def read(self) -> bool: return False\n"
        "class Step(Actuator):\n    safe = (0, 0)\n    limits = None\n"
        "    def write(self, command): pass\n"
        "class Go(Reaction):\n    button = reads(bool)\n    step = writes(tuple)\n    n = 0\n"
        "    def react(self, button):\n        self.n = (self.n * 3 + 1) % 7 if button else 0\n"
        "        return (self.n, -self.n // 2)\n"
        "class Less(Reaction):\n    button = reads(bool)\n    step = guards(tuple)\n"
        "    def react(self, button, step):\n        return step if button else None\n"
    )
    path = tmp_path / "robot.toml"
    path.write_text(
        '[sensor.button]\ndriver = "floatless:Button"\n[actuator.step]\ndriver = "floatless:Step"\n'
        '[behavior.go]\ndriver = "floatless:Go"\n[behavior.less]\ndriver = "floatless:Less"\n'
    )
    made = build(path, tmp_path / "out")
    written = "".join(
        (tmp_path / "out" / "robot" / name).read_text()
        for name in ("robot.c", "robot.h")
    )

    assert not made.has_floats
    assert re.findall(r"\b(?:real|float|double|math\.h)\b", written) == []
    sources = [tmp_path / "out" / "main.c", tmp_path / "out" / "robot" / "robot.c"]
    subprocess.run([*GCC, *sources, "-o", tmp_path / "out" / "a"], check=True)
    assert "malloc" not in written


def test_a_line_sensor_compiles(tmp_path) -> None:
    """No name of a part is one of ``main.c``."""
    (tmp_path / "follower.py").write_text(
        "from esair.minimal import Actuator, Reaction, Sensor, reads, writes\n"
        "class Line(Sensor):\n    def read(self) -> int: return 0\n"
        "class Step(Actuator):\n    safe = 0\n    def write(self, command): pass\n"
        "class Follow(Reaction):\n    line = reads(int)\n    step = writes(int)\n"
        "    def react(self, line):\n        return line - 2\n"
    )
    path = tmp_path / "robot.toml"
    path.write_text(
        '[sensor.line]\ndriver = "follower:Line"\n[actuator.step]\ndriver = "follower:Step"\n'
        '[behavior.follow]\ndriver = "follower:Follow"\n'
    )
    out = tmp_path / "out"
    build(path, out)
    sources = [out / "main.c", out / "robot" / "robot.c"]

    subprocess.run([*GCC, *sources, "-o", out / "a"], check=True)


@pytest.mark.long
@pytest.mark.skipif(avr.why_not() is not None, reason=str(avr.why_not()))
@pytest.mark.parametrize(
    ("guarded", "flash", "cycles"),
    [
        pytest.param(False, 6500, 5200, id="as in the example"),
        pytest.param(True, 8000, 8000, id="with the guard: 0.5 ms a step at most"),
    ],
)
def test_the_reflexes_of_the_demo_fit_into_an_atmega328p(
    tmp_path, guarded, flash, cycles
) -> None:
    """In 8 KB of flash, with room left, and, with its stack, in 1 KB of RAM; cycles at 16 MHz."""
    program, ram, worst = demo.measured(tmp_path, guarded=guarded)

    assert program <= flash
    assert ram <= 1024
    assert worst <= cycles


TRANSLATED = {
    "docs/code/reflex.toml": True,
    "examples/minimal_rover/robot.toml": True,
    "examples/board_rover/base.toml": True,
}


@pytest.mark.parametrize("name", TRANSLATED)
def test_examples_for_boards_are_translated(tmp_path, name) -> None:
    build(ROOT / name, tmp_path)
    sources = [tmp_path / "main.c", tmp_path / "robot" / "robot.c"]
    subprocess.run([*GCC, *sources, "-o", tmp_path / "a", "-lm"], check=True)


@pytest.mark.parametrize(
    ("said", "options"),
    [
        ("pic", {"target": "pic"}),
        ("arm", {"arm": "pin:x"}),
        ("watchdog", {"watchdog": 9.0}),
        ("watchdog", {"watchdog": 0.001}),
        ("watchdog", {"watchdog": math.nan}),
        ("longer than a step", {"watchdog": 0.24, "rate": 6.0}),  # it would be 0.12 s
        ("longer than a step", {"watchdog": 1.0, "rate": 1.0}),
        ("rate", {"rate": 2000.0}),
    ],
)
def test_wrong_words_are_told_and_nothing_is_written(tmp_path, said, options) -> None:
    with pytest.raises((ExceptionGroup, ConfigError)) as caught:
        build(REFLEX, tmp_path / "out", **options)

    error = caught.value
    told = " ".join(map(str, getattr(error, "exceptions", [error])))
    assert said in told
    assert not (tmp_path / "out").exists()
    assert load(REFLEX) is not None


@pytest.mark.skipif(not shutil.which("g++"), reason="needs g++")
@pytest.mark.parametrize("name", ["typeof", "linux", "unix", "template"])
def test_no_field_is_a_word_of_a_compiler(tmp_path, name) -> None:
    """The header of a sketch is read with the words of GNU C++."""
    text = f"struct {{ double {in_c(name)}; }} value;\n"
    (tmp_path / "a.cpp").write_text(text)
    command = ["g++", "-std=gnu++11", "-fsyntax-only", tmp_path / "a.cpp"]
    subprocess.run(command, check=True)


def test_a_link_needs_python(tmp_path, capsys) -> None:
    words = [
        "min",
        "build",
        str(REFLEX),
        "--out",
        str(tmp_path / "o"),
        "--board",
        "c",
        "--link",
    ]

    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert "no line to a computer" in capsys.readouterr().err
