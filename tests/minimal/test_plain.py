"""The plain form of MIN on its page decides the same, and so does the page's table."""

import importlib
import random
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.minimal import settle_rows, worlds
from tests.minimal.test_replay import some_worlds, steps_of

from esair.minimal import Loop

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "code"))
plain_min: Any = importlib.import_module("plain_min")

PAGE = ROOT / "docs" / "explanation" / "min-in-ten-minutes.md"
LOOPS = pytest.mark.parametrize("loop", [Loop, plain_min.Loop], ids=["MIN", "plain"])

pytestmark = pytest.mark.promise("MIN-3")


@pytest.mark.longer
def test_the_plain_form_tells_each_actuator_the_same(
    request, monkeypatch, soak
) -> None:
    """In random robots without guards, step by step."""
    many = some_worlds(random.randrange(2**32) if soak else 7, 1000 if soak else 60)
    told = [steps_of(worlds.play(world), world) for world in many]
    monkeypatch.setattr(worlds, "Loop", plain_min.Loop)
    plain = [steps_of(worlds.play(world), world) for world in many]

    assert [i for i in range(len(many)) if told[i] != plain[i]] == []


def test_it_is_short() -> None:
    """Two hundred lines, but for what is blank or says what it does."""
    text = Path(plain_min.__file__).read_text(encoding="utf-8")
    lines = [each.strip() for each in text.splitlines()]
    assert len([each for each in lines if each and each[0] not in '#"']) <= 200


def cells() -> list[tuple[str, str, str, str]]:
    """State, who is blind, who asks, and what the table says."""
    rows = [
        [each.strip() for each in line.strip("|\n").split("|")]
        for line in PAGE.read_text(encoding="utf-8").splitlines()
        if line.startswith(("| nobody |", "| mid,"))
    ]
    found = [
        (row[0], row[1], asks, says)
        for row in rows
        for asks, says in zip(("nobody", *settle_rows.SAYS), row[2:], strict=True)
    ]
    assert len(found) == len(settle_rows.STATES) * 4 * 4
    return found


@LOOPS
@pytest.mark.parametrize(("state", "blind", "asks", "says"), cells())
def test_who_moves_it_is_what_the_table_says(loop, state, blind, asks, says) -> None:
    """Each state of an actuator, each that may be blind, each that may ask."""
    if says == "-":
        assert asks == blind
    else:
        assert settle_rows.outcome(loop, state, blind, asks) == says
