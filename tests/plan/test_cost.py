"""What it costs to examine a robot."""

from __future__ import annotations

import sys

import esair
from esair.plan import Plan, examine


class Motor(esair.Actuator[float]):
    """An actuator, one of many."""

    safe = 0.0

    async def write(self, command: float) -> None:
        """Take a command."""


class Move(esair.Reaction):
    """A reaction that writes one of them."""

    rate = 10.0

    def react(self) -> float:
        return 1.0


def calls_for(count: int) -> int:
    """Count the functions that are called, generators that go on too."""
    plan = Plan(
        resources=[Motor(name=f"motor_{number}") for number in range(count)],
        behaviors=[
            Move(
                name=f"move_{number}",
                writes={"motor": esair.writes(float, name=f"motor_{number}")},
            )
            for number in range(count)
        ],
    )
    examine(plan)  # what is found once for each class is known then
    calls = 0

    def count_call(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    again = Plan(resources=plan.resources, behaviors=plan.behaviors)
    sys.setprofile(count_call)
    try:
        examine(again)
    finally:
        sys.setprofile(None)
    return calls


def test_to_examine_twice_as_many_parts_takes_twice_as_long() -> None:
    assert calls_for(80) < 2.2 * calls_for(40)
