"""The table of rights: what it tells, whom it refuses, and who holds what since when."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair.connections import Registrations, Terms
from esair.exceptions import NotRegisteredError
from esair.journal import Event, Kind

pytestmark = pytest.mark.virtual_clock

READ, WRITE = esair.Access.READ, esair.Access.WRITE


def writer(name: str, **options: Any) -> Any:
    return esair.Behavior(name=name, writes={"wheels": esair.writes(float, **options)})


@pytest.mark.promise("TURN-5")
async def test_rights_that_come_and_go_are_told() -> None:
    """Who, for what, and which; each once, also if it is revoked twice."""
    registrations, heard = Registrations(), list[Event]()
    registrations.journal.start(asyncio.get_running_loop())
    listener = registrations.journal.listen(heard.append)

    registration = registrations.issue(Terms("drive", "wheels", WRITE))
    assert registrations.revoke(registration)
    assert not registrations.revoke(registration)
    await asyncio.sleep(0.01)
    listener.stop()

    assert [(e.kind, e.component, e.peer, e.value) for e in heard] == [
        (Kind.REGISTERED, "drive", "wheels", WRITE),
        (Kind.REVOKED, "drive", "wheels", WRITE),
    ]


@pytest.mark.promise("RS-3")
def test_nothing_is_kept_of_rights_that_are_over() -> None:
    """Neither by their number nor by their resource; those that are valid stay."""
    registrations = Registrations()
    first, second = (
        registrations.issue(Terms(name, "wheels", WRITE)) for name in ("a", "b")
    )
    registrations.revoke(first)
    assert registrations.of_resource("wheels") == [second] == list(registrations)
    registrations.revoke(second)
    assert not registrations.live
    assert not registrations._of_resource


@pytest.mark.promise("RS-3")
def test_there_are_as_many_rights_as_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """One more is refused, until one of them is over."""
    monkeypatch.setattr("esair.connections._gate.LIMIT", 2)
    registrations, terms = Registrations(), Terms("drive", "wheels", WRITE)
    first = registrations.issue(terms)
    registrations.issue(terms)
    with pytest.raises(esair.BusyError, match="number of registrations"):
        registrations.issue(terms)
    registrations.revoke(first)
    registrations.issue(terms)


@pytest.mark.promise("RS-3")
@pytest.mark.parametrize(
    "other",
    [
        ("spin", "wheels", WRITE, 1, 2.0),
        ("drive", "arm", WRITE, 1, 2.0),
        ("drive", "wheels", READ, 1, 2.0),
        ("drive", "wheels", WRITE, 0, 2.0),
        ("drive", "wheels", WRITE, 1, None),
    ],
)
async def test_a_right_is_found_by_exactly_its_terms(other: Any) -> None:
    """One that differs in one of them is another right."""
    registrations = Registrations()
    mine = registrations.issue(Terms("drive", "wheels", WRITE, 1, 2.0))

    assert registrations.find(Terms("drive", "wheels", WRITE, 1, 2.0)) is mine
    assert registrations.find(Terms(*other)) is None
    registrations.revoke(mine)
    assert registrations.find(Terms("drive", "wheels", WRITE, 1, 2.0)) is None


@pytest.mark.promise("RS-3")
@pytest.mark.fault("R02")
async def test_a_right_is_valid_in_its_own_table_only() -> None:
    """A copy, one of another robot and one that was revoked are refused; numbers grow."""
    registrations, others = Registrations(), Registrations()
    mine = registrations.issue(Terms("drive", "wheels", WRITE))
    foreign = others.issue(Terms("drive", "wheels", WRITE))
    registrations.check(mine)

    for wrong in (foreign, object(), "drive"):
        with pytest.raises(NotRegisteredError):
            registrations.check(wrong)  # type: ignore[arg-type]
    registrations.revoke(mine)
    with pytest.raises(NotRegisteredError, match="was revoked"):
        registrations.check(mine)
    assert registrations.issue(Terms("drive", "wheels", WRITE)).number > mine.number


@pytest.mark.promise("RS-3")
async def test_a_right_to_configure_is_none_for_data() -> None:
    """The refusal says what it is for."""
    registrations = Registrations()
    only = registrations.issue(Terms("drive", "wheels", esair.Access.CONFIGURE))

    with pytest.raises(NotRegisteredError, match="only"):
        registrations.check(only)


@pytest.mark.promise("AC-2")
async def test_equal_priorities_do_not_take_from_each_other(fake_actuator: Any) -> None:
    """Nobody has said one: the first keeps what it holds, and both are equal."""
    wheels = fake_actuator("wheels", safe=0.0)
    first, second = writer("first"), writer("second")
    async with esair.Robot(resources=[wheels], behaviors=[first, second]):
        assert first.wheels.registration.priority == 0
        assert await first.wheels.write(1.0)
        refused = await second.wheels.write(2.0)
        assert (refused.holder, refused.priority) == ("first", 0)
        assert wheels.commands == [0.0, 1.0]


@pytest.mark.promise("AC-2")
async def test_a_hold_begins_once_however_often_it_is_renewed(
    fake_actuator: Any,
) -> None:
    """``since`` is when it began; after it has run out another one begins."""
    wheels = fake_actuator("wheels", safe=0.0)
    drive = writer("drive", hold=0.5)
    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        began = loop.time()
        for _ in range(4):
            await drive.wheels.write(1.0)
            assert robot.resources.why("wheels").since == began
            await asyncio.sleep(0.1)
        await asyncio.sleep(1.0)
        again = loop.time()
        await drive.wheels.write(1.0)
        assert robot.resources.why("wheels").since == again


@pytest.mark.promise("AC-2", "AC-4")
async def test_each_write_renews_the_command_timeout(fake_actuator: Any) -> None:
    """It counts from the last write, that of a slow device from its answer."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=0.2)
    drive = writer("drive")
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        for _ in range(10):
            await drive.wheels.write(1.0)
            await asyncio.sleep(0.15)
        assert 0.0 not in wheels.commands[1:]
        wheels.slow(0.15)
        await drive.wheels.write(2.0)
        await asyncio.sleep(0.15)
        assert wheels.commands[-1] == 2.0
        await asyncio.sleep(0.3)
        assert wheels.commands[-1] == 0.0
        assert robot.journal.counts()["wheels"]["timeouts"] == 1


