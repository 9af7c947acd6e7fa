"""One decision for each actuator in each turn, whoever decided first."""

from __future__ import annotations

import asyncio
import itertools
import random
from typing import Any

import pytest
from tests.turn import worlds

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Says(esair.Reaction):
    """Decides what the sensor says, by a table."""

    rate = 20.0
    sensor = esair.reads(float)
    motor = esair.writes(float)

    def __init__(self, name: str, priority: int, table: dict[float, Any]) -> None:
        super().__init__(
            name=name, writes={"motor": esair.writes(float, priority=priority)}
        )
        self.table = table

    def react(self, sensor: float) -> Any:
        return self.table.get(sensor)


async def commands(reactions: list[Says], values: list[float]) -> list[Any]:
    """Return what the motor is told, but the safe commands at both ends."""
    sensor, motor = FakeSensor("sensor", -1.0), FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[sensor, motor], behaviors=reactions):
        await asyncio.sleep(0.01)
        for value in values:
            sensor.feed(value)
            await asyncio.sleep(0.05)
    return motor.commands[1:-2]  # at the stop: at once, and once more


def orders(make: Any) -> list[list[Says]]:
    return [list(order) for order in itertools.permutations(make())]


@pytest.mark.promise("TURN-2", "AC-2")
async def test_the_highest_priority_wins_from_the_first_turn() -> None:
    """A lower one that steps first does not get a command through."""

    def make() -> list[Says]:
        return [Says(f"r{i}", i, {1.0: float(i + 1)}) for i in range(3)]

    for order in orders(make):
        assert await commands(order, [1.0, 1.0]) == [3.0, 3.0]


@pytest.mark.promise("TURN-2", "AC-2")
async def test_among_equals_the_holder_goes_on_and_else_the_name_decides() -> None:
    """First only b decides, then both."""

    def make() -> list[Says]:
        return [Says("a", 1, {2.0: 10.0}), Says("b", 1, {1.0: 20.0, 2.0: 21.0})]

    for order in orders(make):
        assert await commands(order, [1.0, 2.0, 2.0]) == [20.0, 21.0, 21.0]
    for order in orders(make):
        assert await commands(order, [2.0, 2.0]) == [10.0, 10.0]


@pytest.mark.promise("TURN-2", "AC-2")
async def test_a_release_and_a_lower_write_are_one_command() -> None:
    """The lower priority gets through in the very turn in which the holder lets go."""

    def make() -> list[Says]:
        return [Says("high", 2, {1.0: 5.0}), Says("low", 1, {1.0: 7.0, 2.0: 8.0})]

    for order in orders(make):
        assert await commands(order, [1.0, 2.0, 1.0]) == [5.0, 8.0, 5.0]


@pytest.mark.promise("TURN-2", "AC-2", "PRO-1")
async def test_a_bad_command_wins_against_less_and_loses_to_more() -> None:
    """It is blindness: who has less may not drive on it, who has more may."""

    def make(priority: int) -> list[Says]:
        bad = Says("bad", 2, {1.0: float("nan"), 2.0: 3.0})
        return [bad, Says("other", priority, {1.0: 7.0, 2.0: 8.0})]

    for order in orders(lambda: make(1)):
        assert await commands(order, [1.0, 1.0, 2.0]) == [3.0]
    for order in orders(lambda: make(3)):
        assert await commands(order, [1.0, 1.0]) == [7.0, 7.0]


@pytest.mark.promise("TURN-2", "AC-2")
async def test_losers_get_their_refused() -> None:
    """It is counted, and it is an event that names the winner."""
    sensor, motor = FakeSensor("sensor", 1.0), FakeActuator("motor", safe=0.0)
    reactions = [Says(f"r{i}", i, {1.0: float(i + 1)}) for i in range(3)]
    robot = esair.Robot(resources=[sensor, motor], behaviors=reactions)
    heard: list[Any] = []
    robot.journal.listen(heard.append)
    async with robot:
        sensor.feed(1.0)
        await asyncio.sleep(0.06)
        refusals = robot.journal.counts()["motor"]["refusals"]

    refused = [event for event in heard if event.kind.name == "REFUSED"]
    assert len(refused) == refusals >= 2
    assert {event.value.holder for event in refused} == {"r2"}


@pytest.mark.real_clock
@pytest.mark.promise("TURN-2", "TURN-6")
def test_any_order_of_components_gives_the_same(request: pytest.FixtureRequest) -> None:
    """Random wirings, in several orders, with threads that take any time."""
    soak = request.config.getoption("--esair-soak")
    differ = []
    for seed in range(1000, 1300 if soak else 1002):
        told = worlds.play(seed)
        orders = (random.Random(order) for order in range(3))
        if any(worlds.play(seed, order) != told for order in orders):
            differ.append(seed)
    assert differ == []


@pytest.mark.promise("PRO-1", "TURN-2")
async def test_who_gives_back_later_leaves_it_to_who_is_blind() -> None:
    """Also after a turn in which several have decided: the last of it was another."""

    class Steps(esair.Reaction):
        rate = 20.0

        def __init__(self, name: str, priority: int, commands: list[float]) -> None:
            writes = {"motor": esair.writes(float, priority=priority, blind="release")}
            super().__init__(name=name, writes=writes)
            self.commands = commands

        def react(self) -> float | None:
            return self.commands.pop(0) if self.commands else None

    class Blind(esair.Reaction):
        sonar = esair.reads(float)
        motor = esair.writes(float)

        def react(self, sonar: float) -> float | None:
            return None

    sonar, motor = FakeSensor("sonar", 1.0, rate=20.0), FakeActuator("motor", safe=0.0)
    motor.command_timeout = 9.0
    sonar.unplug()
    steps = [Steps("high", 5, [2.0] * 20), Steps("mid", 4, [1.0] * 10)]
    async with esair.Robot(resources=[sonar, motor], behaviors=[*steps, Blind()]):
        await motor.until(2.0, timeout=2.0)
        await motor.until(0.0, timeout=1.5)


class Slow(esair.Actuator[float]):
    """Takes longer for a command than a hold lasts."""

    safe = 0.0
    command_timeout = 0.2
    told: list[float]

    async def open(self) -> None:
        self.told = []

    async def write(self, command: float) -> None:
        self.told.append(command)
        if command:
            await asyncio.sleep(0.5)


@pytest.mark.promise("TURN-2", "AC-2")
async def test_who_waits_for_its_own_write_wins_all_the_same() -> None:
    """Its hold is over while the device is slow: a lower one gets nothing through."""
    motor, sensor = Slow(name="motor"), FakeSensor("sensor", 1.0)
    reactions = [Says("high", 5, {1.0: 2.0}), Says("low", 1, {1.0: 1.0})]
    async with esair.Robot(resources=[sensor, motor], behaviors=reactions):
        await asyncio.sleep(2.0)
    assert set(motor.told) == {0.0, 2.0}
