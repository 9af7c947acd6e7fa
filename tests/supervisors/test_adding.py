"""What a supervisor adds, one command after another, and what it refuses."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from tests.supervisors.actors import (
    Driver,
    Idle,
    Scripted,
    State,
    Ticker,
    for_ever,
    raises,
    registered,
    seeds,
    wheels,
)

import esair
from esair.testing import FakeSensor
from esair.values import check_name

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("SUP-1")
async def test_the_phases_of_a_supervisor() -> None:
    """INITIALIZING, then waiting and handling in turn, and STOPPED at the end."""
    seen = []
    robot = esair.Robot(behaviors=[Idle()])

    async def note(_behavior: object) -> None:
        seen.append(robot.behaviors.phase)

    seen.append(robot.behaviors.phase)
    async with robot:
        seen.append(robot.behaviors.phase)
        await robot.behaviors.add(Scripted(for_ever, setup=note))
        seen.append(robot.behaviors.phase)
    seen.append(robot.behaviors.phase)

    phase = esair.SupervisorPhase
    assert seen == [
        phase.INITIALIZING,
        phase.WAIT_REQUEST,
        phase.HANDLING_REQUEST,
        phase.WAIT_REQUEST,
        phase.STOPPED,
    ]


@pytest.mark.promise("SUP-1")
@pytest.mark.fault("L08")
@pytest.mark.parametrize("seed", seeds)
async def test_commands_at_the_same_time_are_all_done(seed: int) -> None:
    """Twenty adds and removes given at once are handled one after the other."""
    async with esair.Robot() as robot:
        await asyncio.gather(
            *(robot.behaviors.add(Idle(name=f"b{n}")) for n in range(20))
        )
        await asyncio.gather(
            *(robot.behaviors.remove(f"b{n}") for n in range(0, 20, 2))
        )

        assert sorted(robot.behaviors.names()) == sorted(
            f"b{n}" for n in range(1, 20, 2)
        )


@pytest.mark.promise("SUP-2")
@pytest.mark.fault("L09")
async def test_insertions_and_removals_disturb_nobody() -> None:
    """A thousand swaps in a second, and no untouched behavior misses a period."""
    ticker = Ticker()
    async with esair.Robot(resources=[wheels()], behaviors=[ticker]) as robot:
        for number in range(250):
            await robot.behaviors.add(Idle(name="guest"))
            await robot.behaviors.replace("guest", Driver(name="guest"))
            await asyncio.sleep(0.004)
            await robot.behaviors.remove("guest")
            await robot.resources.add(FakeSensor(f"s{number}", 1.0))
            await robot.resources.remove(f"s{number}")
        await asyncio.sleep(0.1)

    assert len(ticker.ticks) > 100
    assert ticker.missed() == 0


@pytest.mark.fault("L01")
async def test_a_taken_name_is_refused_and_nothing_is_started() -> None:
    """The one that is there goes on."""
    first, second = Ticker(name="a"), Ticker(name="a")
    async with esair.Robot(behaviors=[first]) as robot:
        with pytest.raises(esair.NameTakenError, match="replace"):
            await robot.behaviors.add(second)
        await asyncio.sleep(0.1)

    assert first.ticks
    assert not second.ticks


@pytest.mark.fault("L02")
@pytest.mark.parametrize("name", ["", "A", "ä", "1a", "a-b", "a b", "a" * 64, "a\n", 3])
async def test_names_follow_the_grammar(name: Any) -> None:
    """What could be mistaken for another name is refused."""
    with pytest.raises(esair.ConfigError, match="name"):
        check_name("behavior", name)
    with pytest.raises(esair.ConfigError, match="name"):
        Idle(name=name)


@pytest.mark.fault("B01", "L06")
@pytest.mark.parametrize("step", range(4))
async def test_a_failed_setup_leaves_nothing_behind(step: int) -> None:
    """Whatever it had done by then is undone, and the name is free again."""
    sensor = FakeSensor("sonar", 1.0)

    class Some(esair.Behavior):
        wheels = esair.writes(float)

        async def setup(self) -> None:
            steps: list[Callable[[], Awaitable[Any]]] = [
                lambda: asyncio.sleep(0.1),
                lambda: self.wheels.write(1.0),
                lambda: self.register("sonar", esair.Access.READ),
            ]
            for each in steps[:step]:
                await each()
            raise RuntimeError(f"after {step}")

    device = wheels()
    async with esair.Robot(resources=[sensor, device]) as robot:
        with pytest.raises(esair.BehaviorFailedError, match=f"after {step}") as caught:
            await robot.behaviors.add(Some())

        assert isinstance(caught.value.__cause__, RuntimeError)
        assert device.commands[-1] == 0.0
        assert registered(robot) == {}
        assert robot.behaviors.names() == []
        await robot.behaviors.add(Idle(name="some"))


async def test_what_is_declared_wrongly_is_refused_by_add() -> None:
    """Each mistake is named, several at once."""

    class Wrong(esair.Behavior):
        inbox_size = 0
        outbox_policy: Any = "never"

    class Lost(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.reads(float)

    async with esair.Robot(resources=[wheels()]) as robot:
        with pytest.raises(ExceptionGroup) as group:
            await robot.behaviors.add(Wrong())
        assert {getattr(error, "field", "") for error in group.value.exceptions} == {
            "inbox_size",
            "outbox_policy",
        }
        with pytest.raises(ExceptionGroup) as group:
            await robot.behaviors.add(Lost())
        assert [type(error) for error in group.value.exceptions] == [
            esair.UnknownNameError,
            esair.ConfigError,
        ]
        with pytest.raises(esair.ConfigError, match=r"expected an esair\.Behavior"):
            await robot.behaviors.add(object())  # type: ignore[arg-type]
        assert robot.behaviors.names() == []


@pytest.mark.fault("X01", "X03")
@pytest.mark.parametrize("cancels", [1, 2])
async def test_a_cancelled_add_is_undone(cancels: int) -> None:
    """Nothing is left of it, also if its clean-up is cancelled too."""

    async def slow(_behavior: object) -> None:
        await asyncio.sleep(0.5)

    behavior = Scripted(for_ever, setup=for_ever, teardown=slow, name="slow")
    async with esair.Robot() as robot:
        adding = asyncio.ensure_future(robot.behaviors.add(behavior))
        for _ in range(cancels):
            await asyncio.sleep(0.1)
            adding.cancel()
        await asyncio.wait({adding})
        assert adding.cancelled()
        await robot.behaviors.add(Idle(name="slow"))
        assert robot.behaviors.query("slow").state is State.RUNNING


async def test_two_who_want_exclusive_use_do_not_start() -> None:
    """That one of them can never move is known before anything is opened."""
    device = wheels()
    policy = esair.Policy("wheels", allow={"*": esair.Access.WRITE}, exclusive=True)
    robot = esair.Robot(
        resources=[device],
        behaviors=[Driver(name="first"), Driver(name="second")],
        policies=[policy],
    )
    with pytest.raises(ExceptionGroup) as caught:
        await robot.__aenter__()

    (error,) = caught.value.exceptions
    assert isinstance(error, esair.AccessDeniedError)
    assert (error.behavior, device.opened) == ("second", 0)


async def test_a_class_whose_name_is_no_name_is_refused() -> None:
    """The error says what a name must look like."""

    class Größe(Idle):
        pass

    async with esair.Robot() as robot:
        with pytest.raises(esair.ConfigError, match="lower-case"):
            await robot.behaviors.add(Größe())


@pytest.mark.parametrize("said", ["not good!", "", "x" * 64, "Drive", 7])
async def test_a_name_that_a_class_has_as_an_attribute_is_checked_too(
    said: Any,
) -> None:
    """It does not come by the constructor."""
    named = type("Named", (Idle,), {"name": said})
    with pytest.raises(ExceptionGroup) as caught:
        await esair.Robot(behaviors=[named()]).__aenter__()
    assert "name: expected a lower-case" in str(caught.value.exceptions[0])
    async with esair.Robot() as robot:
        with pytest.raises(esair.ConfigError, match="name: expected a lower-case"):
            await robot.behaviors.add(named())
        assert robot.behaviors.names() == []


async def test_whatever_error_a_setup_raises_is_named_as_its_failure() -> None:
    """Also one of esair's own."""
    bad = Scripted(for_ever, setup=raises(esair.DeviceLostError("x")), name="a")
    async with esair.Robot() as robot:
        with pytest.raises(esair.BehaviorFailedError) as caught:
            await robot.behaviors.add(bad)
        assert isinstance(caught.value.__cause__, esair.DeviceLostError)


async def test_what_has_no_good_name_is_named_by_what_it_is() -> None:
    """An object that is no component, or one with a bad name, in the error of its add."""
    bad = type(
        "Odd", (Idle,), {"name": "Not Good", "__repr__": lambda _: "<an odd one>"}
    )
    async with esair.Robot() as robot:
        for odd, told in ((bad(), "lower-case"), (7, "7")):
            with pytest.raises(esair.EsairError, match=told):
                await robot.behaviors.add(odd)  # type: ignore[arg-type]
