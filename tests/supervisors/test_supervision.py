"""Behaviors are added, removed, replaced and restarted while the rest goes on."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import gc
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

import esair
from esair.supervisors._behavior_supervisor import ZOMBIE_LIMIT
from esair.supervisors._restart_budget import RestartBudget
from esair.testing import FakeActuator, FakeSensor
from esair.values import check_name

pytestmark = pytest.mark.virtual_clock
seeds = [pytest.param(n, marks=pytest.mark.virtual_clock(seed=n)) for n in range(6)]

State = esair.BehaviorState


class Idle(esair.Behavior):
    """Does nothing."""


class Ticker(esair.Behavior):
    """Notes when it runs, a hundred times a second."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.ticks: list[float] = []

    async def run(self) -> None:
        async for _ in esair.every(0.01):
            self.ticks.append(asyncio.get_running_loop().time())

    def missed(self) -> int:
        gaps = zip(self.ticks, self.ticks[1:], strict=False)
        return sum(abs(after - before - 0.01) > 1e-6 for before, after in gaps)


class Driver(esair.Behavior):
    """Writes its speed all the time."""

    wheels = esair.writes(float)
    speed = 1.0

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(self.speed)


class Scripted(esair.Behavior):
    """Runs functions that a test gives it."""

    def __init__(
        self,
        run: Callable[[esair.Behavior], Awaitable[None]],
        *,
        setup: Callable[[esair.Behavior], Awaitable[None]] | None = None,
        teardown: Callable[[esair.Behavior], Awaitable[None]] | None = None,
        restart: esair.Restart | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self._script = {"run": run, "setup": setup, "teardown": teardown}
        self.begun: list[float] = []
        if restart is not None:
            self.restart = restart

    async def _do(self, what: str) -> None:
        script = self._script[what]
        if script is not None:
            await script(self)

    async def setup(self) -> None:
        await self._do("setup")

    async def run(self) -> None:
        self.begun.append(asyncio.get_running_loop().time())
        await self._do("run")

    async def teardown(self) -> None:
        await self._do("teardown")


def wheels(**options: Any) -> FakeActuator[float]:
    return FakeActuator("wheels", safe=0.0, **options)


async def for_ever(_behavior: object = None) -> None:
    await asyncio.get_running_loop().create_future()


async def swallow(_behavior: object = None) -> None:
    """Ignore every cancellation for a minute."""
    end = asyncio.get_running_loop().time() + 60.0
    while asyncio.get_running_loop().time() < end:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(60.0)


def raises(error: BaseException) -> Callable[[object], Awaitable[None]]:
    async def script(_behavior: object) -> None:
        raise error

    return script


def registered(robot: esair.Robot) -> dict[str, int]:
    found: dict[str, int] = {}
    for registration in robot.resources._registrations:
        found[registration.behavior] = found.get(registration.behavior, 0) + 1
    return found


# Phases.


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


# Add.


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


# Remove.


@pytest.mark.fault("L05")
async def test_an_unknown_name_is_not_found() -> None:
    """Removing twice is an error that says so, not a hang."""
    async with esair.Robot(behaviors=[Idle(name="a")]) as robot:
        await robot.behaviors.remove("a")
        for what in (
            robot.behaviors.remove("a"),
            robot.behaviors.replace("a", Idle()),
        ):
            with pytest.raises(esair.UnknownNameError):
                await what
        with pytest.raises(esair.UnknownNameError):
            robot.behaviors.query("a")


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("B19")
async def test_removal_ends_rights_at_once_and_makes_safe() -> None:
    """What it wrote is undone before remove returns, and its port is void."""
    device, driver = wheels(), Driver()
    async with esair.Robot(resources=[device], behaviors=[driver]) as robot:
        await asyncio.sleep(0.12)
        assert device.commands[-1] == 1.0
        port = driver.wheels
        await robot.behaviors.remove("driver")

        assert device.commands[-1] == 0.0
        count = len(device.commands)
        with pytest.raises(esair.BehaviorRemovedError):
            await port.write(1.0)
        with pytest.raises(esair.NotRegisteredError):
            await driver.put("driver", 1)
        assert len(device.commands) == count
        assert registered(robot) == {}


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B10")
@pytest.mark.parametrize("seed", seeds)
async def test_removal_ends_though_cancellation_is_ignored(seed: int) -> None:
    """What would not die is fenced off, listed and counted; the name is free."""
    device = wheels()

    class Stubborn(Driver):
        async def run(self) -> None:
            port = self.wheels
            while True:
                try:
                    await asyncio.sleep(0.05)
                    await port.write(1.0)
                except (asyncio.CancelledError, esair.BehaviorRemovedError):
                    if asyncio.get_running_loop().time() > 10.0:
                        return

    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[device], behaviors=[Stubborn()]) as robot:
        await asyncio.sleep(0.2)
        before = loop.time()
        await robot.behaviors.remove("stubborn")

        assert loop.time() - before <= 1.1
        assert [zombie.behavior for zombie in robot.behaviors.zombies] == ["stubborn"]
        assert robot.behaviors.zombie_count == 1
        count = len(device.commands)
        await asyncio.sleep(5.0)
        assert len(device.commands) == count
        assert device.commands[-1] == 0.0
        await robot.behaviors.add(Idle(name="stubborn"))
        await asyncio.sleep(10.0)


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B11")
async def test_removal_ends_though_the_clean_up_never_does() -> None:
    """A teardown that waits for ever costs the grace period."""
    behavior = Scripted(for_ever, teardown=for_ever, name="slow")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[behavior]) as robot:
        before = loop.time()
        await robot.behaviors.remove("slow")
        assert loop.time() - before <= 1.1
        assert robot.behaviors.zombies == []


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B14")
async def test_a_thread_that_does_not_end_is_listed() -> None:
    """A plain run that blocks is fenced off with its thread's name."""
    go = threading.Event()
    written: list[object] = []

    class Blocks(esair.Behavior):
        wheels = esair.writes(float)

        def run(self: Any) -> None:
            self.wheels.write(1.0)
            self.put("idle", "begun")
            go.wait(20.0)
            try:
                written.append(self.wheels.write(1.0))
            except esair.BehaviorRemovedError as error:
                written.append(error)

    idle, device = Idle(), wheels()
    robot = esair.Robot(resources=[device], behaviors=[idle, Blocks()], grace=0.05)
    loop: Any = asyncio.get_running_loop()
    async with robot:
        await idle.receive()
        loop.threads_in_flight -= 1  # time goes on though the thread blocks
        await robot.behaviors.remove("blocks")
        loop.threads_in_flight += 1

        assert [zombie.task for zombie in robot.behaviors.zombies] == ["esair-blocks"]
        assert device.commands[-1] == 0.0
        go.set()
        while not written:  # noqa: ASYNC110 - a thread writes
            await asyncio.sleep(0.001)
    assert isinstance(written[0], esair.BehaviorRemovedError)
    assert device.commands.count(1.0) == 1


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B12", "B13")
async def test_forgotten_tasks_end_with_their_behavior() -> None:
    """Tasks that it started and forgot live as long as it, and no longer."""
    ticks: list[float] = []

    async def tick() -> None:
        async for _ in esair.every(0.1):
            ticks.append(1.0)
            gc.collect()

    async def run(_behavior: object) -> None:
        asyncio.ensure_future(tick())  # noqa: RUF006 - forgotten on purpose
        await for_ever()

    async with esair.Robot(behaviors=[Scripted(run, name="a")]) as robot:
        await asyncio.sleep(0.55)
        assert len(ticks) == 6
        await robot.behaviors.remove("a")
        await asyncio.sleep(1.0)
        assert len(ticks) == 6


