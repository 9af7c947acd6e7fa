"""The page of the architecture names places that are there, and all of them."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "esair"
PAGE = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")


def test_the_tree_is_the_tree() -> None:
    """Each package and module of the first level, and nothing else."""
    tree = PAGE.split("```text\nsrc/esair/\n")[1].split("```")[0]
    named = set()
    for line in tree.splitlines():
        if re.match(r"  \S", line):
            named |= set(re.findall(r"(\w+)(?:/|\.py)(?=\s)", line))
    there = {
        path.stem
        for path in SOURCE.iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").exists())
        and not path.name.startswith("__")
    }

    assert named == there


def test_each_medium_has_its_name_in_the_tree() -> None:
    """Whoever looks for a wire finds its folder."""
    rooms = {path.parent.name for path in (SOURCE / "buses").glob("*/__init__.py")}
    buses = PAGE.split("\n  buses/")[1].split("\n  resources/")[0]

    assert set(re.findall(r"(\w+)/(?=\s)", buses)) == rooms


def test_the_line_of_layers_is_that_of_import_linter() -> None:
    """What stands above what is said once more, and is the same."""
    told = PAGE.split("```text\ncli >")[1].split("```")[0]
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (contract,) = (
        each
        for each in table["tool"]["importlinter"]["contracts"]
        if each["type"] == "layers" and each["containers"] == ["esair"]
    )
    layers = [re.sub(r"[()]", "", each) for each in contract["layers"]]

    assert " ".join(f"cli > {told}".split()) == " > ".join(layers[1:])


def test_every_place_that_is_named_is_there() -> None:
    """Files and folders of the tables and of the mechanisms."""
    places = re.findall(r"`((?:[a-z_]+/)+(?:[a-z_]+\.py)?)`", PAGE)
    missing = [
        place
        for place in places
        if not any((base / place).exists() for base in (SOURCE, ROOT))
    ]

    assert len(places) > 30
    assert missing == []


def test_each_of_fifteen_changes_has_its_place() -> None:
    """One line for each."""
    table = PAGE.split("## Fifteen changes, and where each is made")[1].split("\n## ")[
        0
    ]

    assert len(re.findall(r"^\| [a-z].* \| .*`", table, re.M)) == 15
