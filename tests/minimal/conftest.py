"""What the tests of MIN share: worlds, and a MicroPython."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

PACKAGE = "@micropython/micropython-webassembly-pyscript"


def npm_folder() -> Path:
    """Where ``get-micropython`` puts the package."""
    return Path(
        os.environ.get("ESAIR_MICROPYTHON", HERE.parents[1] / ".micropython")
    ).resolve()


class MicroPython:
    """A MicroPython under Node; each run is a fresh interpreter."""

    def __init__(self, node: str, module: Path) -> None:
        self._node = node
        self._module = module

    def run(
        self, folder: Path, code: str, *, data: object = None, seconds: float = 120.0
    ) -> str:
        """Run code beside the files of a folder; return what it printed.

        Args:
            folder: Its files are the board's.
            code: What to run.
            data: Put on the board as ``data.json``.
            seconds: How long it may take.
        """
        done = subprocess.run(
            [self._node, HERE / "micropython.mjs", self._module, folder],
            input=json.dumps({"code": code, "data": json.dumps(data)}),
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(done.stdout + done.stderr)
        return done.stdout


@pytest.fixture
def micropython() -> MicroPython:
    """The current MicroPython, or a skip with the reason."""
    node = shutil.which("node")
    module = npm_folder() / "node_modules" / PACKAGE / "micropython.mjs"
    if node is None:
        pytest.skip("MicroPython runs under Node, which is not installed")
    if not module.is_file():
        pytest.skip(f"no {PACKAGE}: run tests/minimal/get-micropython")
    return MicroPython(node, module)


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """A folder with what every board has: ``esair/minimal.py``."""
    source = HERE.parents[1] / "src" / "esair" / "minimal.py"
    (tmp_path / "board" / "esair").mkdir(parents=True)
    shutil.copy(source, tmp_path / "board" / "esair" / "minimal.py")
    return tmp_path / "board"
