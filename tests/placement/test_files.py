"""A module that no path leads to, by its file; a script of a package, by its name."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import textwrap
from pathlib import Path
from types import ModuleType

import pytest

import esair
from esair import config

pytestmark = [pytest.mark.virtual_clock, pytest.mark.xdist_group("placement")]

MODULE = """
import esair
from esair.testing import FakeActuator
from {beside} import SPEED


class Drive(esair.Behavior):
    placement = "process"
    wheels = esair.writes(float)

    async def run(self):
        async for _ in esair.every(0.05):
            await self.wheels.write(SPEED)


robot = esair.Robot(resources=[FakeActuator("wheels", safe=0.0)], behaviors=[Drive()])
"""


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("name", ["of_a_file", "json"])
async def test_a_component_of_a_file_lives_in_a_process(
    name: str, tmp_path: Path
) -> None:
    """What lies beside it is found, too; one of a known name has another in the robot."""
    (tmp_path / f"beside_{name}.py").write_text("SPEED = 0.5\n")
    (tmp_path / f"{name}.py").write_text(MODULE.format(beside=f"beside_{name}"))
    found = config.find_robot(f"{tmp_path / name}.py:robot")
    assert isinstance(found, esair.Robot)
    async with found as robot:
        await asyncio.sleep(0.3)
        (wheels,) = robot.plan.resources
        assert 0.5 in wheels.commands  # type: ignore[attr-defined]
        assert robot.behaviors.query("drive").restarts == 0


PROGRAM = """
import esair
from . import SPEED


class Drive(esair.Behavior):
    placement = "process"

    async def run(self):
        await self.stop_robot(f"at {SPEED}")


if __name__ == "__main__":
    robot = esair.Robot(behaviors=[Drive()])
    esair.run(robot, duration=30.0)
    print(robot.stopped.reason)
"""


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("file", ["__main__.py", "rover.py"])
def test_a_program_of_a_package_imports_what_is_beside_it(
    file: str, tmp_path: Path
) -> None:
    """``python -m package``: a child imports it as a part of that, too."""
    package = tmp_path / "of_a_package"
    package.mkdir()
    (package / "__init__.py").write_text("SPEED = 0.5\n")
    (package / file).write_text(PROGRAM)
    name = package.name if file == "__main__.py" else f"{package.name}.rover"
    ended = subprocess.run(
        [sys.executable, "-m", name],
        capture_output=True,
        cwd=tmp_path,
        text=True,
        timeout=60,
        check=False,
    )
    assert "at 0.5" in ended.stdout, ended.stderr


ASSERTS = """
import esair


class Drive(esair.Behavior):
    placement = "process"

    async def run(self):
        assert False, "it is checked"
        await self.stop_robot("all well")


if __name__ == "__main__":
    robot = esair.Robot(behaviors=[Drive()])
    esair.run(robot, duration=30.0)
    print(robot.stopped.reason, robot.behaviors.query("drive").error)
"""


@pytest.mark.promise("PLC-1")
def test_a_process_runs_as_the_robot_does(tmp_path: Path) -> None:
    """With the flags of Python, and with nothing of the folder where it was started."""
    script = tmp_path / "program" / "script.py"
    script.parent.mkdir()
    script.write_text(ASSERTS)
    (tmp_path / "socket.py").write_text("raise SystemExit('of another program')\n")
    ended = subprocess.run(
        [sys.executable, "-O", str(script)],
        capture_output=True,
        cwd=tmp_path,
        text=True,
        timeout=60,
        check=False,
    )
    assert "all well None" in ended.stdout, ended.stderr


TELLS = """
import pathlib
import sys

import esair


class Drive(esair.Behavior):
    placement = "process"

    async def run(self):
        print("seen by nobody", file=sys.stderr)
        await self.stop_robot("all well")


if __name__ == "__main__":
    robot = esair.Robot(behaviors=[Drive()])
    esair.run(robot, duration=30.0)
    pathlib.Path("told").write_text(robot.stopped.reason)
