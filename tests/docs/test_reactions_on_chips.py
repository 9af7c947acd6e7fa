"""The page about chips without Python, done word by word."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from docs.commands import Command, commands

from esair.cli import main
from esair.firmware.c import build

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "reactions-on-chips.md").read_text(encoding="utf-8")

pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.skipif(not shutil.which("cc"), reason="needs a compiler of C"),
]


def block(language: str, word: str) -> str:
    blocks = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return next(str(each) for each in blocks if word in each)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("chips")  # a process has one module named reflex
    for name in ("reflex.py", "reflex.toml"):
        shutil.copy(ROOT / "docs" / "code" / name, made)
    return Path(made)


@pytest.fixture
def folder(whole, monkeypatch) -> Path:
    monkeypatch.chdir(whole)
    monkeypatch.delitem(sys.modules, "reflex", raising=False)  # of another page
    return Path(whole)


def test_it_is_built_and_tried_as_the_page_says(folder) -> None:
    build_it, _, compile_it, try_it = (
        each for each in commands(PAGE) if isinstance(each, Command)
    )
    with pytest.raises(SystemExit, match="0"):
        main(build_it.text.split()[1:])
    done = subprocess.run(
        f"{compile_it.text} && {try_it.text}",
        shell=True,
        capture_output=True,
        text=True,
        check=True,
    )

    assert done.stdout.splitlines() == try_it.printed


def test_the_pins_of_the_page_are_pins_of_the_sketch(folder) -> None:
    """They have the signatures of the stubs, and compile with what Arduino declares."""
    build(Path("reflex.toml"), Path("chip"), target="avr", arm="pin:7")
    stubs = Path("chip/robot/robot.ino").read_text()
    pins = block("c", "pulseIn")
    for line in re.findall(r"^bool .*$", pins, re.MULTILINE):
        assert line in stubs
    arduino = (
        '#include "robot.h"\nenum { LOW, HIGH };\nvoid digitalWrite(int, int);\n'
        "void delayMicroseconds(int);\nunsigned long pulseIn(int, int, long);\n"
        "void analogWrite(int, int);\n"
    )
    Path("chip/robot/pins.c").write_text(arduino + pins)
    subprocess.run(["cc", "-std=c99", "-fsyntax-only", "chip/robot/pins.c"], check=True)


def test_a_refusal_is_told_as_the_page_shows_it(folder) -> None:
    text = Path("reflex.py").read_text()
    text = text.replace("return 0.0 if sonar", "return 0.0 if math.hypot(sonar, 1.0)")
    Path("reflex_2.py").write_text(
        text.replace('"""\n\nfrom', '"""\nimport math\nfrom', 1)
    )
    toml = Path("reflex.toml").read_text().replace("reflex:", "reflex_2:")
    Path("robot.toml").write_text(toml)
    with pytest.raises(ExceptionGroup) as caught:
        build(Path("robot.toml"), Path("other"))

    (told,) = map(str, caught.value.exceptions)
    shown = " ".join(block("text", "math.hypot").split())
    assert told.replace("reflex_2.py", "reflex.py") == shown
    assert not Path("other").exists()
