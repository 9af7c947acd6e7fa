"""What was given up is counted where a user can read it, whoever has given it up."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

import pytest

import esair
from esair.drivers.line import LineSensor
from esair.journal import Journal, Kind
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.promise("TURN-5"), pytest.mark.virtual_clock]


class Idle(esair.Behavior):
    """Takes nothing, and gives one thing at a time."""

    inbox_size = 1
    outbox_size = 1
    inbox_policy = "drop_oldest"
    outbox_policy = "reject"

    async def run(self) -> None:
        await asyncio.Event().wait()


class Sonar(esair.Sensor[float]):
    """Counts something of its own, and something that every sensor counts."""

    async def read(self) -> float:
        return 1.0

    def counts(self) -> Mapping[str, int]:
        return {"echoes": 3, "dropped": 2}


class Wrong(Sonar):
    """Cannot count."""

    def counts(self) -> Mapping[str, Any]:
        return {"echoes": "many"}


async def test_everything_is_counted_from_zero() -> None:
    """Of what nobody has used nothing is told, of any kind of component."""
    parts = FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[*parts], behaviors=[Idle()]) as robot:
        counts = robot.journal.counts()
    for name in ("sonar", "wheels", "resources", "idle", "behaviors"):
        assert counts[name]
        assert set(counts[name].values()) == {0}, name


async def test_a_driver_counts_too() -> None:
    """What it counts under the name that every sensor has is added to it."""
    async with esair.Robot(resources=[Sonar()]) as robot:
        counts = robot.journal.counts()["sonar"]
    assert (counts["echoes"], counts["dropped"]) == (3, 2)


async def test_a_driver_that_cannot_count_hides_nothing() -> None:
    """The others' counters are there, and its own of esair."""
    async with esair.Robot(resources=[Wrong(), Sonar(name="other")]) as robot:
        counts = robot.journal.counts()
    assert counts["wrong"]["uncountable"] == 1
    assert counts["wrong"]["losses"] == 0
    assert counts["other"]["echoes"] == 3


async def test_a_bad_line_is_counted(fake_serial: Any) -> None:
    """It is told by the counters of the robot, not by the driver alone."""
    port = fake_serial("front")
    sonar = LineSensor(name="sonar", bus=port)
    async with esair.Robot(resources=[sonar]) as robot:
        await asyncio.sleep(0.1)
        port.feed(b"sonar=much\n")
        await asyncio.sleep(0.1)
        assert robot.journal.counts()["sonar"]["bad_lines"] == sonar.bad_lines == 1


async def test_a_listener_that_left_has_lost_what_it_lost() -> None:
    """Its drops stay counted."""
    journal = Journal()
    journal.start(asyncio.get_running_loop())
    listener = journal.listen(lambda _: None, backlog=3)
    for _ in range(10):
        journal.publish(Kind.READING, "sonar")
    journal.forget(listener)
    journal.forget(listener)
    assert journal.counts()["journal"]["dropped"] == 7


async def test_what_a_full_box_gave_up_is_counted() -> None:
    """Dropped by its policy, or turned away with an error."""
    idle = Idle()
    async with esair.Robot(behaviors=[idle]) as robot:
        for data in range(3):
            await robot.behaviors.put(data, sender="user", receiver="idle")
        idle.offer(1)
        with pytest.raises(esair.BusyError):
            idle.offer(2)
        counts = robot.journal.counts()["idle"]
    assert (counts["dropped"], counts["turned_away"]) == (2, 1)


async def test_a_reader_too_many_is_counted(
    monkeypatch: pytest.MonkeyPatch, fake_sensor: Any
) -> None:
    """Who has to be turned away at a bound is counted there."""
    monkeypatch.setattr("esair.connections._hearing.WAITING_LIMIT", 1)
    sonar = fake_sensor("sonar", 1.0)
    async with esair.Robot(resources=[sonar]) as robot:
        port = await robot.resources.register("me", "sonar", esair.Access.READ)
        sonar.stall()
        reads = [robot.sensors.read(port, fresh=True, timeout=0.1) for _ in range(3)]
        errors = await asyncio.gather(*reads, return_exceptions=True)
        assert sum(isinstance(each, esair.BusyError) for each in errors) == 2
        assert robot.journal.counts()["sonar"]["turned_away"] == 2


@pytest.mark.parametrize("bound", ["REQUESTS_PER_SENDER", "REQUESTS"])
async def test_a_request_too_many_is_counted(
    monkeypatch: pytest.MonkeyPatch, bound: str
) -> None:
    """Whichever bound it meets, and only from there on."""
    monkeypatch.setattr(f"esair.supervisors._mediator.{bound}", 2)
    idle, user = Idle(), Idle(name="user")
    async with esair.Robot(behaviors=[idle, user]) as robot:
        waiting = [asyncio.create_task(user.get("idle", 0.1)) for _ in range(2)]
        await asyncio.sleep(0.01)
        assert robot.journal.counts()["behaviors"]["turned_away"] == 0
        for number in (1, 2):
            with pytest.raises(esair.BusyError):
                await user.get("idle")
            assert robot.journal.counts()["behaviors"]["turned_away"] == number
        await asyncio.gather(*waiting, return_exceptions=True)


@pytest.mark.parametrize("supervisor", ["behaviors", "resources"])
async def test_a_command_too_many_is_counted(
    monkeypatch: pytest.MonkeyPatch, supervisor: str
) -> None:
    """Of each supervisor by itself."""
    names = {"behaviors": "idle", "resources": "sonar"}
    async with esair.Robot(
        resources=[FakeSensor("sonar", 1.0)], behaviors=[Idle()]
    ) as robot:
        monkeypatch.setattr("esair.supervisors._command_queue.LIMIT", 0)
        for number in (1, 2):
            with pytest.raises(esair.BusyError):
                await getattr(robot, supervisor).restart(names[supervisor])
            counts = robot.journal.counts()
            told = {name: counts[name]["turned_away"] for name in names}
            assert told == dict.fromkeys(names, 0) | {supervisor: number}
