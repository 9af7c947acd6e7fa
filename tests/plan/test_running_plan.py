"""The plan of a robot that runs says what one made of its parts anew would say."""

from __future__ import annotations

import random
from typing import Any

import pytest

import esair
from esair.messages import Access, Policy
from esair.plan import (
    Finding,
    Plan,
    errors_in,
    examine,
    examine_action,
    examine_resource,
)

HISTORIES = 12
LONG_HISTORIES, SOAK_HISTORIES = 300, 10_000

NAMES = ("a", "b", "c", "d", "e")


class Sense(esair.Sensor[float]):
    def __init__(self, claim: str | None = None, **options: Any) -> None:
        super().__init__(**options)
        self.claim = claim

    async def read(self) -> float:
        return 0.0


class Word(esair.Sensor[str]):
    async def read(self) -> str:
        return ""


class Move(esair.Actuator[float]):
    safe = 0.0

    async def write(self, command: float) -> None:
        """Move."""


class Sum(esair.Derived[float]):
    def compute(self, **readings: float) -> float:
        return sum(readings.values())


class Act(esair.Reaction):
    rate = 10.0

    def react(self, **readings: Any) -> None:
        return None


class Idle(esair.Behavior):
    """One that declares nothing."""


def resource(dice: random.Random, name: str) -> Any:
    """Make a sound resource, or one that claims, or computes of others."""
    kind = dice.randrange(5)
    if kind == 0:
        return Word(name=name)
    if kind == 1:
        return Move(name=name)
    if kind == 2:
        sources = dice.sample(NAMES, dice.randrange(1, 3))
        return Sum(
            name=name,
            reads={f"in_{each}": esair.reads(float, name=each) for each in sources},
        )
    return Sense(name=name, claim=dice.choice([None, "one", "two"]))


def action(dice: random.Random, name: str, there: dict[str, Any]) -> Any:
    """Make an action: most read and write what is there, and of the right type."""
    if dice.random() < 0.1:
        return Idle(name=name)
    fits = dice.random() < 0.8
    moved = [n for n, each in there.items() if isinstance(each, Move)]
    heard = [n for n, each in there.items() if not isinstance(each, Move)]
    heard += [f"{n}.applied" for n in moved]
    if not fits:
        heard, moved = [*NAMES, "a.applied", "f"], list(NAMES)
    reads: dict[str, Any] = {}
    for each in dice.sample(heard, dice.randrange(min(len(heard), 2) + 1)):
        kind = str if fits and isinstance(there.get(each), Word) else float
        reads[f"in_{each.replace('.', '_')}"] = esair.reads(kind, name=each)
    writes = {
        f"out_{each}": esair.writes(float, name=each, priority=dice.randrange(3))
        for each in dice.sample(moved, dice.randrange(min(len(moved), 2) + 1))
    }
    return Act(name=name, reads=reads, writes=writes)


POLICIES = (
    Policy("b", allow={"*": Access.READ | Access.WRITE}, max_priority={"*": 1}),
    Policy("c", allow={"*": Access.READ | Access.WRITE}, exclusive=True),
    Policy("d", allow={"p": Access.READ, "*": Access(0)}),
)


class Robot:
    """Its parts in lists, as a script has them, and the plan that lives beside."""

    def __init__(self) -> None:
        self.resources: dict[str, Any] = {}
        self.actions: dict[str, Any] = {}
        self.plan = Plan(policies=POLICIES, writers=self.writers)

    def writers(self, name: str) -> list[str]:
        return list(self.anew().writes_of(name))

    def anew(self, new: Any = None) -> Plan:
        """Make a plan of the lists, with a resource that comes last."""
        resources = dict(self.resources)
        if new is not None:
            resources.pop(new.name, None)
            resources[new.name] = new
        return Plan(
            resources=tuple(resources.values()),
            behaviors=tuple(self.actions.values()),
            policies=POLICIES,
        )

    def check(self) -> None:
        """Every table is what it would be if it were made now."""
        plan, anew = self.plan, self.anew()
        assert plan.resource_of == anew.resource_of
        assert plan.derived_of == anew.derived_of
        assert plan.action_of == anew.action_of
        assert plan.needs_of == anew.needs_of
        assert plan.claims == anew.claims
        assert plan.resource_names == anew.resource_names
        assert plan.action_names == anew.action_names
        for name in NAMES:
            users = {u for u, _, _, need in anew.needs() if need.provider == name}
            assert set(plan.users_of(name)) == users


def about(found: list[Finding], component: Any) -> list[tuple[str, ...]]:
    """The mistakes in one component, and what policies say against it alone."""
    return sorted(
        (each.rule, each.component, each.field, each.text)
        for each in found
        if each.is_error
        and each.rule != "rights"
        and (each.subject is component or each.rule == "denied")
    )


def not_denied(found: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    return [each for each in found if each[0] != "denied"]


def history(dice: random.Random) -> tuple[int, int]:
    """Add, remove and replace; returns how many were refused, and used something."""
    robot, refused, used = Robot(), 0, 0
    for _ in range(dice.randrange(5, 25)):
        if dice.random() < 0.6:
            name = dice.choice(NAMES)
            there = robot.resources.get(name)
            if there is not None and dice.random() < 0.4:
                del robot.resources[name]
                robot.plan.leave_resource(name)
            else:
                new = resource(dice, name)
                found = examine_resource(robot.plan, new, instead_of=there)
                everything = examine(robot.anew(new))
                full, mine = about(everything, new), about(found, new)
                if any(each.subject in robot.resources.values() for each in everything):
                    # The whole says who shares only if all are sound by themselves.
                    full = [each for each in full if each[0] != "claim"]
                    mine = [each for each in mine if each[0] != "claim"]
                assert not_denied(mine) == not_denied(full)
                if errors_in(found):
                    refused += 1
                else:
                    robot.resources[name] = new
                    robot.plan.enter_resource(new)
        else:
            name = dice.choice("pqr")
            there = robot.actions.get(name)
            if there is not None and dice.random() < 0.4:
                del robot.actions[name]
                robot.plan.leave_action(name)
            else:
                new = action(dice, name, robot.resources)
                found = examine_action(robot.plan, new, instead_of=there)
                others = {n: a for n, a in robot.actions.items() if n != name}
                before = Plan(
                    resources=tuple(robot.resources.values()),
                    behaviors=(*others.values(),),
                    policies=POLICIES,
                )
                after = Plan(
                    resources=before.resources,
                    behaviors=(*others.values(), new),
                    policies=POLICIES,
                )
                known = about(examine(before), None)
                full = about(examine(after), new)
                for each in known:
                    full.remove(each)
                assert about(found, new) == full
                if errors_in(found):
                    refused += 1
                else:
                    robot.actions[name] = new
                    robot.plan.enter_action(new)
                    used += bool(new.needs)
        robot.check()
    return refused, used


@pytest.mark.longer
@pytest.mark.promise("RS-8")
def test_what_comes_and_goes_is_examined_as_the_whole_would_be(
    request: pytest.FixtureRequest,
) -> None:
    """After any history of add, remove and replace, in tables that were never made anew."""
    option = request.config.getoption
    soak, long = option("--esair-soak"), option("--esair-long")
    histories = SOAK_HISTORIES if soak else LONG_HISTORIES if long else HISTORIES
    refused = used = 0
    for number in range(histories):
        more = history(random.Random(number))
        refused, used = refused + more[0], used + more[1]
    assert min(refused, used) > histories
