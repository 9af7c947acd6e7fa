"""The documentation can be built, if Sphinx is here."""

from pathlib import Path

import pytest


@pytest.mark.xdist_group("pages")
def test_builds_without_a_warning(built: tuple[Path, str]) -> None:
    """Every reference leads somewhere, every included file is there."""
    pages, said = built

    assert said == ""
    assert (pages / "index.html").exists()
