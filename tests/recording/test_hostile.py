"""Recordings of strangers: looked at, made whole, checked and repeated without harm."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.recording.hostile import corpus
from tests.replay.soak import folder_of_robot
from tests.replay.test_replay import verbs

pytest.importorskip("foxglove", reason="needs esair[record]")

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("SEC-2", "REC-4")]

MOST = 256
"""How many MiB all of it may take, in one process."""

EACH = 5.0
"""How many seconds of CPU one file may keep one verb busy."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot, and a sound recording of it."""
    folder = folder_of_robot(tmp_path_factory.mktemp("robot"))
    code, said = verbs(
        folder, "run", "robot.toml", "--for", "0.3", "--record", "run.mcap"
    )
    assert code == 0, said
    (folder / "harm.py").write_text("import os\nos.mkdir('harmed')\n")
    return folder


def files(folder: Path) -> dict[str, bytes]:
    """Return the corpus; its recordings say that the robot.toml there made them."""
    digest = hashlib.sha256((folder / "robot.toml").read_bytes()).hexdigest()
    return corpus((folder / "run.mcap").read_bytes(), digest)


def looked_at(
    folder: Path, wanted: dict[str, bytes], *words: str
) -> list[dict[str, Any]]:
    """Run verbs on files in one process that is watched."""
    place = folder / "hostile"
    place.mkdir(exist_ok=True)
    for old in place.iterdir():
        old.unlink()
    for number, (name, data) in enumerate(wanted.items()):
        safe = re.sub("[^a-zA-Z0-9 ]", "_", name)[:40]
        (place / f"{number:03} {safe}.mcap").write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-m", "tests.recording.hostile", place, "run.mcap", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in done.stdout.splitlines()]


def check(found: list[dict[str, Any]], count: int) -> None:
    """Fail unless each was told in one line, and nothing was imported or called."""
    assert len(found) == count
    for each in found:
        assert each["seen"] == [], str(each)[:300]
        assert each["code"] in {0, 2, 3}, each
        assert len(each["told"]) <= 1, each
        assert not each["raw"], each
        assert each["code"] != 2 or each["told"], each
        assert each["took"] < EACH, each
    assert max(each["peak"] for each in found) <= MOST


VERBS = ("log", "recover", "replay", "replay --check")


@pytest.mark.long
def test_two_hundred_hostile_recordings_do_no_harm(folder: Path) -> None:
    """Nothing is imported or called, 256 MiB at most, one clear line each."""
    wanted = files(folder)
    assert len(wanted) >= 200
    check(looked_at(folder, wanted, *VERBS), len(VERBS) * len(wanted))
    assert not (folder / "harmed").exists()


@pytest.mark.long
def test_those_that_name_code_do_no_harm(folder: Path) -> None:
    """A few of each kind: classes, modules, callables and files that are named."""
    wanted = dict(list(files(folder).items())[4:160:20])
    check(looked_at(folder, wanted, "log", "replay"), 2 * len(wanted))
    assert not (folder / "harmed").exists()


@pytest.mark.long
def test_their_pictures_do_no_harm(folder: Path) -> None:
    """Names are no formulas, numbers may be of any size."""
    pytest.importorskip("matplotlib", reason="needs esair[sim]")
    wanted = {name: data for name, data in files(folder).items() if "event" in name}
    check(looked_at(folder, wanted, "plot"), len(wanted))
