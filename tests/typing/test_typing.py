"""Type checkers see what is promised, and nothing that is right needs an ignore."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from pathlib import Path

import pytest

import esair
from esair.actions import (
    ActuatorPort,
    BlockingActuatorPort,
    BlockingSensorPort,
    SensorPort,
)

HOOKS = {"setup", "run", "teardown", "provide"}
"""What a behavior overrides, in either form."""
CASES = Path(__file__).with_name("cases.py")
ROOT = CASES.parents[2]
SCRIPT = CASES.with_name("first_script.py")
EXAMPLE = ROOT / "examples" / "slow_arm.py"


def expected() -> set[int]:
    lines = CASES.read_text(encoding="utf-8").splitlines()
    return {number for number, line in enumerate(lines, 1) if "type: ignore" in line}


@pytest.mark.long
@pytest.mark.promise("BEH-4", "BS-8")
def test_mypy_finds_what_is_wrong_and_no_more() -> None:
    """Strict; an ignore that hides nothing is an error too."""
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "--config-file=",
         str(CASES), str(EXAMPLE), str(SCRIPT)],
        capture_output=True, text=True, cwd=ROOT, check=False,
    )  # fmt: skip

    assert done.returncode == 0, done.stdout
    assert len(expected()) == 11


@pytest.mark.long
@pytest.mark.promise("BEH-4", "BS-8")
def test_pyright_finds_what_is_wrong_and_no_more(tmp_path: Path) -> None:
    """The same lines, and none of the example."""
    pytest.importorskip("pyright", reason="pip install '.[ci]'")
    (tmp_path / "cases.py").write_text(
        CASES.read_text(encoding="utf-8").replace("# type: ignore", "# was"),
        encoding="utf-8",
    )
    (tmp_path / "slow_arm.py").write_text(
        EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8"
    )
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--pythonpath", sys.executable,
         "--outputjson", "."],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    try:
        found = json.loads(done.stdout)["generalDiagnostics"]
    except ValueError:
        pytest.skip(f"pyright cannot run here: {done.stderr[-200:]}")
    errors = [each for each in found if each["severity"] == "error"]
    where = {(Path(e["file"]).name, e["range"]["start"]["line"] + 1) for e in errors}
    told = "\n".join(
        f"{e['range']['start']['line'] + 1}: {e['message']}" for e in errors
    )

    assert where == {("cases.py", line) for line in expected()}, told


@pytest.mark.promise("BEH-4")
@pytest.mark.parametrize(
    ("awaited", "waiting"),
    [
        (SensorPort, BlockingSensorPort),
        (ActuatorPort, BlockingActuatorPort),
        (esair.Behavior, esair.ThreadBehavior),
    ],
)
def test_whatever_is_awaited_a_thread_can_wait_for(
    awaited: type, waiting: type
) -> None:
    """No verb of a port or of `Behavior` is forgotten, and each has the same words."""
    for name, method in inspect.getmembers(awaited, inspect.iscoroutinefunction):
        if not name.startswith("_") and name not in HOOKS:
            of_thread = getattr(waiting, name)
            assert not inspect.iscoroutinefunction(of_thread), name
            assert (of_thread.__doc__ or "")[:20] == (method.__doc__ or "")[:20]
