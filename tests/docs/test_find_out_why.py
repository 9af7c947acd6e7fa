"""The story of docs/how-to/find-out-why.md, from the run to the test."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = ROOT / "docs" / "code"

pytestmark = pytest.mark.real_clock


def esair(folder: Path, *words: str) -> tuple[int, str]:
    """Run a verb in a folder; return its exit code and what it has said."""
    done = subprocess.run(
        [sys.executable, "-m", "esair", *words],
        cwd=folder,
        env={**os.environ, "COLUMNS": "200"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the robot, and the run in which it went for the wall."""
    folder = tmp_path_factory.mktemp("corridor")
    for name in ("corridor.py", "corridor.toml"):
        shutil.copy(CODE / name, folder)
    options = ("--for", "0.8", "--record", "run.mcap")
    assert esair(folder, "run", "corridor.toml", *options)[0] == 0
    return folder


@pytest.mark.long
@pytest.mark.promise("REP-2")
def test_the_first_wrong_decision_is_found(folder: Path) -> None:
    """Equal with the mistake; without it the first difference is the missed echo."""
    code, said = esair(folder, "replay", "run.mcap", "--with", "corridor.toml")
    assert (code, said[:7]) == (0, "equal: ")

    shutil.copy(CODE / "corridor_fixed.py", folder / "corridor.py")
    code, said = esair(folder, "replay", "run.mcap", "--with", "corridor.toml")
    assert code == 3
    lines = [line.strip() for line in said.splitlines()]
    assert lines[0] == "changed since it was recorded: corridor.Keep"
    assert lines[1].startswith("keep does otherwise at ")
    assert lines[2:4] == [
        "recorded  command wheel <- keep: 1.0",
        "now       command wheel <- keep: 0.0",
    ]
    assert lines[-1].endswith(": 4.0")


@pytest.mark.long
@pytest.mark.promise("REP-1")
@pytest.mark.parametrize("fixed", [False, True])
def test_the_test_of_the_page_finds_the_mistake(
    folder: Path, fixed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails before and passes after."""
    import asyncio

    from esair.testing import FakeActuator, VirtualLoop

    shutil.copy(
        CODE / ("corridor_fixed.py" if fixed else "corridor.py"), folder / "corridor.py"
    )
    shutil.copy(CODE / "test_corridor.py", folder / "corridor_tests.py")
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    for name in ("corridor", "corridor_tests"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    importlib.invalidate_caches()
    tests = importlib.import_module("corridor_tests")

    def play(test: object) -> None:
        with asyncio.Runner(loop_factory=VirtualLoop) as runner:
            runner.run(test(FakeActuator))  # type: ignore[operator]

    play(tests.test_no_echo_at_all_moves_nothing)
    if fixed:
        play(tests.test_a_missed_echo_moves_nothing)
    else:
        with pytest.raises(AssertionError):
            play(tests.test_a_missed_echo_moves_nothing)
