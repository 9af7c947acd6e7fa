"""``esair new``: a project that runs at once, or a clear refusal."""

import os
import subprocess
import sys
import tomllib

import pytest


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Rover", "lower-case"),
        ("my-rover", "lower-case"),
        ("../rover", "lower-case"),
        ("", "lower-case"),
        ("a" * 64, "63 at most"),
        ("class", "a word of Python"),
        ("match", "a word of Python"),
        ("json", "a module of Python"),
        ("tests", "needed for something else"),
        ("attrs", "installed already"),
    ],
)
def test_a_name_that_would_not_work_is_refused(
    esair_command, capsys, tmp_path, name, told
) -> None:
    """Before anything is written."""
    assert esair_command("new", "--in", tmp_path, "--", name) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["directory", "file", "dangling link"])
def test_what_exists_is_never_touched(esair_command, capsys, tmp_path, kind) -> None:
    """Neither a directory, nor a file, nor a link that leads nowhere."""
    path = tmp_path / "scout"
    if kind == "directory":
        path.mkdir()
    elif kind == "file":
        path.write_text("mine")
    else:
        path.symlink_to(tmp_path / "nowhere")

    assert esair_command("new", "scout", "--in", tmp_path) == 2
    assert "exists already" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_is_not_there_is_told(esair_command, capsys, tmp_path) -> None:
    """It is not made silently."""
    assert esair_command("new", "scout", "--in", tmp_path / "no") == 2
    assert "is no directory" in capsys.readouterr().err


def test_nothing_half_made_stays(monkeypatch, tmp_path) -> None:
    """A disk that becomes full on the way leaves no project."""
    from pathlib import Path

    from esair.cli._new import write_project

    written: list[object] = []

    def write_text(path, text, **_):
        if len(written) == 3:
            raise OSError(28, "No space left on device")
        written.append(path)

    monkeypatch.setattr(Path, "write_text", write_text)
    with pytest.raises(OSError, match="No space"):
        write_project("scout", tmp_path / "scout")

    assert list(tmp_path.iterdir()) == []


def test_every_file_of_the_project_carries_its_name(esair_command, tmp_path) -> None:
    """No place holder is left, in no name and no text."""
    assert esair_command("new", "scout", "--in", tmp_path) == 0

    files = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")}
    assert {
        "scout/robot.toml",
        "scout/pyproject.toml",
        "scout/README.md",
        "scout/.gitignore",
        "scout/scout/__init__.py",
        "scout/scout/actions.py",
        "scout/scout/devices.py",
        "scout/tests/test_actions.py",
        "scout/tests/test_robot.py",
    } <= files
    texts = [path.read_text() for path in tmp_path.rglob("*") if path.is_file()]
    assert not any("{{" in text or ".tmpl" in text for text in texts)
    project = tomllib.loads((tmp_path / "scout/pyproject.toml").read_text())
    assert project["tool"]["pytest"]["ini_options"]["asyncio_mode"] == "auto"


@pytest.mark.real_clock
@pytest.mark.long
def test_its_tests_pass_and_it_drives_at_once(esair_command, start, tmp_path) -> None:
    """What the message after ``esair new`` says works, as it stands there."""
    assert esair_command("new", "scout", "--in", tmp_path) == 0
    project = tmp_path / "scout"
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    env.pop("PYTEST_ADDOPTS", None)

    tests = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=project,
        env=env,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert tests.returncode == 0, tests.stdout + tests.stderr
    assert " passed" in tests.stdout

    checked = start("check", "robot.toml", "--strict", cwd=project)
    shown, _ = checked.communicate(timeout=60)
    assert checked.returncode == 0, shown

    driven = start("sim", "robot.toml", "--for", "0.5", cwd=project)
    _, log = driven.communicate(timeout=60)
    assert driven.returncode == 0, log
    assert "safe Twist(linear=0.0, angular=0.0): answered" in log
    assert "WARNING" not in log
