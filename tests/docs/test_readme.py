"""The README shows what is tested, and nothing else."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize(
    ("number", "file"),
    [
        (0, "examples/wander_and_avoid.py"),
        (1, "tests/examples/test_wander_and_avoid.py"),
    ],
)
def test_code_is_a_tested_file(number, file) -> None:
    """Each block of Python equals a file that the tests run."""
    assert blocks("python")[number] == (ROOT / file).read_text(encoding="utf-8")


def test_every_block_of_code_is_one_of_them() -> None:
    """Two of Python, and the two commands."""
    assert len(blocks("python")) == 2
    assert len(blocks("console")) == 2


@pytest.mark.parametrize("page", ["README.md", "ARCHITECTURE.md", "CHANGELOG.md"])
def test_links_lead_somewhere(page) -> None:
    """Every link to a file of the repository."""
    text = (ROOT / page).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", text)

    missing = [
        link
        for link in links
        if not link.startswith("https://") and not (ROOT / link).exists()
    ]

    assert missing == []
