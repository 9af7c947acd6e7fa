"""What a behavior declares, how it runs, and the reactions it performs."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

import esair
from esair.journal import Event, Kind
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock
seeds = [pytest.param(n, marks=pytest.mark.virtual_clock(seed=n)) for n in range(4)]


class Idle(esair.Behavior):
    """Does nothing: tests act in its name."""


class Follow(esair.Reaction):
    """Writes what it reads."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


def devices() -> tuple[FakeSensor[float], FakeActuator[float]]:
    return FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)


# BEH-1


@pytest.mark.promise("BEH-1")
async def test_what_is_declared_is_registered_before_setup() -> None:
    """Ports are ready in setup, under the names of the class attributes."""
    read: list[float] = []

    class Reads(esair.Behavior):
        eyes = esair.reads(float, name="sonar")

        async def setup(self) -> None:
            read.append(await self.eyes.read())

    sonar, wheels = devices()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Reads()]):
        assert read == [1.0]


@pytest.mark.promise("BEH-1")
async def test_more_can_be_registered_later() -> None:
    """On the same terms it is the same registration; its right ends with it."""
    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]) as robot:
        port = await idle.register("sonar", esair.Access.READ, max_age=0.5)
        again = await idle.register("sonar", esair.Access.READ)

        assert await port.read() == 1.0
        assert port.max_age == 0.5
        assert port.registration is again.registration
        await robot.behaviors.remove("idle")
        with pytest.raises(esair.BehaviorRemovedError):
            await port.read()


@pytest.mark.promise("BEH-1", "SUP-5")
async def test_registering_again_after_a_removal_gives_a_new_right() -> None:
    """A void registration is never handed out again."""
    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]) as robot:
        old = await idle.register("sonar", esair.Access.READ)
        await robot.resources.remove("sonar")
        with pytest.raises(esair.UnknownNameError):
            await idle.register("sonar", esair.Access.READ)
        await robot.resources.add(FakeSensor("sonar", 2.0))
        new = await idle.register("sonar", esair.Access.READ)
        assert await new.read() == 2.0
        with pytest.raises(esair.ResourceRemovedError):
            await old.read()


@pytest.mark.promise("BEH-1")
async def test_what_was_not_declared_and_no_policy_allows_is_denied() -> None:
    """Reading is open; writing needs a declaration or a policy."""
    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]):
        with pytest.raises(esair.AccessDeniedError, match=r"idle.*WRITE.*wheels"):
            await idle.register("wheels", esair.Access.WRITE)
        with pytest.raises(esair.UnknownNameError):
            await idle.register("nothing", esair.Access.READ)


@pytest.mark.fault("M17")
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), "1", True])
async def test_times_must_be_numbers_of_seconds(value: Any) -> None:
    """What could disturb the clock of the loop is refused before it gets there."""
    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]) as robot:
        told: list[Event] = []
        robot.journal.listen(told.append, kinds=(Kind.REGISTERED,))
        with pytest.raises(esair.BadValueError, match="max_age"):
            await idle.register("sonar", esair.Access.READ, max_age=value)
        await asyncio.sleep(0.01)
        assert not told  # it has no right left of that
        with pytest.raises(esair.BadValueError, match="timeout"):
            await idle.perform(Follow(), timeout=value)


async def test_outside_a_robot_a_behavior_can_do_nothing() -> None:
    """Each call says that it is not in a running robot."""
    idle = Idle()
    for call in (
        idle.put("x", 1),
        idle.get("x"),
        idle.receive(),
        idle.perform(Follow()),
        idle.register("sonar", esair.Access.READ),
    ):
        with pytest.raises(esair.NotRegisteredError, match="not in a running robot"):
            await call
    with pytest.raises(esair.NotRegisteredError):
        idle.offer(1)