@pytest.mark.fault("B12")
async def test_a_task_that_outlives_a_crash_is_listed_at_the_removal() -> None:
    """A survivor of an earlier run is not forgotten by the restart."""

    async def run(behavior: Any) -> None:
        if len(behavior.begun) == 1:
            asyncio.ensure_future(swallow()).set_name("survivor")
            await asyncio.sleep(0)
            raise RuntimeError("first run")
        await for_ever()

    async with esair.Robot(behaviors=[Scripted(run, name="a")]) as robot:
        await asyncio.sleep(1.0)
        await robot.behaviors.remove("a")
        assert [zombie.task for zombie in robot.behaviors.zombies] == ["survivor"]
        await asyncio.sleep(200.0)


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B03", "B04")
async def test_errors_in_the_clean_up_do_not_stop_the_removal(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The first error is kept, the second one is reported."""
    behavior = Scripted(for_ever, teardown=raises(RuntimeError("dirty")), name="a")
    async with esair.Robot(behaviors=[behavior]) as robot:
        await robot.behaviors.remove("a")
        assert robot.behaviors.names() == []
    assert "teardown failed too: RuntimeError: dirty" in caplog.text


async def test_the_list_of_zombies_is_bounded() -> None:
    """All are counted, the newest are listed."""
    async with esair.Robot(grace=0.01) as robot:
        for _ in range(ZOMBIE_LIMIT + 3):
            await robot.behaviors.add(Scripted(swallow, name="a"))
            await robot.behaviors.remove("a")
        assert len(robot.behaviors.zombies) == ZOMBIE_LIMIT
        assert robot.behaviors.zombie_count == ZOMBIE_LIMIT + 3
        await asyncio.sleep(200.0)


async def test_a_behavior_may_remove_itself() -> None:
    """The desk does not wait for a task that waits for the desk."""
    robot: esair.Robot

    async def run(_behavior: object) -> None:
        await robot.behaviors.remove("a")

    robot = esair.Robot(behaviors=[Scripted(run, name="a"), Idle(name="b")])
    async with robot:
        await asyncio.sleep(0.1)
        assert robot.behaviors.names() == ["b"]
        assert robot.behaviors.zombies == []


@pytest.mark.fault("L03", "B19")
async def test_the_same_name_again_is_a_new_behavior() -> None:
    """Old ports stay void and old messages stay away."""
    device, driver = wheels(), Driver()
    async with esair.Robot(resources=[device], behaviors=[driver]) as robot:
        await asyncio.sleep(0.1)
        port = driver.wheels
        await robot.behaviors.put("old", sender="user", receiver="driver")
        assert await robot.behaviors.remove("driver") == ["old"]
        await robot.behaviors.add(driver)
        await robot.behaviors.put("new", sender="user", receiver="driver")
        with pytest.raises(esair.BehaviorRemovedError):
            await port.write(1.0)

        assert driver.wheels is not port
        assert await driver.receive() == "new"


@pytest.mark.fault("L04")
@pytest.mark.parametrize("seed", seeds)
async def test_adding_while_the_removal_runs_waits_for_it(seed: int) -> None:
    """There are never two behaviors with one name."""

    async def slow(_behavior: object) -> None:
        await asyncio.sleep(0.5)

    old, new = Scripted(for_ever, teardown=slow, name="a"), Ticker(name="a")
    async with esair.Robot(behaviors=[old]) as robot:
        removing = asyncio.ensure_future(robot.behaviors.remove("a"))
        await asyncio.sleep(0)
        await robot.behaviors.add(new)

        assert removing.done()
        assert asyncio.get_running_loop().time() >= 0.5


# Replace.


@pytest.mark.promise("SUP-2")
async def test_replace_puts_another_in_the_same_place() -> None:
    """The new one uses what the old one used; what was not taken is handed back."""
    device = wheels()
    fast = Driver()
    fast.speed = 2.0
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.1)
        await robot.behaviors.put(1, sender="user", receiver="driver")
        assert await robot.behaviors.replace("driver", fast) == [1]
        await asyncio.sleep(0.12)

        assert device.commands[-1] == 2.0
        assert registered(robot) == {"driver": 1}
        assert robot.behaviors.query("driver").state is State.RUNNING


@pytest.mark.promise("SUP-2", "AC-2")
@pytest.mark.parametrize("seed", seeds)
async def test_the_old_one_is_safe_before_the_new_one_moves(seed: int) -> None:
    """Between the last command of the old and the first of the new one is a stop."""
    device = wheels()
    fast = Driver()
    fast.speed = 2.0
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.12)
        await robot.behaviors.replace("driver", fast)
        await asyncio.sleep(0.12)

    moved = device.commands
    assert moved[moved.index(2.0) - 1] == 0.0
    assert 1.0 not in moved[moved.index(2.0) :]


@pytest.mark.promise("SUP-2")
async def test_a_replacement_that_cannot_be_set_up_changes_nothing() -> None:
    """The old one goes on, with its rights."""
    device = wheels()
    bad = Scripted(for_ever, setup=raises(RuntimeError("no")), name="bad")
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        with pytest.raises(esair.BehaviorFailedError, match="no"):
            await robot.behaviors.replace("driver", bad)
        await asyncio.sleep(0.2)

        assert device.commands[-1] == 1.0
        assert robot.behaviors.names() == ["driver"]


async def test_a_cancelled_replace_changes_nothing() -> None:
    """A set-up that hangs does not close the desk for good."""
    device = wheels()
    hangs = Scripted(for_ever, setup=for_ever)
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await robot.behaviors.replace("driver", hangs)
        await asyncio.sleep(0.2)
        assert device.commands[-1] == 1.0
        assert robot.behaviors.phase is esair.SupervisorPhase.WAIT_REQUEST


async def test_a_replacement_may_declare_more() -> None:
    """Its own class decides what it may write, not that of the old one."""

    class Arm(esair.Behavior):
        arm = esair.writes(float)

        async def run(self) -> None:
            await self.arm.write(3.0)
            await for_ever()

    arm = FakeActuator("arm", safe=0.0)
    async with esair.Robot(resources=[wheels(), arm], behaviors=[Driver()]) as robot:
        await robot.behaviors.replace("driver", Arm())
        assert await arm.until(3.0) == 3.0
        assert registered(robot) == {"driver": 1}


async def test_a_behavior_cannot_take_its_own_place() -> None:
    """Replacing something by itself is a mistake, and says so."""
    driver = Driver()
    async with esair.Robot(resources=[wheels()], behaviors=[driver]) as robot:
        with pytest.raises(esair.ConfigError, match="own place"):
            await robot.behaviors.replace("driver", driver)
        with pytest.raises(esair.ConfigError, match="expected an esair"):
            await robot.behaviors.replace("driver", 3)  # type: ignore[arg-type]


@pytest.mark.promise("BS-4")
async def test_requests_that_wait_go_on_to_the_replacement() -> None:
    """They keep their order, before what comes later."""

    class Small(Idle):
        inbox_size = 1

    class New(Small):
        async def setup(self) -> None:
            self.offer("offered")

    a, new = Idle(name="a"), New(name="b")
    async with esair.Robot(behaviors=[a, Small(name="b")]) as robot:
        await a.put("b", 0)
        puts = []
        for number in (1, 2):
            puts.append(asyncio.ensure_future(a.put("b", number)))
            await asyncio.sleep(0)
        get = asyncio.ensure_future(a.get("b"))
        await asyncio.sleep(0)
        assert await robot.behaviors.replace("b", new) == [0]
        puts.append(asyncio.ensure_future(a.put("b", 3)))

        assert [await new.receive() for _ in range(3)] == [1, 2, 3]
        assert await get == "offered"
        await asyncio.gather(*puts)


@pytest.mark.promise("BS-4")
async def test_a_get_that_is_being_answered_goes_on_to_the_replacement() -> None:
    """The old one's provide ends without an answer; the new one's answers."""

    class Slow(Idle):
        async def provide(self) -> str:
            await asyncio.sleep(5.0)
            return "old"

    class Fast(Idle):
        async def provide(self) -> str:
            return "new"

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Slow(name="b")]) as robot:
        get = asyncio.ensure_future(a.get("b", interval=9.0))
        await asyncio.sleep(0.1)
        await robot.behaviors.replace("b", Fast())
        assert await get == "new"


async def test_a_stop_in_the_middle_of_a_replace_ends_both() -> None:
    """The one that is on its way out is not forgotten."""

    async def slow(_behavior: object) -> None:
        await asyncio.sleep(0.5)

    old = Scripted(for_ever, teardown=slow, name="a")
    async with esair.Robot(behaviors=[old]) as robot:
        replacing = asyncio.ensure_future(robot.behaviors.replace("a", Idle()))
        await asyncio.sleep(0.1)
    with pytest.raises(esair.StoppingError):
        await replacing
    assert robot.behaviors.zombies == []


# Crash and restart.


@pytest.mark.promise("SUP-4")
@pytest.mark.fault("B17", "B02")
async def test_a_crash_loop_ends_in_failed() -> None:
    """Three restarts with growing pauses, then FAILED; the others go on."""
    behavior = Scripted(raises(RuntimeError("always")), name="a")
    ticker = Ticker()
    async with esair.Robot(behaviors=[behavior, ticker]) as robot:
        await asyncio.sleep(60.0)
        status = robot.behaviors.query("a")

        assert behavior.begun == pytest.approx([0.0, 0.1, 0.3, 0.7], abs=1e-6)
        assert status.state is State.FAILED
        assert status.restarts == 3
        assert isinstance(status.error, RuntimeError)
        assert ticker.missed() == 0
        assert robot.behaviors.query("ticker").state is State.RUNNING
        with pytest.raises(esair.BehaviorFailedError, match="always"):
            raise robot.behaviors.failures()[0]


@pytest.mark.promise("SUP-4")
async def test_the_budget_is_for_a_window_of_time() -> None:
    """Who crashes rarely is restarted again and again."""

    async def run(_behavior: object) -> None:
        await asyncio.sleep(20.0)
        raise RuntimeError("rarely")

    behavior = Scripted(run, name="a")
    async with esair.Robot(behaviors=[behavior]) as robot:
        await asyncio.sleep(200.0)
        assert robot.behaviors.query("a").state is State.RUNNING
        assert robot.behaviors.query("a").restarts == 9


@pytest.mark.promise("SUP-4")
def test_pauses_double_up_to_their_limit() -> None:
    """However many restarts a policy allows, the pause stays within its bounds."""
    policy = esair.Restart(max=2000, within=1e6, delay=0.1, max_delay=5.0)
    budget = RestartBudget(policy)
    pauses = [budget.spend(0.0) for _ in range(2000)]

    assert pauses[:7] == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0]
    assert set(pauses[7:]) == {5.0}
    assert budget.spend(0.0) is None
    assert budget.spend(2e6) == 0.1


@pytest.mark.promise("SUP-4")
@pytest.mark.fault("B02")
async def test_after_a_crash_nothing_moves_before_a_fresh_command() -> None:
    """What it held is made safe at once; the next run writes anew."""
    device = wheels(command_timeout=5.0)

    class Once(esair.Behavior):
        wheels = esair.writes(float)
        runs = 0

        async def run(self) -> None:
            self.runs += 1
            if self.runs == 1:
                await self.wheels.write(1.0)
                await asyncio.sleep(0.05)
                raise RuntimeError("first")
            await for_ever()

    once = Once()
    async with esair.Robot(resources=[device], behaviors=[once]) as robot:
        await asyncio.sleep(0.06)
        assert device.commands[-1] == 0.0
        count = len(device.commands)
        await asyncio.sleep(10.0)

        assert once.runs == 2
        assert len(device.commands) == count
        assert robot.resources.why("wheels").holder is None


@pytest.mark.promise("SUP-4")
@pytest.mark.fault("B05", "B15")
@pytest.mark.parametrize(
    "error",
    [
        SystemExit(3),
        KeyboardInterrupt(),
        GeneratorExit(),
        asyncio.CancelledError(),
        RecursionError("deep"),
        MemoryError(),
        BaseExceptionGroup("group", [SystemExit(1)]),
    ],
    ids=lambda error: type(error).__name__,
)
async def test_whatever_a_behavior_raises_is_contained(error: BaseException) -> None:
    """It fails like any other, and the robot keeps running."""
    behavior = Scripted(raises(error), restart=esair.Restart(max=0), name="a")
    ticker = Ticker()
    async with esair.Robot(behaviors=[behavior, ticker]) as robot:
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("a").state is State.FAILED
        assert type(robot.behaviors.query("a").error) is type(error)
        assert ticker.missed() == 0


@pytest.mark.fault("B05")
async def test_whatever_a_setup_raises_is_the_adders_error() -> None:
    """SystemExit in a setup refuses the behavior and does not end the robot."""
    async with esair.Robot() as robot:
        with pytest.raises(esair.BehaviorFailedError, match="SystemExit"):
            await robot.behaviors.add(
                Scripted(for_ever, setup=raises(SystemExit(1)), name="a")
            )
        assert robot.behaviors.names() == []


@pytest.mark.fault("B05")
async def test_whatever_a_provide_raises_is_contained() -> None:
    """SystemExit in a provide is the answer to one get, no more."""

    class Exits(Idle):
        async def provide(self) -> None:
            raise SystemExit(1)

    async with esair.Robot(behaviors=[Exits(name="a")]) as robot:
        with pytest.raises(esair.BehaviorFailedError, match="SystemExit"):
            await robot.behaviors.get(sender="a", receiver="user")


@pytest.mark.fault("B16")
async def test_finished_is_not_failed() -> None:
    """A run that returns gives everything back and is not restarted."""
    device = wheels()

    class Once(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(1.0)

    async with esair.Robot(resources=[device], behaviors=[Once()]) as robot:
        await asyncio.sleep(0.01)
        status = robot.behaviors.query("once")
        assert status.state is State.FINISHED
        assert (status.restarts, status.error) == (0, None)
        assert device.commands[-1] == 0.0
        assert registered(robot) == {}
        await asyncio.sleep(10.0)
        assert robot.behaviors.query("once").state is State.FINISHED


@pytest.mark.fault("B03")
async def test_an_error_in_the_clean_up_after_a_good_run_is_a_crash() -> None:
    """It is visible, not lost."""
    behavior = Scripted(
        raises_nothing,
        teardown=raises(RuntimeError("dirty")),
        restart=esair.Restart(max=0),
        name="a",
    )
    async with esair.Robot(behaviors=[behavior]) as robot:
        await asyncio.sleep(0.1)
        assert robot.behaviors.query("a").state is State.FAILED


async def raises_nothing(_behavior: object) -> None:
    """Return at once."""


@pytest.mark.fault("B18")
async def test_budgets_are_independent() -> None:
    """Two behaviors that crash together each have their own three restarts."""
    both = [Scripted(raises(RuntimeError(n)), name=n) for n in ("a", "b")]
    async with esair.Robot(behaviors=both) as robot:
        await asyncio.sleep(60.0)
        assert [len(each.begun) for each in both] == [4, 4]
        assert [robot.behaviors.query(n).restarts for n in ("a", "b")] == [3, 3]


@pytest.mark.promise("SUP-4")
async def test_a_removal_ends_a_restart_that_waits() -> None:
    """What is gone does not come back by itself."""
    behavior = Scripted(
        raises(RuntimeError("x")), restart=esair.Restart(delay=2.0), name="a"
    )
    async with esair.Robot(behaviors=[behavior]) as robot:
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("a").state is State.RESTARTING
        await robot.behaviors.remove("a")
        await asyncio.sleep(10.0)
        assert len(behavior.begun) == 1


@pytest.mark.promise("SUP-4")
async def test_a_crashing_reaction_restarts_by_its_policy() -> None:
    """Its steps stop, its actuator is made safe, and it ends in FAILED."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)

    class Bad(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)
        restart = esair.Restart(max=1)

        def react(self, sonar: float) -> float:
            if sonar > 5.0:
                raise SystemExit("too far")
            return sonar

    async with esair.Robot(resources=[device, sonar], behaviors=[Bad()]) as robot:
        await device.until(1.0)
        sonar.feed(9.0)
        await device.until(0.0)
        assert robot.behaviors.query("bad").state is State.RESTARTING
        sonar.feed(2.0)
        await device.until(2.0)
        assert robot.behaviors.query("bad").restarts == 1
        sonar.feed(9.0)
        await asyncio.sleep(5.0)
        assert robot.behaviors.query("bad").state is State.FAILED
        assert device.commands[-1] == 0.0
        await robot.resources.remove("sonar")
        assert robot.behaviors.query("bad").state is State.FAILED


async def test_a_change_of_resources_does_not_restart_a_reaction_twice() -> None:
    """A reaction that waits for its restart is not started besides."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)

    class Bad(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)
        restart = esair.Restart(delay=1.0)

        def react(self, sonar: float) -> float:
            if sonar > 5.0:
                raise RuntimeError("too far")
            return sonar

    async with esair.Robot(resources=[device, sonar], behaviors=[Bad()]) as robot:
        await device.until(1.0)
        sonar.feed(9.0)
        await asyncio.sleep(0.2)
        await robot.resources.replace("sonar", FakeSensor("sonar", 1.0, rate=10.0))
        await asyncio.sleep(3.0)
        before = robot.behaviors.query("bad").steps
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("bad").steps - before in range(9, 12)
        assert registered(robot) == {"bad": 2}


# Resources that come and go.


@pytest.mark.fault("L07")
async def test_a_reaction_parks_when_its_sensor_is_removed_and_comes_back() -> None:
    """It gives its actuator back, and is bound anew to the sensor that comes."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)

    class Follow(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float:
            return sonar

    async with esair.Robot(resources=[device, sonar], behaviors=[Follow()]) as robot:
        await device.until(1.0)
        await robot.resources.remove("sonar")
        await device.until(0.0)
        assert robot.behaviors.query("follow").state is State.PARKED
        assert "sonar" in robot.behaviors.query("follow").detail
        await robot.resources.add(FakeSensor("sonar", 2.0))
        await device.until(2.0)
        assert robot.behaviors.query("follow").state is State.RUNNING


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("B02")
async def test_a_behavior_whose_device_is_lost_waits_for_it() -> None:
    """An absent device is not the behavior's fault: its budget stays whole."""
    device = wheels()
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.1)
        for _ in range(5):
            device.unplug()
            await asyncio.sleep(0.2)
            assert robot.behaviors.query("driver").state is State.PARKED
            device.plug()
            await device.until(1.0)
        assert robot.behaviors.query("driver").restarts == 0


@pytest.mark.promise("SUP-4")
async def test_a_fault_of_one_device_does_not_wait_for_another() -> None:
    """It can do without what is not there: it is restarted by its policy."""
    device, gps = wheels(), FakeSensor("gps", 1.0)

    class Roam(Driver):
        gps = esair.reads(float)

    gps.unplug()
    async with esair.Robot(resources=[device, gps], behaviors=[Roam()]) as robot:
        await device.until(1.0)
        device.fail(OSError("glitch"))
        await asyncio.sleep(1.0)
        status = robot.behaviors.query("roam")
        assert (status.state, status.restarts) == (State.RUNNING, 1)


@pytest.mark.promise("SUP-5")
async def test_a_removed_resource_tells_its_users_at_once() -> None:
    """Waiting reads end at once, and the actuator is safe before it is gone."""
    device = wheels()
    sonar: FakeSensor[float] = FakeSensor("sonar")
    told: list[BaseException] = []

    class Both(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(1.0, hold=9.0)
            try:
                await self.sonar.read(timeout=60.0)
            except esair.ResourceRemovedError as error:
                told.append(error)
            try:
                await self.wheels.write(2.0)
            except esair.ResourceRemovedError as error:
                told.append(error)

    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[device, sonar], behaviors=[Both()]) as robot:
        await device.until(1.0)
        await robot.resources.remove("wheels")
        assert device.commands[-1] == 0.0
        await robot.resources.remove("sonar")
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert [type(error) for error in told] == [esair.ResourceRemovedError] * 2
        assert loop.time() < 0.5


class Follow(esair.Reaction):
    """Writes what it reads."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


async def test_a_reaction_can_be_added_and_replaced() -> None:
    """A reaction is a component like any other."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar]) as robot:
        await robot.behaviors.add(Follow())
        await device.until(1.0)

        class Double(Follow):
            def react(self, sonar: float) -> float:
                return 2 * sonar

        await robot.behaviors.replace("follow", Double())
        await device.until(2.0)
        await robot.behaviors.remove("follow")
        assert device.commands[-1] == 0.0


async def test_a_reaction_is_left_alone_by_changes_of_other_resources() -> None:
    """It keeps its registrations and its steps."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar], behaviors=[Follow()]) as robot:
        await device.until(1.0)
        before = set(robot.resources._registrations.live)
        await robot.resources.add(FakeSensor("other", 1.0))
        assert set(robot.resources._registrations.live) == before


async def test_a_reaction_whose_sensor_becomes_an_actuator_waits() -> None:
    """It cannot be bound to what took the place of its sensor; that is visible."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar], behaviors=[Follow()]) as robot:
        await device.until(1.0)
        await robot.resources.replace("sonar", FakeActuator("sonar", safe=0.0))
        await asyncio.sleep(5.0)
        status = robot.behaviors.query("follow")
        assert status.state is State.PARKED
        assert status.detail == "it reads 'sonar', which is an actuator"
        assert device.commands[-1] == 0.0


async def test_a_reaction_that_says_its_device_is_lost_has_failed() -> None:
    """Only behaviors ask devices; a reaction's error is its own."""

    class Bad(Follow):
        restart = esair.Restart(max=0)

        def react(self, sonar: float) -> float:
            raise esair.DeviceLostError("sonar")

    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar], behaviors=[Bad()]) as robot:
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("bad").state is State.FAILED


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


