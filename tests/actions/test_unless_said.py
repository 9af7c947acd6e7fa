"""What holds of an action unless it says otherwise, and what it is told of each mistake."""

from __future__ import annotations

import asyncio
import gc
import logging
import math
from collections.abc import Callable
from typing import Any

import attrs
import pytest

import esair
from esair.actions import Guards, Reads, Takes, Writes
from esair.connections import Sight
from esair.journal import Kind
from esair.testing import FakeActuator, FakeSensor, VirtualLoop

pytestmark = pytest.mark.virtual_clock


@attrs.frozen
class Dock(esair.Request[int]):
    bay: int = 0


class Idle(esair.Behavior):
    """Tests act in its name."""


# Ports.


def test_a_port_says_the_same_however_it_is_declared() -> None:
    """What is left out by ``esair.reads`` is what its class has."""
    assert esair.reads(float) == Reads(float)
    assert esair.writes(float) == Writes(float)
    assert esair.guards(float) == Guards(float)
    assert esair.takes(Dock) == Takes(Dock)


async def test_who_registers_later_writes_without_priority() -> None:
    """As one that declares it: 0."""
    wheels, user = FakeActuator("wheels", safe=0.0), Idle()
    everybody = esair.Policy("wheels", allow={"*": esair.Access.WRITE})
    async with esair.Robot(
        resources=[wheels], behaviors=[user], policies=[everybody]
    ) as robot:
        port = await user.register("wheels", esair.Access.WRITE)
        await port.write(1.0)
        assert robot.resources.why("wheels").priority == 0


# Bounds, and times.


@pytest.mark.promise("BS-7")
async def test_sixteen_may_wait() -> None:
    """Data in an inbox and in an outbox, and requests; one more is refused."""

    class Busy(esair.Behavior):
        docks = esair.takes(Dock)

        async def run(self) -> None:
            await asyncio.Event().wait()

    user, busy = Idle(name="user"), Busy(name="busy")
    async with esair.Robot(behaviors=[user, busy]):
        for n in range(16):
            await user.put("busy", n)
            user.offer(n)
        with pytest.raises(esair.BusyError):
            user.offer(16)
        with pytest.raises(esair.BehaviorUnavailableError):
            await user.put("busy", 16)
        asked = [asyncio.ensure_future(user.ask("busy", Dock(n))) for n in range(17)]
        await asyncio.sleep(0.1)
        assert [each.done() for each in asked] == [False] * 16 + [True]
        with pytest.raises(esair.BusyError):
            await asked.pop()
        for each in asked:
            each.cancel()


@pytest.mark.promise("BS-2", "BS-3", "BS-10")
@pytest.mark.parametrize(
    ("call", "seconds"),
    [
        (lambda user: user.put("full", 1), 1.0),
        (lambda user: user.get("full"), 1.0),
        (lambda user: user.ask("full", Dock()), 10.0),
    ],
)
async def test_who_does_not_say_how_long_waits_so_long(
    call: Callable[[Any], Any], seconds: float
) -> None:
    """A put and a get ask for a second, a request has ten for its answer."""

    class Full(esair.Behavior):
        docks = esair.takes(Dock)
        inbox_size = 1

        async def run(self) -> None:
            await asyncio.Event().wait()

    user = Idle(name="user")
    async with esair.Robot(behaviors=[user, Full()]):
        await user.put("full", 0)
        began = esair.now()
        with pytest.raises(esair.BehaviorUnavailableError):
            await call(user)
        assert esair.now() - began == pytest.approx(seconds, abs=1e-3)


# What an action does while nothing is wrong.


@pytest.mark.promise("TOR-1")
def test_what_an_action_owes() -> None:
    """Something every four seconds, unless it says how long it rests, or that it owes
    nothing."""
    assert esair.works("wheels").within == 4.0
    assert esair.works("wheels", within=1).within == 1.0
    assert esair.works(idle=True).within is None
    assert esair.works("wheels", within=0.0, idle=True).partners == ("wheels",)
    for wrong in (0.0, math.nan):
        with pytest.raises(esair.ConfigError, match="within: expected seconds > 0"):
            esair.works("wheels", within=wrong)
    with pytest.raises(esair.ConfigError, match="lower-case"):
        esair.works("Wheels")


# Classes of users.


