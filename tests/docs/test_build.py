"""The documentation can be built, if Sphinx is here."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_builds_without_a_warning(tmp_path) -> None:
    """Every reference leads somewhere, every included file is there."""
    for package in ("sphinx", "furo", "myst_parser"):
        pytest.importorskip(package, reason="pip install '.[docs]'")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going"]
    folders = ["-d", tmp_path / "trees", ROOT / "docs", tmp_path / "html"]
    done = subprocess.run(
        [*command, "-b", "html", *folders],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )

    assert done.stderr == ""
    assert done.returncode == 0