"""


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize(
    "closed",
    [
        "<&- >&- 2>&-",
        *(pytest.param(each, marks=pytest.mark.long) for each in (">&-", "2>&-")),
    ],
)
def test_a_robot_without_an_output_has_processes(closed: str, tmp_path: Path) -> None:
    """As a service may be started: what is opened first has the number of the output."""
    (tmp_path / "script.py").write_text(TELLS)
    program = ["sh", "-c", f'exec "$0" script.py {closed}', sys.executable]
    subprocess.run(program, cwd=tmp_path, timeout=60, check=False)
    assert (tmp_path / "told").read_text() == "drive: all well"


@pytest.mark.promise("PLC-1")
def test_what_python_passes_over_in_its_path_is_no_matter(tmp_path: Path) -> None:
    """Many a script adds its folder as a `Path`, and finds what is there all the same."""
    adds = "import pathlib, sys\nsys.path.append(pathlib.Path(__file__).parent)\n"
    (tmp_path / "script.py").write_text(adds + TELLS)
    program = [sys.executable, "script.py"]
    subprocess.run(program, cwd=tmp_path, timeout=60, check=False)
    assert (tmp_path / "told").read_text() == "drive: all well"


CROWD = """
import asyncio
import resource

import esair


class Waits(esair.Behavior):
    placement = "process"
    restart = esair.Restart(max=0)

    async def run(self):
        await asyncio.sleep(60.0)


async def main():
    robot = esair.Robot(behaviors=[Waits(name=f"waits_{n}") for n in range(16)])
    async with robot:
        await asyncio.sleep(0.5)
        found = [robot.behaviors.query(f"waits_{n}") for n in range(16)]
    runs = [each for each in found if each.state is esair.BehaviorState.RUNNING]
    told = [str(each.error) for each in found if each not in runs]
    assert all(each.pid for each in runs) and runs, runs
    assert told and all("Too many open files" in each for each in told), told
    print("all well")


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_NOFILE, (48, 48))
    asyncio.run(main())
"""


@pytest.mark.long
@pytest.mark.promise("PLC-3")
def test_whose_process_has_no_room_for_a_file_says_so(tmp_path: Path) -> None:
    """The others have theirs, and it is known which."""
    (tmp_path / "script.py").write_text(CROWD)
    ended = subprocess.run(
        [sys.executable, "script.py"],
        capture_output=True,
        cwd=tmp_path,
        text=True,
        timeout=60,
        check=False,
    )
    assert "all well" in ended.stdout, ended.stderr


@pytest.mark.promise("PLC-1", "RS-8")
@pytest.mark.parametrize("how", ["-", "-c"])
def test_a_program_that_is_in_no_file_places_nothing(how: str) -> None:
    """No child could import it: that is a mistake, and no component that fails."""
    words = ["-"] if how == "-" else ["-c", ASSERTS]
    ended = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        input=ASSERTS,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 1
    assert "its class is in no file" in ended.stderr


@pytest.mark.promise("PLC-1", "RS-8")
async def test_a_module_that_is_in_no_file_places_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As one that somebody has made of a text: told before the start, too."""
    cells = ModuleType("cells")
    monkeypatch.setitem(sys.modules, "cells", cells)
    text = "import esair\nclass Idle(esair.Behavior):\n  async def run(self): ..."
    exec(text, vars(cells))
    idle = cells.Idle()
    idle.placement = "process"
    robot = esair.Robot(behaviors=[idle])
    with pytest.raises(ExceptionGroup) as raised:
        await robot.__aenter__()
    assert "its class is in no file" in str(raised.value.exceptions)


@pytest.mark.promise("PLC-1", "RS-8")
def test_a_class_that_only_the_run_script_has_is_a_mistake(tmp_path: Path) -> None:
    """Its child does not come to it: that is told before the start."""
    above, _, below = ASSERTS.partition("class Drive")
    made, _, run = below.partition('if __name__ == "__main__":\n')
    made = textwrap.indent(f"class Drive{made}", "    ")
    script = tmp_path / "script.py"
    script.write_text(f'{above}if __name__ == "__main__":\n{made}{run}')
    ended = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 1
    assert "imports the script without this class" in ended.stderr