@pytest.mark.promise("BEH-1")
async def test_a_fenced_behavior_can_do_nothing() -> None:
    """A behavior that is being removed is told so by every call."""
    told: list[type[BaseException]] = []

    class Last(esair.Behavior):
        async def teardown(self) -> None:
            for call in (
                lambda: self.put("last", 1),
                lambda: self.get("last"),
                self.receive,
                lambda: self.perform(Follow()),
                lambda: self.register("sonar", esair.Access.READ),
            ):
                try:
                    await call()
                except esair.BehaviorRemovedError as error:
                    told.append(type(error))
            try:
                self.offer(1)
            except esair.BehaviorRemovedError as error:
                told.append(type(error))

    async with esair.Robot(behaviors=[Last()]) as robot:
        await robot.behaviors.remove("last")
    assert told == [esair.BehaviorRemovedError] * 6


async def test_who_waits_for_data_is_woken_by_the_removal() -> None:
    """A receive from another task ends with the behavior."""
    idle = Idle()
    async with esair.Robot(behaviors=[idle]) as robot:
        waiting = asyncio.ensure_future(idle.receive())
        await asyncio.sleep(0)
        await robot.behaviors.remove("idle")
        with pytest.raises(esair.BehaviorRemovedError):
            await waiting


async def test_a_plain_loop_of_ticks_in_the_event_loop_is_refused() -> None:
    """``for`` instead of ``async for`` would hold up everybody, for ever."""
    with pytest.raises(esair.ConfigError, match="write 'async for' in it"):
        next(iter(esair.every(60.0)))


# BEH-2


