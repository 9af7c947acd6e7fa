"""The reference names everything that is public."""

import re
from pathlib import Path

import pytest

import esair
import esair.buses
import esair.testing

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"


def documented(page: str) -> set[str]:
    text = (REFERENCE / page).read_text(encoding="utf-8")
    found = set(re.findall(r"auto(?:class|function):: (\w+)$", text, re.MULTILINE))
    for names in re.findall(r"automodule:: .*\n   :members: (.+)", text):
        found |= {name.strip() for name in names.split(",")}
    return found


def test_every_public_name_is_in_the_reference() -> None:
    """Nothing that ``esair`` exports is missing, nothing else is there."""
    pages = ["robot.md", "actions.md", "resources.md", "messages.md", "errors.md"]
    found = set().union(*(documented(page) for page in pages))

    assert found - {"SensorPort", "ActuatorPort"} == set(esair.__all__)


@pytest.mark.parametrize("module", [esair, esair.buses, esair.testing])
def test_every_public_name_has_a_docstring(module) -> None:
    """The reference is made from them."""
    missing = [name for name in module.__all__ if not getattr(module, name).__doc__]

    assert missing == []
