"""The recipes of the cookbook: each one's drawing is that of its run."""

import asyncio
import importlib
import sys
from pathlib import Path

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

CODE = Path(__file__).parents[2] / "docs" / "code" / "cookbook"
RECIPES = sorted(each.stem for each in CODE.glob("*.py") if each.stem != "steps")
SIGN = 0.25  # seconds

EVENTS = {
    "race": [(1.5, "beacon", True)],
    "patrol": [(2.5, "alarm", True), (3.0, "alarm", False)],
    "subsumption": [
        (1.5, "sonar", True),
        (2.5, "sonar", False),
        (2.5, "bumper", True),
        (3.0, "bumper", False),
    ],
    "blending": [(2.0, "near", True)],
    "pause": [(1.0, "pause", True), (2.0, "pause", False)],
}
"""What the world does, and when, in seconds."""


@pytest.fixture
def recipe(request, monkeypatch):
    monkeypatch.syspath_prepend(str(CODE))
    names = [request.param, "steps"]
    for name in names:
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield importlib.import_module(request.param)
    for name in names:
        sys.modules.pop(name, None)


def drawing_of(recipe):
    """Return the drawing in a recipe's docstring, by the names of its lines."""
    pairs = [line.split() for line in recipe.__doc__.splitlines()[1:]]
    return dict(pair for pair in pairs if len(pair) == 2)


def sign_of(command) -> str:
    if isinstance(command, float):
        return str(round(10 * command)) if command else "."
    return str(command)[0].upper()


async def run_of(recipe, signs):
    """Run a recipe on fakes, and draw what its actuators do."""
    drawn = drawing_of(recipe)
    read = {name for name, line in drawn.items() if set(line) <= {"-", "#"}}
    sensors = {name: FakeSensor(name, False, type=bool, rate=20.0) for name in read}
    actuators = {
        name: FakeActuator(name, safe=0.0 if name == "speed" else ".")
        for name in drawn.keys() - read
    }
    lines = dict.fromkeys(drawn, "")
    parts = [*sensors.values(), *actuators.values()]
    async with recipe.make_robot(*parts) as robot:
        begin = esair.now()
        events = list(EVENTS.get(recipe.__name__, ()))
        for number in range(signs):
            while events and events[0][0] <= number * SIGN:
                _, name, value = events.pop(0)
                sensors[name].feed(value)
            await asyncio.sleep(begin + (number + 0.5) * SIGN - esair.now())
            for name, actuator in actuators.items():
                lines[name] += sign_of(actuator.commands[-1])
            for name in sensors:
                now = robot.sensors.channels[name].newest
                lines[name] += "#" if now is not None and now.value else "-"
            await asyncio.sleep(begin + (number + 1) * SIGN - esair.now())
    return lines


@pytest.mark.virtual_clock
@pytest.mark.parametrize("recipe", RECIPES, indirect=True)
async def test_the_drawing_is_that_of_the_run(recipe) -> None:
    """Who moves what, a quarter of a second a sign; the last is what a stop leaves."""
    drawn = drawing_of(recipe)
    (signs,) = {len(line) for line in drawn.values()}

    assert await run_of(recipe, signs) == drawn


def test_there_are_twelve() -> None:
    """Each stands in the page, as a whole."""
    page = (CODE.parents[1] / "how-to" / "cookbook.md").read_text(encoding="utf-8")

    assert len(RECIPES) == 12
    for name in RECIPES:
        assert f"<!-- code: docs/code/cookbook/{name}.py -->" in page