async def test_a_setup_that_ignores_its_end_does_not_come_to_life() -> None:
    """A behavior that is on its way out never counts as running."""

    async def stubborn(_behavior: object) -> None:
        try:
            await for_ever()
        except asyncio.CancelledError:
            return

    behavior = Scripted(for_ever, setup=stubborn, name="a")
    async with esair.Robot() as robot:
        adding = asyncio.ensure_future(robot.behaviors.add(behavior))
        await asyncio.sleep(0.1)
        adding.cancel()
        await asyncio.wait({adding})
        assert adding.cancelled()
        assert robot.behaviors.names() == []


async def test_a_zombie_that_ends_at_last_is_no_trouble() -> None:
    """However it ends, nobody is told, because nobody waits."""

    def late(error: BaseException) -> Callable[[object], Awaitable[None]]:
        async def run(_behavior: object) -> None:
            async def child() -> None:
                await swallow()
                raise error

            asyncio.ensure_future(child())  # noqa: RUF006 - forgotten on purpose
            await for_ever()

        return run

    async with esair.Robot() as robot:
        for error in (RuntimeError("late"), asyncio.CancelledError()):
            await robot.behaviors.add(Scripted(late(error), name="a"))
            await robot.behaviors.remove("a")
        await asyncio.sleep(200.0)
        gc.collect()
        assert robot.behaviors.zombie_count == 2


