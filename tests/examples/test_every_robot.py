"""What holds for each example: it is short, is typed, and says how it is protected."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import esair

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
ROBOTS = [path for path in SCRIPTS if path.stem not in {"odometry", "yard"}]


def needed(path: Path) -> None:
    """Skip what needs an extra that is not there."""
    if "drivers.mavlink" in path.read_text(encoding="utf-8"):
        pytest.importorskip("pymavlink", reason="the extra 'mavlink' is missing")


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_it_can_be_read_at_once(path) -> None:
    """It has less than 150 lines, and tells no type checker to look away."""
    text = path.read_text(encoding="utf-8")

    assert len(text.splitlines()) < 150
    assert not re.search(r"type:\s*ignore|pyright:\s*ignore", text)


@pytest.mark.promise("PRO-13")
@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_esair_check_prints_its_table_of_protection(path, monkeypatch, capsys) -> None:
    """No errors; each actuator with who writes it, who guards it, and what is safe."""
    pytest.importorskip("cyclopts")
    needed(path)
    from esair.cli import main

    monkeypatch.chdir(EXAMPLES)
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit) as ended:
        main(["check", f"{path.name}:robot"])
    told = capsys.readouterr()

    assert ended.value.code == 0, told
    for head in ("How each actuator is made safe", "guarded by", "safe command"):
        assert head in told.out


@pytest.mark.real_clock
@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_it_starts_without_arguments(path, monkeypatch) -> None:
    """Who tries it without its devices sees that they are waited for."""
    needed(path)
    started: list[object] = []
    monkeypatch.setattr(esair, "run", lambda robot, **_: started.append(robot))
    monkeypatch.setattr(sys, "argv", [str(path)])
    monkeypatch.syspath_prepend(EXAMPLES)

    runpy.run_path(str(path), run_name="__main__")

    assert len(started) == 1


@pytest.mark.long
def test_pyright_finds_nothing() -> None:
    """As mypy, which looks at them with the rest."""
    pytest.importorskip("pyright", reason="pip install '.[ci]'")
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, EXAMPLES],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    if "errors," not in done.stdout:
        pytest.skip(f"pyright cannot run here: {done.stderr[-200:]}")

    assert "0 errors" in done.stdout, done.stdout
