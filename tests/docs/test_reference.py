"""The reference names everything that is public."""

import importlib
import inspect
import pkgutil
import re
import zlib
from pathlib import Path

import attrs
import pytest

import esair
import esair.boards
import esair.buses
import esair.drivers
from esair.config._components import accepted_by
from esair.config._parts import OF_ROBOT, TABLES, _Board

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"

BESIDE = [
    "esair.buses",
    "esair.config",
    "esair.control",
    "esair.discovery",
    "esair.firmware",
    "esair.framing",
    "esair.journal",
    "esair.minimal",
    "esair.peers",
    "esair.plan",
    "esair.recording",
    "esair.replay",
    "esair.seat",
    "esair.sim",
    "esair.testing",
    "esair.torture",
    "esair.watchdog",
]
"""What is public beside `esair` itself and the parts."""

IN_ESAIR = {
    "abc",
    "actions",
    "connections",
    "exceptions",
    "messages",
    "resources",
    "standard",
    "supervisors",
    "values",
}
"""Modules whose names are in `esair`."""

PRIVATE = {"cli", "codec", "demo", "flaws", "loading", "loop", "placement", "values"}

HIDDEN = {
    "esair.minimal.declared",
    "esair.sim.Simulation",
}
"""What is there for other modules of esair only."""


def documented(page: str) -> set[str]:
    text = (REFERENCE / page).read_text(encoding="utf-8")
    found = set(
        re.findall(
            r"auto(?:class|function|exception|data):: (\w+)$", text, re.MULTILINE
        )
    )
    for names in re.findall(r"automodule:: .*\n   :members: (.+)", text):
        found |= {name.strip() for name in names.split(",")}
    return found


def modules_in(package) -> list[str]:
    """The public modules of a package, by their full names."""
    return [
        f"{package.__name__}.{module.name}"
        for module in pkgutil.iter_modules(package.__path__)
        if not module.name.startswith("_")
    ]


PARTS = [
    name
    for package in (esair.buses, esair.drivers, esair.boards)
    for name in modules_in(package)
] + [
    fake.name
    for fake in pkgutil.walk_packages(esair.drivers.__path__, "esair.drivers.")
    if fake.name.rpartition(".")[2] in {"fake", "servo"} and fake.name.count(".") == 3
]


def test_every_public_name_is_in_the_reference() -> None:
    """Nothing that ``esair`` exports is missing, nothing else is there."""
    pages = ["robot.md", "actions.md", "resources.md", "messages.md", "errors.md"]
    found = set().union(*(documented(page) for page in pages))

    assert found - {"SensorPort", "ActuatorPort"} == set(esair.__all__)


def test_every_module_is_public_in_one_way_or_private() -> None:
    """A new one has to be put into the reference, or said to be private."""
    there = {each.removeprefix("esair.") for each in modules_in(esair)}
    beside = {each.removeprefix("esair.") for each in BESIDE}

    assert there == beside | IN_ESAIR | PRIVATE | {"boards", "drivers"}


@pytest.mark.parametrize("module", [*BESIDE, *PARTS])
def test_every_public_module_is_in_the_reference(module) -> None:
    """Once, on one of its pages."""
    pages = "".join(page.read_text(encoding="utf-8") for page in REFERENCE.glob("*.md"))

    assert len(re.findall(rf"automodule:: {re.escape(module)}$", pages, re.M)) == 1


def public(module: str) -> dict[str, object]:
    """The classes and functions that a module is imported for."""
    found = importlib.import_module(module)
    names = getattr(found, "__all__", None) or [
        name
        for name, value in vars(found).items()
        if not name.startswith("_")
        and getattr(value, "__module__", None) == found.__name__
    ]
    values = {name: getattr(found, name) for name in names}
    return {
        name: value
        for name, value in values.items()
        if isinstance(value, type) or inspect.isroutine(value)
    }


@pytest.mark.parametrize("module", ["esair", *BESIDE, *PARTS])
def test_every_public_class_and_function_has_a_docstring(module) -> None:
    """The reference is made from them."""
    missing = [name for name, value in public(module).items() if not value.__doc__]

    assert importlib.import_module(module).__doc__
    assert missing == []


@pytest.mark.xdist_group("pages")
def test_every_public_class_and_function_can_be_looked_up(built) -> None:
    """By its own name; what Sphinx has left out is not in its inventory."""
    pages, _ = built
    *_, packed = (pages / "objects.inv").read_bytes().split(b"\n", 4)
    listed = {line.split()[0] for line in zlib.decompress(packed).decode().splitlines()}
    wanted = {
        f"{module}.{name}": value
        for module in ["esair", *BESIDE, *PARTS]
        for name, value in public(module).items()
    }
    # What several packages hand out is listed with one of them.
    shown = {id(value) for name, value in wanted.items() if name in listed}

    assert {name for name in wanted if id(wanted[name]) not in shown} == HIDDEN


def quoted(page: str) -> set[str]:
    """The words of a page that stand as code."""
    text = (REFERENCE / page).read_text(encoding="utf-8")
    return set(re.findall(r"[\w-]+", " ".join(re.findall(r"`([^`]+)`", text))))


def test_every_verb_is_on_the_page_of_the_command_line() -> None:
    """A new one has to be written down there."""
    pytest.importorskip("cyclopts")
    from esair.cli._main import make_app
    from esair.cli._min import minimal

    verbs = {*make_app(), *minimal} - {"--help", "-h", "--version"}

    assert len(verbs) > 25
    assert verbs - quoted("command-line.md") == set()


def test_every_key_of_a_robot_toml_is_on_its_page() -> None:
    """Tables, and the keys that every component of a kind has."""
    parts = {"self", "name", "resources", "behaviors", "policies", *OF_ROBOT}
    kinds = (esair.Recording, esair.Operator, esair.Page, esair.Restart)
    keys = {*TABLES, *attrs.fields_dict(_Board)} | {
        *inspect.signature(esair.Robot).parameters
    } - parts
    for kind in kinds:
        keys |= {*attrs.fields_dict(kind)}
    for base in (esair.Sensor, esair.Actuator, esair.Behavior, esair.Reaction):
        keys |= {*accepted_by(base)}

    assert len(keys) > 60
    assert keys - quoted("configuration.md") == set()