class Plain(esair.Behavior):
    """Runs on a thread, and uses everything there is."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def __init__(self) -> None:
        super().__init__(name="plain")
        self.log: list[Any] = []

    def setup(self) -> None:
        self.log.append("setup")

    def run(self: Any) -> None:
        self.log.append(threading.current_thread().name)
        self.log.append(self.sonar.read())
        self.log.append(self.sonar.reading().sequence > 0)
        self.log.append(bool(self.wheels.write(2.0)))
        self.wheels.release()
        self.log.append(len(self.sonar.history(1)))
        self.log.append(self.sonar.settings["rate"])
        self.log.append(dict(self.wheels.settings) is not None)
        self.log.append(self.register("sonar", esair.Access.READ, max_age=9.0).read())
        self.log.append(next(iter(self.sonar)))
        self.offer("offered")
        self.put("idle", "from a thread")
        self.log.append(self.receive())
        self.log.append(self.perform(Follow(), timeout=0.2))
        for _ in esair.every(0.1):
            self.log += ["tick"]

    def teardown(self) -> None:
        self.log.append("teardown")


@pytest.mark.promise("BEH-2")
async def test_a_plain_run_is_a_thread_that_waits() -> None:
    """Ports and methods block the thread, and the event loop goes on."""
    sonar, wheels = devices()
    plain, idle = Plain(), Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[plain, idle]) as robot:
        assert await idle.receive() == "from a thread"
        assert await idle.get("plain") == "offered"
        await idle.put("plain", "to a thread")
        while plain.log.count("tick") < 3:  # noqa: ASYNC110 - a thread counts
            await asyncio.sleep(0.05)
        await robot.behaviors.remove("plain")
        assert robot.behaviors.zombies == ()

    assert plain.log[:11] == [
        "setup",
        "esair-plain",
        1.0,
        True,
        True,
        1,
        10.0,
        True,
        1.0,
        1.0,
        "to a thread",
    ]
    assert plain.log[11] is False
    assert plain.log[-1] == "teardown"
    assert wheels.commands[-1] == 0.0


@pytest.mark.promise("BEH-2")
@pytest.mark.real_clock
async def test_a_blocking_behavior_does_not_block_the_loop() -> None:
    """While a thread sleeps, a task in the loop ticks on."""
    ticks: list[float] = []

    class Blocks(esair.Behavior):
        def run(self) -> None:
            time.sleep(0.1)

    class Ticks(esair.Behavior):
        async def run(self) -> None:
            async for tick in esair.every(0.01):
                ticks.append(tick)  # noqa: PERF401 - it never ends

    async with esair.Robot(behaviors=[Blocks(), Ticks()]) as robot:
        await asyncio.sleep(0.15)
        assert robot.behaviors.query("blocks").state is esair.BehaviorState.FINISHED
    assert len(ticks) >= 5


@pytest.mark.promise("BEH-2", "SUP-4")
@pytest.mark.fault("B05")
async def test_a_thread_that_raises_is_restarted_like_a_task() -> None:
    """SystemExit in a thread is a crash of the behavior."""

    class Exits(esair.Behavior):
        restart = esair.Restart(max=1)
        runs = 0

        def run(self) -> None:
            self.runs += 1
            raise SystemExit(1)

    exits = Exits()
    async with esair.Robot(behaviors=[exits]) as robot:
        await asyncio.sleep(2.0)
        assert exits.runs == 2
        assert robot.behaviors.query("exits").state is esair.BehaviorState.FAILED


@pytest.mark.promise("BEH-2")
async def test_a_blocking_call_in_the_loop_is_refused() -> None:
    """It would stop the robot for ever; the error says what to write instead."""
    told: list[BaseException] = []

    class Mixed(esair.Behavior):
        sonar = esair.reads(float)

        async def setup(self) -> None:
            try:
                self.sonar.read()  # type: ignore[unused-coroutine]
            except RuntimeError as error:
                told.append(error)

        def run(self) -> None:
            """End at once."""

    sonar, _ = devices()
    async with esair.Robot(resources=[sonar], behaviors=[Mixed()]):
        assert "plain functions" in str(told[0])


@pytest.mark.promise("BEH-2")
async def test_plain_setup_and_teardown_go_with_an_async_run() -> None:
    """They run on a thread of their own."""
    threads: list[str] = []

    class Mixed(esair.Behavior):
        def setup(self) -> None:
            threads.append(threading.current_thread().name)

        async def run(self) -> None:
            """End at once."""

        def teardown(self) -> None:
            threads.append(threading.current_thread().name)

    async with esair.Robot(behaviors=[Mixed()]):
        while len(threads) < 2:  # noqa: ASYNC110 - threads count
            await asyncio.sleep(0.01)
    assert threads == ["esair-mixed"] * 2


# BEH-3


@pytest.mark.promise("BEH-3")
@pytest.mark.parametrize(
    "until", [lambda sonar: sonar > 5.0, lambda **readings: readings["sonar"] > 5.0]
)
async def test_a_reaction_is_performed_until_its_condition(until: Any) -> None:
    """True when the condition came true; what it moved is safe afterwards."""
    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]) as robot:
        performing = asyncio.ensure_future(
            idle.perform(Follow(), until=until, timeout=60.0)
        )
        await wheels.until(1.0)
        sonar.feed(9.0)

        assert await performing is True
        await wheels.until(0.0)
        assert 9.0 not in wheels.commands
        assert len(robot._resources.registrations) == 0


@pytest.mark.promise("BEH-3")
async def test_what_has_reached_its_condition_decides_on_no_other_reading() -> None:
    """Not on those either that have come in the same moment, and wait."""
    seen: list[float] = []

    class Each(esair.Reaction):
        sonar = esair.reads(float, every=True)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float:
            seen.append(sonar)
            return sonar

    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]):
        performing = asyncio.ensure_future(
            idle.perform(Each(), until=lambda sonar: sonar == 3.0)
        )
        await wheels.until(1.0)
        for value in (2.0, 3.0, 4.0):
            sonar.feed(value)
        assert await performing is True
        assert seen[-1] == 3.0
        await asyncio.sleep(0.1)
        assert 4.0 not in wheels.commands


@pytest.mark.promise("BEH-3")
async def test_a_reaction_is_performed_for_a_limited_time() -> None:
    """False when the time is over first, and not a moment later."""
    sonar, wheels = devices()
    idle = Idle()
    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]):
        before = loop.time()
        assert await idle.perform(Follow(), timeout=0.5) is False
        assert loop.time() - before == pytest.approx(0.5)
        await wheels.until(0.0)


@pytest.mark.promise("BEH-3", "AC-2")
@pytest.mark.parametrize("mine", [0, 5])
@pytest.mark.parametrize("how", ["until", "timeout", "cancel", "it gave back"])
async def test_what_a_step_moved_is_safe_when_it_ends(mine: int, how: str) -> None:
    """Also where the behavior that performs it may write with the same priority."""

    class Performs(Idle):
        wheels = esair.writes(float, priority=mine)

    class Leg(Follow):
        def react(self, sonar: float) -> float | None:  # type: ignore[override]
            return None if how == "it gave back" and sonar > 5.0 else 0.7

    sonar, wheels = devices()
    wheels.command_timeout = 9.0
    performs = Performs(name="performs")
    async with esair.Robot(resources=[sonar, wheels], behaviors=[performs]):
        until = (lambda sonar: sonar > 5.0) if how == "until" else None
        step = asyncio.ensure_future(performs.perform(Leg(), until=until, timeout=0.3))
        await wheels.until(0.7)
        await asyncio.sleep(0.13)
        sonar.feed(9.0)
        if how == "cancel":
            step.cancel()
        await asyncio.wait({step})
        await asyncio.sleep(0.01)
        assert wheels.commands[-1] == 0.0
        # What is its own it goes on to have.
        assert await performs.wheels.write(0.2)


@pytest.mark.promise("BEH-3", "AC-2")
async def test_a_step_that_moved_nothing_makes_nothing_safe() -> None:
    """Its behavior drives beside it, by the same right."""

    class Drives(Idle):
        wheels = esair.writes(float)

        async def run(self) -> None:
            async for _ in esair.every(0.05):
                await self.wheels.write(0.4)

    class Looks(Follow):
        def react(self, sonar: float) -> float | None:  # type: ignore[override]
            return None

    sonar, wheels = devices()
    drives = Drives(name="drives")
    async with esair.Robot(resources=[sonar, wheels], behaviors=[drives]):
        await wheels.until(0.4)
        step = asyncio.ensure_future(drives.perform(Looks(), timeout=0.33))
        await asyncio.sleep(0.11)  # until it has decided it keeps them safe
        count = len(wheels.commands)
        assert await step is False
        await asyncio.sleep(0.1)
        assert set(wheels.commands[count:]) == {0.4}


@pytest.mark.promise("BEH-3")
async def test_reactions_in_sequence() -> None:
    """One after the other, with what the behavior itself has declared."""

    class Steps(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float)
        done: bool | None = None

        async def run(self) -> None:
            await self.perform(Follow(), until=lambda sonar: sonar > 1.0, timeout=9.0)
            await self.perform(Follow(), until=lambda sonar: sonar > 2.0, timeout=9.0)
            self.done = bool(await self.wheels.write(7.0))
            await asyncio.sleep(9.0)

    sonar, wheels = devices()
    steps = Steps()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[steps]):
        for value in (2.0, 3.0):
            await wheels.until(value - 1.0)
            sonar.feed(value)
        await wheels.until(7.0)
        await asyncio.sleep(0.01)
        assert steps.done


@pytest.mark.promise("BEH-3")
@pytest.mark.parametrize("seed", seeds)
async def test_the_end_of_a_behavior_ends_what_it_performs(seed: int) -> None:
    """The reaction steps no more, and its rights are gone."""
    sonar, wheels = devices()
    steps = 0

    class Counts(Follow):
        def react(self, sonar: float) -> float:
            nonlocal steps
            steps += 1
            return sonar

    class Performs(esair.Behavior):
        async def run(self) -> None:
            await self.perform(Counts())

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Performs()]) as robot:
        await wheels.until(1.0)
        await robot.behaviors.remove("performs")
        before = steps
        await asyncio.sleep(1.0)

        assert steps == before
        assert wheels.commands[-1] == 0.0
        assert len(robot._resources.registrations) == 0


@pytest.mark.promise("BEH-3")
@pytest.mark.fault("B02", "B05")
@pytest.mark.parametrize("error", [LookupError("no"), SystemExit(1)])
async def test_an_error_of_the_reaction_is_raised_by_perform(
    error: BaseException,
) -> None:
    """The behavior decides what to do about it."""

    class Bad(Follow):
        def react(self, sonar: float) -> float:
            raise error

    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]):
        with pytest.raises((LookupError, RuntimeError), match=r"no|SystemExit"):
            await idle.perform(Bad())


@pytest.mark.promise("BEH-3")
async def test_a_performed_reaction_must_be_allowed_and_well_declared() -> None:
    """A policy that denies, an unknown resource, or a bad condition raise at once."""
    sonar, wheels = devices()
    idle = Idle()
    policy = esair.Policy("wheels", allow={"idle": esair.Access.READ})
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]) as robot:
        with pytest.raises(esair.UnknownNameError):
            await idle.perform(Follow(reads={"sonar": esair.reads(float, name="x")}))
        with pytest.raises(esair.BadValueError, match="until"):
            await idle.perform(Follow(), until=lambda other: other)
        assert len(robot._resources.registrations) == 0
    idle = Idle()
    sonar, wheels = devices()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[idle], policies=[policy]
    ) as robot:
        with pytest.raises(esair.AccessDeniedError):
            await idle.perform(Follow())
        assert len(robot._resources.registrations) == 0


@pytest.mark.promise("BEH-3", "RS-2")
async def test_a_performed_reaction_has_the_rights_of_its_behavior() -> None:
    """A policy that names the behavior holds for what it performs."""
    sonar, wheels = devices()
    idle = Idle()
    policy = esair.Policy("wheels", allow={"idle": esair.Access.WRITE})
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[idle], policies=[policy]
    ):
        assert not await idle.perform(Follow(), timeout=0.5)
        assert 1.0 in wheels.commands


@pytest.mark.promise("BEH-3")
async def test_two_reactions_at_once_do_not_end_each_other() -> None:
    """When one ends, the other keeps its rights."""
    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]):
        short = asyncio.ensure_future(idle.perform(Follow(), timeout=0.5))
        await asyncio.sleep(0.25)
        long = asyncio.ensure_future(idle.perform(Follow(name="other"), timeout=5.0))
        await short
        sonar.feed(3.0)
        await wheels.until(3.0)
        assert not await long


@pytest.mark.promise("BEH-3", "SUP-5")
async def test_a_performed_reaction_whose_sensor_is_removed_ends() -> None:
    """The behavior is told at once instead of waiting for ever."""
    sonar, wheels = devices()
    idle = Idle()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]) as robot:
        performing = asyncio.ensure_future(idle.perform(Follow()))
        await wheels.until(1.0)
        await robot.resources.remove("sonar")
        with pytest.raises(esair.ResourceRemovedError):
            await performing
        await wheels.until(0.0)


@pytest.mark.promise("BEH-3")
async def test_a_condition_that_raises_ends_the_reaction() -> None:
    """Its error is the behavior's, a StopIteration too, which no future takes."""
    sonar, wheels = devices()
    told: list[BaseException] = []

    class Performs(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        async def run(self) -> None:
            for error in (ValueError("bug"), StopIteration()):
                try:
                    await self.perform(Follow(), until=lambda e=error: _raise(e))
                except Exception as caught:
                    told.append(caught)

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Performs()]):
        await asyncio.sleep(1.0)

    assert [type(error) for error in told] == [ValueError, RuntimeError]
    assert "StopIteration" in str(told[1])