class Listed:
    """What a user has beside: it looks at each class that is derived from it."""

    found: dict[str, str] = {}  # noqa: RUF012 - one list for all

    def __init_subclass__(cls, *, listed: str = "", **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if listed:
            Listed.found[listed] = cls.__name__


@pytest.mark.parametrize(
    "base",
    [
        *(esair.Behavior, esair.Reaction, esair.Sensor, esair.Actuator),
        *(esair.Derived, esair.Request),
    ],
)
def test_a_class_may_have_another_base_that_looks_at_it(base: Any) -> None:
    """Keywords of the class are for that one."""
    Listed.found.clear()
    type("Mine", (base, Listed), {}, listed="here")
    assert Listed.found == {"here": "Mine"}


class Sum(esair.Reaction):
    front = esair.reads(float)
    rear = esair.reads(float)
    wheels = esair.writes(float)


class InOrder(Sum):
    def react(self, front: float, rear: float) -> float:
        return front - rear


class Swapped(Sum):
    def react(self, rear: float, front: float) -> float:
        return front - rear


class ByName(Sum):
    def react(self, *, front: float, rear: float) -> float:
        return front - rear


class Any_(Sum):  # noqa: N801 - as its parameters
    def react(self, **readings: float) -> float:
        return readings["front"] - readings["rear"]


class HalfByName(Sum):
    def react(self, rear: float, **readings: float) -> float:
        return readings["front"] - rear


@pytest.mark.promise("REA-1")
@pytest.mark.parametrize("kind", [InOrder, Swapped, ByName, Any_, HalfByName])
async def test_readings_come_by_the_names_of_their_ports(kind: type[Sum]) -> None:
    """However ``react`` takes them."""
    front, rear = FakeSensor("front", 3.0), FakeSensor("rear", 1.0)
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[front, rear, wheels], behaviors=[kind()]):
        await wheels.until(2.0)


# Steps of a behavior.


@pytest.mark.promise("BEH-3")
@pytest.mark.parametrize("terms", [{"until": lambda: True}, {"blind_timeout": 1.0}])
async def test_a_behavior_is_performed_for_a_time_alone(terms: Any) -> None:
    """It has no readings that could end it, or lack."""
    user = Idle(name="user")
    async with esair.Robot(behaviors=[user]):
        with pytest.raises(esair.BadValueError, match="of reactions"):
            await user.perform(Idle(name="step"), **terms)


@pytest.mark.promise("BEH-3")
@pytest.mark.parametrize(
    "until",
    [
        lambda: True,
        lambda front, rear: front > rear,
        lambda rear, factor=2.0: rear * factor < 3.0,
        lambda *_, front: front == 3.0,
    ],
)
async def test_a_condition_gets_the_readings_that_it_names(until: Any) -> None:
    """None, some, all; what has a default of its own keeps that."""
    front, rear = FakeSensor("front", 3.0), FakeSensor("rear", 1.0)
    wheels = FakeActuator("wheels", safe=0.0)
    user = Idle(
        name="user",
        reads={n: esair.reads(float, name=n) for n in ("front", "rear")},
        writes={"wheels": esair.writes(float)},
    )
    async with esair.Robot(resources=[front, rear, wheels], behaviors=[user]):
        assert await user.perform(InOrder(), until=until, timeout=1.0)


@pytest.mark.promise("BEH-3")
async def test_a_condition_that_names_no_reading_is_told_what_there_is() -> None:
    """By the names of the ports."""
    user = Idle(
        name="user",
        reads={n: esair.reads(float, name=n) for n in ("front", "rear")},
        writes={"wheels": esair.writes(float)},
    )
    front, rear = FakeSensor("front", 3.0), FakeSensor("rear", 1.0)
    wheels = FakeActuator("wheels", safe=0.0)
    told = r"readings \(front, rear\), not left, right"
    async with esair.Robot(resources=[front, rear, wheels], behaviors=[user]):
        with pytest.raises(esair.BadValueError, match=told):
            await user.perform(InOrder(), until=lambda left, front, right: True)


# What is counted, and told now and then.


class Copy(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


@pytest.mark.promise("REA-3")
async def test_each_reading_that_a_newer_one_replaced_is_counted() -> None:
    """Three in one turn are one step; not one that came before the first step."""
    sonar, wheels = FakeSensor[float]("sonar"), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Copy()]) as robot:
        for count in (1, 3, 2):
            for value in range(count):
                sonar.feed(float(value))
            await asyncio.sleep(0.01)
        counts = robot.journal.counts()["copy"]
        assert (counts["steps"], counts["skipped"]) == (3, 3)


