"""Which room may look into which."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import esair

ROOT = Path(esair.__file__).parent
PACKAGES = sorted(place.parent.name for place in ROOT.glob("*/__init__.py"))
"""All of them keep the rule."""


def private_imports(file: Path) -> list[str]:
    """The modules with an underscore that a file imports and is no neighbour of."""
    own = ("esair", *file.relative_to(ROOT).with_suffix("").parts)
    found = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not node.module:
            continue
        for name in node.names:
            path = (*node.module.split("."), name.name)
            for n, part in enumerate(path):
                if path[0] == "esair" and part.startswith("_") and part[1:2] != "_":
                    if own[:n] != path[:n]:
                        found.append(".".join(path))
                    break
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_no_package_looks_into_another(package: str) -> None:
    """What a name with an underscore is for is known in its own package only."""
    wrong = {
        str(file.relative_to(ROOT)): found
        for file in (ROOT / package).rglob("*.py")
        if (found := private_imports(file))
    }

    assert wrong == {}


@pytest.mark.parametrize("package", ["buses", "discovery", "drivers", "sim", "testing"])
def test_no_file_is_longer_than_500_lines(package: str) -> None:
    """A longer one has two ideas."""
    lengths = {
        str(file.relative_to(ROOT)): len(file.read_text(encoding="utf-8").splitlines())
        for file in (ROOT / package).rglob("*.py")
    }

    assert {name: n for name, n in lengths.items() if n > 500} == {}