@pytest.mark.promise("BEH-3")
async def test_who_is_blind_for_too_long_is_told_how_old_the_newest_is() -> None:
    """Its sensor is there, and has nothing new."""
    sonar: FakeSensor[float] = FakeSensor("sonar")
    wheels = FakeActuator("wheels", safe=0.0)

    class Near(esair.Reaction):
        sonar = esair.reads(float, max_age=0.5)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float:
            return sonar

    idle = Idle(
        reads={"sonar": esair.reads(float)}, writes={"wheels": esair.writes(float)}
    )
    async with esair.Robot(resources=[sonar, wheels], behaviors=[idle]):
        step = asyncio.ensure_future(idle.perform(Near(), blind_timeout=1.0))
        await asyncio.sleep(0.1)
        sonar.feed(0.4)
        await wheels.until(0.4)
        with pytest.raises(esair.StaleReadingError) as told:
            await step
        assert told.value.age == pytest.approx(1.5, abs=0.01)


def _raise(error: Exception) -> bool:
    raise error


@pytest.mark.promise("BEH-3")
async def test_only_an_action_with_a_condition_is_performed() -> None:
    """What is none, or a condition that is no function, is refused."""
    sonar, wheels = devices()
    user = Idle(
        reads={"sonar": esair.reads(float)}, writes={"wheels": esair.writes(float)}
    )
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]):
        with pytest.raises(esair.ConfigError, match="a Reaction or a Behavior"):
            await user.perform(sonar)  # type: ignore[call-overload]
        with pytest.raises(esair.BadValueError, match="until: expected a function"):
            await user.perform(Follow(), until=True)  # type: ignore[call-overload]

        async def later() -> bool:
            return True

        with pytest.raises(esair.BadValueError, match="a function without async"):
            await user.perform(Follow(), until=later)  # type: ignore[arg-type]