async def test_the_first_end_of_a_performed_reaction_counts() -> None:
    """What comes in the same tick changes nothing any more."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    idle = Idle()
    async with esair.Robot(resources=[device, sonar], behaviors=[idle]) as robot:
        performing = asyncio.ensure_future(idle.perform(Follow()))
        await device.until(1.0)
        (perform,) = robot.behaviors._members["idle"].performs
        perform.end(True)
        perform.end(False)
        perform.crash(RuntimeError("late"))
        assert await performing is True


async def test_a_class_whose_name_is_no_name_is_refused() -> None:
    """The error says what a name must look like."""

    class Größe(Idle):
        pass

    async with esair.Robot() as robot:
        with pytest.raises(esair.ConfigError, match="lower-case"):
            await robot.behaviors.add(Größe())


async def test_whatever_error_a_setup_raises_is_named_as_its_failure() -> None:
    """Also one of esair's own."""
    bad = Scripted(for_ever, setup=raises(esair.DeviceLostError("x")), name="a")
    async with esair.Robot() as robot:
        with pytest.raises(esair.BehaviorFailedError) as caught:
            await robot.behaviors.add(bad)
        assert isinstance(caught.value.__cause__, esair.DeviceLostError)


async def test_two_who_wait_are_both_woken_by_the_removal() -> None:
    """Whether they were woken by data already or not."""
    idle = Idle()
    async with esair.Robot(behaviors=[idle]) as robot:
        waiting = [asyncio.ensure_future(idle.receive()) for _ in range(2)]
        await asyncio.sleep(0)
        removing = asyncio.ensure_future(robot.behaviors.remove("idle"))
        await asyncio.sleep(0)
        await robot.behaviors.put(1, sender="user", receiver="idle")
        results = await asyncio.gather(*waiting, return_exceptions=True)
        left = await removing
        taken = [result for result in results if result == 1]
        assert len(taken) + len(left) == 1