@pytest.mark.promise("AC-2")
async def test_each_command_that_is_refused_is_counted() -> None:
    """By whom a higher priority holds the actuator."""
    sonar, wheels = FakeSensor[float]("sonar"), FakeActuator("wheels", safe=0.0)
    high: Any = Idle(name="high", writes={"wheels": esair.writes(float, priority=5)})
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Copy(), high]
    ) as robot:
        assert await high.wheels.write(1.0, hold=1.0)
        for value in (2.0, 3.0, 4.0):
            sonar.feed(value)
            await asyncio.sleep(0.01)
        assert robot.journal.counts()["copy"]["refused"] == 3
        assert wheels.commands == [0.0, 1.0]


@pytest.mark.fault("V01")
async def test_bad_commands_are_told_at_each_thousandth(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """So that one that never ends is seen, and the log is not filled."""

    class Bad(esair.Reaction):
        rate = 1000.0
        wheels = esair.writes(float)

        def react(self) -> float:
            return math.nan

    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Bad()]) as robot:
        await asyncio.sleep(2.0)
        counts = robot.journal.counts()["bad"]
        assert counts["rejected"] == counts["steps"]

    lines = [r for r in caplog.records if "rejected" in r.getMessage()]
    assert [r.args[1] for r in lines if r.args][:3] == [1, 1000, 2000]  # type: ignore[index]
    assert {r.levelno for r in lines} == {logging.WARNING}


@pytest.mark.fault("B09")
async def test_slow_steps_are_told_at_each_thousandth(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """As bad commands are; just the budget is no overrun."""

    class Slow(esair.Reaction):
        rate = 100.0
        budget = 0.002

        def react(self) -> None:
            loop = asyncio.get_running_loop()
            assert isinstance(loop, VirtualLoop)
            loop.advance(0.003)

    async with esair.Robot(behaviors=[Slow()]) as robot:
        await asyncio.sleep(10.5)
        assert robot.journal.counts()["slow"]["overruns"] >= 1000

    lines = [r for r in caplog.records if "overrun" in r.getMessage()]
    assert [r.args[1] for r in lines if r.args] == [1, 1000]  # type: ignore[index]


# What is decided in one turn, and what is left of it.


class Each(esair.Reaction):
    sonar = esair.reads(float, every=True)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


@pytest.mark.promise("REA-3")
async def test_two_decisions_in_one_turn_are_one_command() -> None:
    """The newer one is sent, once, and its actuator is held."""
    sonar, wheels = FakeSensor[float]("sonar"), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Each()]) as robot:
        sonar.feed(1.0)
        sonar.feed(2.0)
        await asyncio.sleep(0.001)
        assert wheels.commands == [0.0, 2.0]
        assert robot.resources.why("wheels").holder == "each"
        assert robot.journal.counts()["each"]["refused"] == 0


async def test_a_write_that_waited_for_its_driver_leaves_nothing_behind() -> None:
    """Else a robot would have one task more for each of them."""

    class Slow(FakeActuator[float]):
        async def write(self, command: float) -> None:
            await asyncio.sleep(0.002)
            await super().write(command)

    sonar, wheels = FakeSensor[float]("sonar"), Slow("wheels", safe=0.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Copy()]) as robot:
        for value in range(1, 60):
            sonar.feed(float(value))
            await asyncio.sleep(0.005)
        assert len(wheels.commands) == 60
        counts = robot.journal.counts()["copy"]
        assert (counts["refused"], counts["conflated"]) == (0, 0)
        done = [
            each
            for each in gc.get_objects()
            if isinstance(each, asyncio.Task) and each.done()
        ]
        assert len(done) < 30


async def test_a_step_that_has_ended_has_no_say_any_more() -> None:
    """However often one is performed, nothing of it is looked at later."""
    sonar, wheels = FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)
    user = Idle(
        name="user",
        reads={"sonar": esair.reads(float)},
        writes={"wheels": esair.writes(float)},
    )

    def sights() -> int:
        return sum(type(each) is Sight for each in gc.get_objects())

    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]):
        await user.perform(Copy(), until=lambda: True)
        gc.collect()
        before = sights()
        for _ in range(5):
            await user.perform(Copy(), until=lambda: True)
        gc.collect()
        assert sights() == before


# Requests.


class Docking(esair.Behavior):
    orders = esair.takes(Dock)

    async def run(self) -> None:
        async for request in self.orders:
            async with request as mine:
                mine.answer(mine.bay)


class PlainDocking(esair.ThreadBehavior):
    orders = esair.takes(Dock)

    def run(self) -> None:
        for request in self.orders:
            with request as mine:
                mine.answer(mine.bay)


@pytest.mark.promise("BS-8")
@pytest.mark.parametrize("kind", [Docking, PlainDocking])
async def test_the_block_of_a_request_is_entered_with_it(kind: Any) -> None:
    """So it may have another name there."""
    user = Idle(name="user")
    async with esair.Robot(behaviors=[user, kind(name="docking")]):
        assert await user.ask("docking", Dock(3)) == 3


