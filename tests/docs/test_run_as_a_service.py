"""The unit of the how-to page is one that systemd takes, and fits what esair does."""

import configparser
import shutil
import subprocess
from pathlib import Path

import pytest

from esair.standard import LAST_WAIT

UNIT = Path(__file__).parents[2] / "docs" / "code" / "rover.service"


def test_the_robot_has_its_time_to_end() -> None:
    """More than its grace period and what it takes besides; SIGTERM is a success."""
    unit = configparser.ConfigParser()
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read(UNIT)
    service = unit["Service"]

    assert float(service["TimeoutStopSec"]) > 1.0 + LAST_WAIT
    assert service["SuccessExitStatus"] == str(128 + 15)
    assert service["KillMode"] == "mixed"


def test_systemd_finds_nothing_wrong(tmp_path) -> None:
    """Except that there is no rover on this machine."""
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not here")
    text = UNIT.read_text(encoding="utf-8")
    here = text.replace("/home/rover/rover/.venv/bin/esair", "/bin/true")
    copy = tmp_path / "rover.service"
    copy.write_text(here, encoding="utf-8")
    done = subprocess.run(
        [analyze, "verify", copy],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    said = [line for line in done.stderr.splitlines() if "rover.service" in line]

    assert said == [], done.stderr