# The end of the robot.


async def test_ended_waits_for_every_deliberative_behavior() -> None:
    """Two who wait for the end are both told."""

    async def run(behavior: Any) -> None:
        await asyncio.sleep(1.0)

    async with esair.Robot(behaviors=[Scripted(run), Idle(name="b")]) as robot:
        waiting = [asyncio.ensure_future(robot.ended()) for _ in range(2)]
        await asyncio.sleep(2.0)
        assert not any(each.done() for each in waiting)
        await robot.behaviors.remove("b")
        await asyncio.gather(*waiting)
        await robot.ended()


async def test_the_stop_ends_those_who_wait_for_the_end() -> None:
    """Nobody waits for behaviors of a robot that has stopped."""
    async with esair.Robot(behaviors=[Idle()]) as robot:
        waiting = asyncio.ensure_future(robot.ended())
        await asyncio.sleep(0.1)
    await waiting


@pytest.mark.fault("M20")
@pytest.mark.parametrize("seed", seeds)
async def test_a_stop_in_the_middle_of_commands_leaves_nothing(seed: int) -> None:
    """Commands that run or wait end with StoppingError."""

    async def slow(_behavior: object) -> None:
        await asyncio.sleep(0.5)

    async with esair.Robot(behaviors=[Scripted(for_ever, teardown=slow)]) as robot:
        commands = [
            asyncio.ensure_future(robot.behaviors.remove("scripted")),
            asyncio.ensure_future(
                robot.behaviors.add(Scripted(for_ever, setup=slow, name="b"))
            ),
            asyncio.ensure_future(robot.behaviors.add(Idle(name="scripted"))),
        ]
        await asyncio.sleep(0.1)
    for command in commands:
        with pytest.raises(esair.StoppingError):
            await command
    with pytest.raises(esair.StoppingError):
        await robot.behaviors.add(Idle(name="late"))