# Why it is parked, and what that keeps.


@pytest.mark.promise("REA-2", "PRO-1")
async def test_one_that_fails_at_its_first_decision_has_seen_nothing() -> None:
    """What it keeps safe while it is blind it keeps on."""

    class Wrong(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=5)
        left = esair.writes(float, priority=5)

        def react(self, sonar: float) -> dict[str, float]:
            return {"wheels": 1.0, "right": 1.0}

    wheels, left = FakeActuator("wheels", safe=0.0), FakeActuator("left", safe=0.0)
    low: Any = Idle(name="low", writes={"wheels": esair.writes(float)})
    async with esair.Robot(
        resources=[FakeSensor("sonar", 1.0), wheels, left], behaviors=[Wrong(), low]
    ) as robot:
        for _ in range(5):
            assert not await low.wheels.write(1.0)
            await asyncio.sleep(0.01)
        assert robot.resources.why("wheels").holder == "wrong"
        assert wheels.commands == [0.0]


@pytest.mark.promise("REA-3")
@pytest.mark.parametrize(
    ("what", "detail"),
    [
        ("nothing yet", "no reading of sonar yet"),
        ("removed", "sonar was removed"),
        ("lost", "sonar lost"),
        ("lost with a word", "sonar lost: OSError: the cable"),
        ("silent", "sonar is older than 0.5 s"),
    ],
)
async def test_who_is_parked_says_why_in_short(what: str, detail: str) -> None:
    """By the port, without the words that its state says already."""
    sonar = FakeSensor[float]("sonar")
    wheels = FakeActuator("wheels", safe=0.0)
    copy = Copy(reads={"sonar": esair.reads(float, max_age=0.5)})
    told: list[str] = []
    async with esair.Robot(resources=[sonar, wheels], behaviors=[copy]) as robot:
        robot.journal.listen(lambda e: told.append(e.text), kinds=[Kind.PARKED])
        if what != "nothing yet":
            sonar.feed(1.0)
            await wheels.until(1.0)
        if what == "removed":
            await robot.resources.remove("sonar")
        if what == "lost":
            sonar.report_lost(esair.DeviceLostError("sonar"))
        if what == "lost with a word":
            sonar.report_lost(OSError("the cable"))
        await asyncio.sleep(0.6 if what == "silent" else 0.001)
        status = robot.behaviors.query("copy")
        assert status.state is esair.BehaviorState.PARKED
        assert status.detail == detail
        assert all(each.startswith("sonar ") for each in told)
        assert ("sonar removed" in told) == (what == "removed")


# Random numbers.


def drawn(more: int) -> dict[str, list[float]]:
    """Return what each function of a robot draws, while another draws some more."""
    found: dict[str, list[float]] = {}

    def draw(who: str) -> None:
        found.setdefault(who, []).append(esair.random.random())

    class Twice(esair.Derived[float]):
        sonar = esair.reads(float)

        def compute(self, sonar: float) -> float:
            draw("computed")
            return sonar

    class Guard(esair.Reaction):
        wheels = esair.guards(float)

        def react(self, wheels: float) -> float:
            draw("guard")
            return wheels

    class Sonar(esair.Sensor[float]):
        blocking = False

        def read(self) -> float:
            for _ in range(more):
                esair.random.random()
            return 1.0

    class Wander(esair.Behavior):
        twice = esair.reads(float)
        wheels = esair.writes(float)

        async def run(self) -> None:
            for _ in range(3):
                await self.wheels.write(await self.twice.read(fresh=True))
                draw("run")

                def until(twice: float) -> bool:
                    draw("until")
                    return True

                await self.perform(Follow(), until=until)

    class Follow(esair.Reaction):
        twice = esair.reads(float)

        def react(self, twice: float) -> None:
            draw("react")

    async def live() -> None:
        wheels = FakeActuator("wheels", safe=0.0)
        async with esair.Robot(
            resources=[Sonar(name="sonar"), Twice(name="twice"), wheels],
            behaviors=[Wander(), Guard()],
            seed=7,
        ) as robot:
            await robot.ended()

    loop = VirtualLoop()
    try:
        loop.run_until_complete(live())
    finally:
        loop.close()
    return found


@pytest.mark.promise("BEH-5")
def test_each_function_draws_from_the_stream_of_its_component() -> None:
    """What is computed, guards, or ends a step too; a driver disturbs none of them."""
    once = drawn(0)
    assert set(once) == {"computed", "guard", "run", "until", "react"}
    assert drawn(5) == once
