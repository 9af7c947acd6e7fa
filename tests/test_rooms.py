"""Which room may look into which."""

from __future__ import annotations

import ast
import functools
import graphlib
from pathlib import Path

import grimp
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


@pytest.mark.long
@pytest.mark.parametrize("package", PACKAGES)
def test_no_package_looks_into_another(package: str) -> None:
    """What a name with an underscore is for is known in its own package only."""
    wrong = {
        str(file.relative_to(ROOT)): found
        for file in (ROOT / package).rglob("*.py")
        if (found := private_imports(file))
    }

    assert wrong == {}


ONE_CIRCLE = {
    ("esair.standard._robot", "esair.config"),  # Robot.from_config
    ("esair.standard._robot", "esair.seat"),  # a robot has its seat, and ends it
}
"""What closes the one circle of imports; why it stays is told in ARCHITECTURE.md."""

PARTS_OF_ONE = {
    "esair.actions": {
        *("_flow", "_reaction_runner"),
        *("_behavior", "_needs"),
    },
    "esair.loop": {
        *("_budget", "_deadlines", "_door", "_of_loop"),
        *("_scheduler", "_tape", "_turn"),
    },
    "esair.connections": {
        *("_actuator_channel", "_device", "_gate", "_hearing"),
        *("_protection", "_sensor_channel", "_turns", "_wire"),
    },
    "esair.placement": {"_child", "_home", "_loop"},
    "esair.seat": {"_acts", "_operator"},
    "esair.standard": {"_recording", "_robot"},
    "esair.supervisors": {
        *("_behavior_deployment", "_member", "_grants"),
        *("_mediator", "_requests"),
        *("_control_path", "_resource_deployment", "_resource_life", "_watching"),
    },
    "esair.torture": {"_gate", "_judge", "_kinds", "_life", "_world"},
}
"""Parts that name the type of what they are parts of; they do not import it."""


@functools.cache
def imports(*, with_types: bool) -> frozenset[tuple[str, str]]:
    """Who imports whom, with or without what only a type checker sees."""
    graph = grimp.build_graph(
        "esair", exclude_type_checking_imports=not with_types, cache_dir=None
    )
    return frozenset(
        (module, other)
        for module in graph.modules
        for other in graph.find_modules_directly_imported_by(module)
    )


def circle_of(arrows: frozenset[tuple[str, str]]) -> list[str]:
    """Return a circle that the arrows close; an empty list if there is none."""
    sorter: graphlib.TopologicalSorter[str] = graphlib.TopologicalSorter()
    for module, other in arrows:
        sorter.add(module, other)
    try:
        sorter.prepare()
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


def test_imports_go_round_in_one_circle_only() -> None:
    """The robot is made from a file, which makes a robot."""
    arrows = imports(with_types=False)

    assert arrows >= ONE_CIRCLE
    assert circle_of(arrows)
    assert circle_of(arrows - ONE_CIRCLE) == []


def test_types_go_round_inside_of_what_is_one_thing_only() -> None:
    """Elsewhere a part says in a protocol, or a base, what it needs of its owner."""
    arrows = imports(with_types=True)
    parts = {
        f"{room}.{name}": room for room, names in PARTS_OF_ONE.items() for name in names
    }
    owners = {
        (part, owner)
        for part, owner in arrows - imports(with_types=False)
        if parts.get(part, part) == parts.get(owner, owner)
    }

    assert {part for arrow in owners for part in arrow} == parts.keys()
    assert circle_of(arrows - ONE_CIRCLE - owners) == []


def test_no_file_is_longer_than_800_lines() -> None:
    """A longer one holds two ideas; one idea is one file, however long until then."""
    lengths = {
        str(file.relative_to(ROOT)): len(file.read_text(encoding="utf-8").splitlines())
        for file in ROOT.rglob("*.py")
        if file.name != "minimal.py"  # one file, copied to a board as it is
    }

    assert {name: n for name, n in lengths.items() if n > 800} == {}
