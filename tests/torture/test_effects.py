"""What torture sees of rules that a kernel does not heed: by what is told, read and stands."""

from __future__ import annotations

from typing import Any

import pytest

import esair
from esair.connections import ActuatorChannel, SensorPort
from esair.connections._actuator_channel import Hold
from esair.connections._protection import Protection
from esair.torture import Step, Story, Target, World
from esair.torture._gate import Gate, Told


class Sonar(esair.Sensor[float]):
    """It sees something nearer and nearer, and then far."""

    rate = 17.0

    def __init__(self) -> None:
        super().__init__()
        self.asked = 0

    async def read(self) -> float:
        self.asked += 1
        return 1.0 - self.asked % 40 / 40


class Wheels(esair.Actuator[float]):
    """Wheels that stop by themselves late."""

    safe = 0.0
    command_timeout = 0.4

    async def write(self, command: float) -> None: ...


class KeepClear(esair.Reaction):
    """Stop before what is near, until somebody has looked."""

    sonar = esair.reads(float, max_age=2.0)
    wheels = esair.guards(float, latch=True)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels if sonar > 0.1 else None


class Approach(esair.Behavior):
    """Drive by what it sees now."""

    sonar = esair.reads(float, max_age=0.2)
    wheels = esair.writes(float, priority=3)

    async def run(self) -> None:
        async for _ in esair.every(0.07):
            try:
                distance = await self.sonar.read()
            except (esair.StaleReadingError, esair.DeviceLostError):
                continue
            await self.wheels.write(distance / 3)


class Wander(esair.Behavior):
    """Drive when nobody else does."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(0.3)


def robot() -> esair.Robot:
    return esair.Robot(
        resources=[Sonar(), Wheels()],
        behaviors=[KeepClear(), Approach(), Wander()],
    )


def told(*steps: Step, lasts: float = 4.0) -> set[tuple[str, str]]:
    """Tell a story of the robot; return the rules that were broken, and where."""
    outcome = World(Target("robot", robot), Story(0, steps, lasts)).run()
    return {each.key for each in outcome.violations}


SILENT = Step(1.0, "silent", "sonar", lasts=1.0)
HALT = Step(1.0, "halt", lasts=1.0)


def test_a_robot_that_heeds_the_rules_is_not_blamed() -> None:
    """Not while its sensor is silent, its guard latched, it halted."""
    assert not told(SILENT, lasts=9.0)
    assert not told(HALT)


def test_a_value_that_is_too_old_is_seen_where_it_is_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever the kernel says of its age: the robot had no newer one."""

    async def read(port: SensorPort[Any], **_: Any) -> Any:
        newest = port._channel.newest
        return 1.0 if newest is None else newest.value

    monkeypatch.setattr(SensorPort, "read", read)

    assert told(SILENT) == {("stale", "approach")}


def test_a_latch_that_is_not_heeded_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has refused a command, and lets one pass before anybody has reset it."""
    monkeypatch.setattr(Protection, "_latch", lambda *_: None)

    assert told(lasts=6.0) == {("blind", "wheels")}


def test_what_a_halt_lets_stand_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dead man made it safe, half a command time-out later."""
    monkeypatch.setattr(ActuatorChannel, "halt", ActuatorChannel.bar)

    assert told(HALT, lasts=2.5) == {("halted", "wheels")}


def test_a_hold_that_is_not_heeded_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lower priority moves what a higher one holds."""
    monkeypatch.setattr(Hold, "keeps_away", lambda *_: False)

    assert ("priority", "wheels") in told(lasts=2.0)


class Paced(Approach):
    """Drive as often as the devices let it."""

    async def run(self) -> None:
        while True:
            await self.wheels.write(await self.sonar.read(fresh=True) / 3)


def paced() -> esair.Robot:
    return esair.Robot(resources=[Sonar(), Wheels()], behaviors=[Paced()])


def test_a_loop_that_its_devices_pace_is_not_blamed() -> None:
    """Its devices here answer at once; time goes on all the same."""
    assert World(Target("robot", paced), Story(0, (), 1.0)).run().violations == ()


class Long(list[Told]):
    """What a device was told; it counts how often all of that is looked at."""

    looks = 0

    def index(self, *_: Any) -> int:
        Long.looks += 1
        return super().index(*_)


def test_a_long_history_costs_no_more_for_each_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What lands is compared with the newest safe command alone."""
    install = Gate._install

    def installed(gate: Gate, alone: bool) -> None:
        gate.told = Long()
        install(gate, alone=alone)

    monkeypatch.setattr(Gate, "_install", installed)

    assert not told()
    assert Long.looks == 0