@pytest.mark.promise("BEH-3", "RS-8")
async def test_a_reaction_that_runs_is_not_performed_as_well() -> None:
    """Its ports are those of one place; when that has ended it can be performed again."""
    sonar, wheels = devices()
    follow, mine = Follow(), Follow(name="mine")
    user = Idle(
        reads={"sonar": esair.reads(float)}, writes={"wheels": esair.writes(float)}
    )
    told = "in a running robot already"
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user, follow]):
        with pytest.raises(esair.ConfigError, match=told):
            await user.perform(follow)
        step = asyncio.ensure_future(user.perform(mine, timeout=0.5))
        await asyncio.sleep(0.1)
        with pytest.raises(esair.ConfigError, match=told):
            await user.perform(mine)
        assert not await step
        with pytest.raises(esair.BadValueError, match="until"):
            await user.perform(mine, until=lambda other: other)
        assert not await user.perform(mine, timeout=0.5)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[follow]):
        await wheels.until(1.0)


@pytest.mark.promise("ROB-1")
async def test_methods_that_cannot_be_called_are_mistakes() -> None:
    """A run with a parameter, one that yields, or none at all, stops the start."""

    class Asks(esair.Behavior):
        async def run(self, speed: float) -> None:  # type: ignore[override]
            """Nobody would give it a speed."""

    class Yields(esair.Behavior):
        async def provide(self) -> Any:  # type: ignore[override]
            yield 1

    class Empty(esair.Behavior):
        setup = None  # type: ignore[assignment]

    class Reacts(esair.Reaction):
        rate = 1.0

        def react(self) -> Any:
            yield 1

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(behaviors=[Asks(), Yields(), Empty(), Reacts()]):
            pytest.fail("it started")

    begins = [str(error).split(": expected")[0] for error in caught.value.exceptions]
    assert begins == ["asks: run", "yields: provide", "empty: setup", "reacts: react"]