@pytest.mark.promise("AC-2")
async def test_a_write_that_waited_and_was_cancelled_is_not_sent(
    fake_actuator: Any,
) -> None:
    """It leaves the queue at once, and makes room there."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    drive = writer("drive")
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        wheels.slow(0.1)
        going = asyncio.create_task(drive.wheels.write(1.0))
        await asyncio.sleep(0.01)
        waits = asyncio.create_task(drive.wheels.write(2.0))
        await asyncio.sleep(0.01)
        waits.cancel()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        waiting = robot.actuators.channels["wheels"]._waiting
        assert not waiting._writes
        assert await going
        await asyncio.sleep(0.5)
        assert wheels.commands == [0.0, 1.0]


@pytest.mark.promise("TURN-3", "TURN-5")
async def test_who_loses_a_turn_is_told_with_what_it_wanted(fake_actuator: Any) -> None:
    """Both decided in one turn: the journal has its command, and who won."""

    def decide(name: str, value: float, priority: int) -> Any:
        class Decide(esair.Reaction):
            sonar = esair.reads(float)
            wheels = esair.writes(float, priority=priority)

            def react(self, sonar: float) -> float:
                return value

        return Decide(name=name)

    from esair.testing import FakeSensor

    sonar: FakeSensor[float] = FakeSensor("sonar", type=float)
    wheels, heard = fake_actuator("wheels", safe=0.0), list[Event]()
    async with esair.Robot(
        resources=[sonar, wheels],
        behaviors=[decide("low", 1.0, 0), decide("high", 2.0, 5)],
    ) as robot:
        listener = robot.journal.listen(heard.append)
        sonar.feed(1.0)
        await asyncio.sleep(0.05)
        listener.stop()

        assert wheels.commands == [0.0, 2.0]
        wanted = {e.peer: e.value for e in heard if e.kind is Kind.COMMAND}
        refused = [e for e in heard if e.kind is Kind.REFUSED]
        assert wanted == {"low": 1.0, "high": 2.0}
        assert [(e.peer, e.value.holder, e.value.priority) for e in refused] == [
            ("low", "high", 5)
        ]
        assert robot.journal.counts()["wheels"]["refusals"] == 1