# What an operator types.


async def test_the_operators_commands() -> None:
    """Each command answers in words."""
    device = wheels()
    async with esair.Robot(resources=[device], behaviors=[Driver(), Idle()]) as robot:
        command = robot.behaviors.command
        await asyncio.sleep(0.1)
        await robot.behaviors.put(1, sender="user", receiver="idle")

        assert await command("list") == "driver: running\nidle: running"
        assert await command("query driver") == "driver: running, 0 restarts"
        assert "held by driver" in await command("why wheels")
        assert "remove" in await command("help")
        assert await command("remove idle") == (
            "idle was removed; 1 messages were not taken"
        )
        assert await command("remove driver") == "driver was removed"


async def test_the_operators_mistakes_are_explained() -> None:
    """The error says what was expected."""
    async with esair.Robot() as robot:
        for text, expected in (
            ("", "there are list"),
            ("remov x", "did you mean 'remove'"),
            ("remove", "expected: remove NAME"),
            ("list all", "expected: list"),
            ("remove 'x", "quotation"),
        ):
            with pytest.raises(esair.ConfigError, match=expected):
                await robot.behaviors.command(text)
        with pytest.raises(esair.UnknownNameError):
            await robot.behaviors.command("query nobody")
        with pytest.raises(esair.ConfigError, match="expected a line of text"):
            await robot.behaviors.command(None)  # type: ignore[arg-type]