class Decorated(esair.Behavior):
    """Its methods are async, and one of them is called by a plain function."""

    restart = esair.Restart(max=0)

    def __init__(self, hidden: str, **options: Any) -> None:
        super().__init__(**options)
        method = getattr(self, hidden)
        vars(self)[hidden] = lambda: method()

    async def setup(self) -> None:
        """Prepare nothing."""

    async def run(self) -> None:
        await asyncio.sleep(1.0)

    async def teardown(self) -> None:
        """Clean nothing up."""

    async def provide(self) -> int:
        return 1


async def use(robot: esair.Robot, method: str) -> None:
    """Have a method of the decorated one called by whoever calls it."""
    idle = robot.behaviors.action("idle")
    assert isinstance(idle, Idle)
    if method == "provide":
        await idle.get("decorated")
    elif method == "step":
        await idle.perform(Decorated("run"))
    else:
        await asyncio.sleep(1.1)
        failed = robot.behaviors.query("decorated").error
        assert failed is not None
        raise failed


@pytest.mark.promise("BEH-2")
@pytest.mark.parametrize("method", ["setup", "run", "teardown", "provide", "step"])
async def test_a_decorator_that_hides_async_is_told(method: str) -> None:
    """What it decorates seemed to be done at once, and nothing of it had run."""
    hidden = "teardown" if method == "step" else method
    behaviors = [Decorated(hidden, name="decorated"), Idle()]
    async with esair.Robot(behaviors=behaviors) as robot:
        with pytest.raises((esair.ConfigError, esair.BehaviorFailedError)) as caught:
            await use(robot, method)
    assert "its result is a coroutine" in str(caught.value)
