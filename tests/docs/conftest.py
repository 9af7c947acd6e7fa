"""The code in the documentation, and its pages, built once for all tests."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# Its tests import it from its own folder.
sys.path.insert(0, str(ROOT / "docs" / "code"))


@pytest.fixture(scope="session")
def built(tmp_path_factory) -> tuple[Path, str]:
    """The folder with the pages, and what Sphinx had to say; skips without Sphinx."""
    for package in ("sphinx", "furo", "myst_parser"):
        pytest.importorskip(package, reason="pip install '.[docs]'")
    folder: Path = tmp_path_factory.mktemp("docs")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]
    # Without every name in the navigation of every page: most of the time goes there.
    command += ["-D", "toc_object_entries=0"]
    places = [ROOT / "docs", folder / "html"]
    done = subprocess.run(
        [*command, "-d", str(folder / "trees"), *map(str, places)],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    return folder / "html", done.stderr