async def test_query_tells_why_a_behavior_is_parked() -> None:
    """The detail is part of the answer."""
    device = wheels()
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.1)
        device.unplug()
        await asyncio.sleep(0.2)
        assert "wheels is not there" in await robot.behaviors.command("query driver")


@pytest.mark.virtual_clock
@pytest.mark.fault("B05")
async def test_a_child_task_that_exits_ends_itself_only():
    """sys.exit() in a task that a behavior started does not end the program."""

    class Parent(esair.Behavior):
        caught: BaseException | None = None

        async def run(self):
            async def leave():
                sys.exit(3)

            try:
                await asyncio.create_task(leave())
            except RuntimeError as error:
                self.caught = error
            await asyncio.Event().wait()

    parent = Parent()
    async with esair.Robot(behaviors=[parent]) as robot:
        await asyncio.sleep(1.0)

        assert isinstance(parent.caught.__cause__, SystemExit)
        assert robot.behaviors.query("parent").state is esair.BehaviorState.RUNNING


@pytest.mark.promise("ROB-2")
async def test_a_device_that_came_back_unnoticed_is_made_safe(fake_actuator):
    """The stop tries an actuator that is lost once more, for its safe command."""
    wheels = fake_actuator("wheels", safe=0.0)

    class Drive(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self):
            await self.wheels.write(1.0)
            await asyncio.Event().wait()

    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        await wheels.until(1.0)
        wheels.unplug()
        await asyncio.sleep(3.0)
        wheels.report_arrived = lambda: None  # nobody hears of it
        wheels.plug()

    assert wheels.commands[-1] == 0.0
    assert robot.stopped[0].safe
    assert robot.stopped[0].answered


@pytest.mark.promise("ROB-2")
async def test_a_device_that_stays_away_is_reported(fake_actuator):
    """An actuator that could not be told its safe command is not called safe."""
    wheels = fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[wheels]) as robot:
        wheels.unplug()

    assert not robot.stopped[0].answered
    assert "unplugged" in robot.stopped[0].error


