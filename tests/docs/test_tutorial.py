"""The tutorial, done as it says: a new project, a new behavior, a swap."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.patience import TRIES

CODE = Path(__file__).parents[2] / "docs" / "code"


def run(*words: str, folder: Path) -> str:
    for _ in range(TRIES):
        done = subprocess.run(
            [sys.executable, *words],
            cwd=folder,
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "200"},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        if "the event loop is held" not in done.stderr:  # as a busy computer does
            break
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    return done.stdout


@pytest.fixture(scope="module")
def scout(tmp_path_factory) -> Path:
    """The project of the tutorial, with what it adds."""
    pytest.importorskip("cyclopts")
    folder: Path = tmp_path_factory.mktemp("tutorial")
    run("-m", "esair", "new", "scout", folder=folder)
    scout = folder / "scout"
    shutil.copy(CODE / "zigzag.py", scout / "scout")
    shutil.copy(CODE / "test_zigzag.py", scout / "tests")
    shutil.copy(CODE / "swap.py", scout)
    return scout


@pytest.mark.long
def test_its_tests_pass(scout) -> None:
    """Those of the project, and those that the tutorial adds."""
    out = run("-m", "pytest", "-q", "-p", "no:cacheprovider", folder=scout)

    assert "7 passed" in out


@pytest.mark.promise("SUP-2")
@pytest.mark.long
def test_wander_is_swapped_while_the_robot_drives(scout) -> None:
    """The script prints what the tutorial shows."""
    *before, one, two, last = run("swap.py", folder=scout).splitlines()

    assert before[0].startswith(
        "wheels is ready, held by wander (priority 0 of 'wander'"
    )
    running = {"wander: running", "avoid: running", "keep_clear: running"}
    assert {one, two, last} == running