@pytest.mark.promise("SUP-4")
@pytest.mark.fault("R14", "B10")
async def test_what_outlives_a_crash_speaks_for_nobody(fake_actuator):
    """A task of the run before finds the ports of the next one, and may not use them."""
    wheels = fake_actuator("wheels", safe=0.0)
    go = asyncio.Event()
    errors: list[Exception] = []

    class Drive(esair.Behavior):
        wheels = esair.writes(float, configure=True)
        inbox_size = 4
        runs = 0

        async def run(self) -> None:
            self.runs += 1
            if self.runs == 1:
                self.left = asyncio.create_task(self.stay())
                await asyncio.sleep(0.01)
                raise RuntimeError("crash")
            await asyncio.Event().wait()

        async def stay(self) -> None:
            while not go.is_set():
                with contextlib.suppress(asyncio.CancelledError):
                    await go.wait()
            for attempt in (
                lambda: self.wheels.write(1.0),
                self.wheels.configure,
                self.receive,
                lambda: self.put("drive", "from the dead"),
                lambda: self.get("other"),
                lambda: self.register("wheels", esair.Access.WRITE),
                lambda: self.perform(Nothing()),
            ):
                try:
                    await attempt()
                except esair.NotRegisteredError as error:
                    errors.append(error)
            try:
                self.offer("from the dead")
            except esair.NotRegisteredError as error:
                errors.append(error)

    class Nothing(esair.Reaction):
        rate = 1.0

        def react(self) -> None:
            return None

    drive = Drive()
    async with esair.Robot(resources=[wheels], behaviors=[drive, Idle(name="other")]):
        await asyncio.sleep(5.0)
        assert drive.runs == 2
        await drive.put("drive", "for the living")
        go.set()
        await drive.left
        assert len(errors) == 8
        assert all("has ended" in str(error) for error in errors)
        assert wheels.commands == [0.0]
        assert await drive.wheels.write(2.0)
        assert await drive.receive() == "for the living"


@pytest.mark.real_clock
@pytest.mark.promise("SUP-4")
@pytest.mark.fault("R14", "B14")
async def test_a_thread_that_outlives_a_crash_speaks_for_nobody(fake_actuator):
    """The same for a behavior whose run is a plain function."""
    wheels = fake_actuator("wheels", safe=0.0)
    go = threading.Event()
    errors: list[Exception] = []

    class Drive(esair.Behavior):
        wheels = esair.writes(float)
        runs = 0

        def run(self) -> None:
            self.runs += 1
            if self.runs == 1:
                context = contextvars.copy_context()
                self.left = threading.Thread(target=context.run, args=(self.stay,))
                self.left.start()
                raise RuntimeError("crash")
            go.wait(10.0)
            while len(errors) < 2:
                time.sleep(0.005)

        def stay(self) -> None:
            while self.runs < 2:
                time.sleep(0.005)
            for attempt in (
                lambda: self.wheels.write(1.0),
                lambda: self.put("drive", "from the dead"),
            ):
                try:
                    attempt()
                except esair.BehaviorRemovedError as error:
                    errors.append(error)
            go.set()

    drive = Drive()
    drive.restart = esair.Restart(max=3, within=30.0)
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        for _ in range(2000):
            if robot.behaviors.query("drive").state is State.FINISHED:
                break
            await asyncio.sleep(0.005)
        drive.left.join(5.0)

    assert len(errors) == 2
    assert set(wheels.commands) == {0.0}


async def test_what_has_failed_for_good_says_so_to_its_own_code() -> None:
    """Whoever still acts in its name hears that it failed, not that it was removed."""

    class Fails(esair.Behavior):
        restart = esair.Restart(max=0)

        async def run(self) -> None:
            raise RuntimeError("no")

    behavior = Fails()
    async with esair.Robot(behaviors=[behavior]) as robot:
        await asyncio.sleep(0.1)
        assert robot.behaviors.query("fails").state is esair.BehaviorState.FAILED
        for work in (behavior.get("fails"), behavior.put("fails", 1)):
            with pytest.raises(esair.BehaviorFailedError, match="RuntimeError: no"):
                await work
        with pytest.raises(esair.BehaviorFailedError, match="RuntimeError: no"):
            behavior.offer(1)


@pytest.mark.promise("SEC-1")
async def test_a_command_that_is_not_known_is_quoted_in_the_error() -> None:
    """No escape of a terminal gets through, and no text without end."""
    async with esair.Robot() as robot:
        with pytest.raises(esair.ConfigError) as raised:
            await robot.behaviors.command("\x1b[31m" + "x" * 10_000)

    assert "\x1b" not in str(raised.value)
    assert len(str(raised.value)) < 300


@pytest.mark.promise("SC-1")
@pytest.mark.parametrize("seconds", [-1.0, 0.0, float("nan"), "x"])
async def test_a_bad_time_limit_of_a_read_is_refused_always(seconds: Any) -> None:
    """Also where the newest reading is good enough and nobody would wait."""

    class Reads(esair.Behavior):
        sonar = esair.reads(float)

    behavior = Reads()
    async with esair.Robot(resources=[FakeSensor("sonar", 1.0)], behaviors=[behavior]):
        assert await behavior.sonar.read() == 1.0
        with pytest.raises(esair.BadValueError, match="timeout"):
            await behavior.sonar.read(timeout=seconds)
