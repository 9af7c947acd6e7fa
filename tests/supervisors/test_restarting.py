"""A component that crashes begins anew while its budget lasts."""

from __future__ import annotations

import asyncio
import sys

import pytest
from tests.supervisors.actors import (
    Driver,
    Idle,
    Scripted,
    State,
    Ticker,
    for_ever,
    raises,
    raises_nothing,
    registered,
    wheels,
)

import esair
from esair.journal import Journal
from esair.plan import examine, failures
from esair.supervisors._life import Life
from esair.testing import FakeSensor

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("SUP-4")
@pytest.mark.fault("B17", "B02")
async def test_a_crash_loop_ends_in_failed() -> None:
    """Three restarts, spread over their time, then FAILED; the others go on."""
    behavior = Scripted(raises(RuntimeError("always")), name="a")
    ticker = Ticker()
    async with esair.Robot(behaviors=[behavior, ticker]) as robot:
        await asyncio.sleep(60.0)
        status = robot.behaviors.query("a")

        assert behavior.begun == pytest.approx([0.0, 0.1, 8.1, 16.1], abs=1e-6)
        assert status.state is State.FAILED
        assert status.restarts == 3
        assert isinstance(status.error, RuntimeError)
        assert ticker.missed() == 0
        assert robot.behaviors.query("ticker").state is State.RUNNING
        with pytest.raises(esair.BehaviorFailedError, match="always"):
            raise robot._behaviors.failures()[0]


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
        assert robot.behaviors.query("a").restarts == 7


@pytest.mark.promise("SUP-4")
def test_pauses_double_up_to_their_limit() -> None:
    """However many restarts a policy allows, the pause stays within its bounds."""
    policy = esair.Restart(max=2000, within=100.0, delay=0.1, max_delay=5.0)
    budget = Life("any", policy, Journal())
    pauses = [budget.spend(0.0) for _ in range(2000)]

    assert pauses[:7] == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0]
    assert set(pauses[7:]) == {5.0}
    assert budget.spend(0.0) is None
    assert budget.spend(2e6) == 0.1


@pytest.mark.promise("SUP-4")
@pytest.mark.parametrize(("later", "counts"), [(0.0, True), (0.001, False)])
def test_a_restart_counts_until_its_window_is_over(later: float, counts: bool) -> None:
    """In that very moment still; and who is only retried has to last longer than it."""
    policy = esair.Restart(max=1, within=8.0, delay=0.5)
    budget = Life("any", policy, Journal())
    assert budget.spend(1.0) == 0.5
    assert budget.spend(9.0 + later) == (None if counts else 0.5)

    policy = esair.Restart(max=1, within=8.0, delay=0.5, retry=4.0)
    budget = Life("any", policy, Journal())
    assert [budget.spend(1.0), budget.spend(1.0)] == [0.5, 4.0]
    assert budget.retries
    begins = 1.0 + 4.0
    budget.spend(begins + 8.0 + later)
    assert budget.retries is counts


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


@pytest.mark.fault("B18")
async def test_budgets_are_independent() -> None:
    """Two behaviors that crash together each have their own three restarts."""
    both = [Scripted(raises(RuntimeError(n)), name=n) for n in ("a", "b")]
    async with esair.Robot(behaviors=both) as robot:
        await asyncio.sleep(60.0)
        assert [len(each.begun) for each in both] == [4, 4]
        assert [robot.behaviors.query(n).restarts for n in ("a", "b")] == [3, 3]


@pytest.mark.promise("SUP-4")
@pytest.mark.promise("SUP-4")
async def test_a_setup_that_fails_at_the_users_restart_is_a_crash_like_another() -> (
    None
):
    """The error is told, and it is tried again as its policy says: it does not stay down."""

    class Picky(esair.Behavior):
        restart = esair.Restart(max=0, retry=60.0)
        fails = False

        async def setup(self) -> None:
            if self.fails:
                raise OSError("there is no network")

        async def run(self) -> None:
            await asyncio.sleep(1e6)

    picky = Picky()
    async with esair.Robot(behaviors=[picky]) as robot:
        picky.fails = True
        with pytest.raises(esair.BehaviorFailedError):
            await robot.behaviors.restart("picky")
        picky.fails = False
        await asyncio.sleep(61.0)
        assert robot.behaviors.query("picky").state is esair.BehaviorState.RUNNING


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


@pytest.mark.promise("SUP-4")
async def test_with_retry_it_is_tried_for_ever() -> None:
    """After its budget once in each pause, with one line; what works again has it all."""
    is_away = True

    async def run(_behavior: object) -> None:
        if is_away:
            raise OSError(101, "Network is unreachable")
        await asyncio.sleep(1e6)

    restart = esair.Restart(max=2, within=10.0, retry=60.0)
    behavior = Scripted(run, restart=restart, name="a")
    async with esair.Robot(behaviors=[behavior]) as robot:
        await asyncio.sleep(200.0)
        assert behavior.begun == pytest.approx([0.0, 0.1, 4.1, 64.1, 124.1, 184.1])
        assert robot.behaviors.query("a").state is State.RESTARTING
        is_away = False
        await asyncio.sleep(60.0)
        assert robot.behaviors.query("a").state is State.RUNNING


@pytest.mark.promise("SUP-4")
async def test_retries_are_a_line_each(caplog: pytest.LogCaptureFixture) -> None:
    """Without a traceback: a day of outage is 288 lines."""
    restart = esair.Restart(max=1, within=10.0, retry=60.0)
    failing = Scripted(raises(RuntimeError("away")), restart=restart, name="a")
    async with esair.Robot(behaviors=[failing]):
        await asyncio.sleep(600.0)
    told = [record for record in caplog.records if "tried again" in record.message]
    assert len(told) == 10
    assert told[0].message == "a: failed: RuntimeError: away; tried again in 60 s"
    assert not any(record.exc_info for record in told)


@pytest.mark.promise("SUP-4")
async def test_an_essential_one_ends_the_robot() -> None:
    """Everything is safe, and whoever waits for its end has the error."""
    device = wheels()

    class Vital(Scripted):
        essential = True

    async def run(_behavior: object) -> None:
        await asyncio.sleep(1.0)
        raise RuntimeError("no brain")

    vital = Vital(run, restart=esair.Restart(max=0), name="a")
    ticker = Ticker()
    async with esair.Robot(resources=[device], behaviors=[vital, ticker]) as robot:
        with pytest.raises(esair.BehaviorFailedError, match="no brain"):
            await robot.ended()
        await asyncio.sleep(0.5)
        assert robot.stopped.reason == "a is essential, and has failed"
        assert robot.behaviors.query("ticker").state is State.REMOVED


def test_essential_and_retried_is_a_contradiction() -> None:
    """And the check says of each what its failure means."""

    class Vital(Idle):
        essential = True

    policy = esair.Restart(retry=300.0)
    both, one, other = Vital(name="both"), Vital(name="one"), Idle(name="other")
    both.restart = other.restart = policy
    plain, turns = Idle(name="plain"), Idle(name="turns")
    robot = esair.Robot(
        behaviors=[both, one, other, plain, turns],
        modes={"a": esair.Mode(["turns"], on_failure="b"), "b": []},
        mode="a",
    )
    assert [each.component for each in examine(robot.plan) if each.is_error] == ["both"]
    told = failures(robot.plan)
    assert told["one"] == "3 restarts in 30 s, then the robot ends with an exit code"
    assert told["other"] == "3 restarts in 30 s, then again every 300 s, for ever"
    assert told["plain"].endswith("it is FAILED: the others go on without it")
    assert told["turns"].endswith("it is FAILED: mode b follows a")


@pytest.mark.promise("SUP-4", "RS-3")
async def test_a_restart_without_its_resource_is_parked_until_that_is_there() -> None:
    """What goes while a crash is waited out is missed by the next start."""

    async def run(_behavior: object) -> None:
        if behavior.begun == [0.0]:
            raise RuntimeError("once")
        await asyncio.sleep(1e6)

    behavior = Scripted(run, reads={"sonar": esair.reads(float)}, name="a")
    sonar = FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[sonar], behaviors=[behavior]) as robot:
        await asyncio.sleep(0.01)
        assert robot.behaviors.query("a").state is State.RESTARTING
        await robot.resources.remove("sonar")
        await asyncio.sleep(1.0)
        status = robot.behaviors.query("a")
        assert (status.state, status.detail) == (State.PARKED, "sonar is not there")
        await robot.resources.add(FakeSensor("sonar", 1.0))
        await asyncio.sleep(0.01)
        assert robot.behaviors.query("a").state is State.RUNNING


@pytest.mark.promise("SUP-4", "RS-5")
async def test_the_users_restart_waits_for_a_device_that_was_removed() -> None:
    """It cannot begin without; when the device is there again it goes on."""
    device, drive = wheels(), Driver()
    async with esair.Robot(resources=[device], behaviors=[drive]) as robot:
        await device.until(1.0, timeout=1.0)
        await robot.resources.remove("wheels")
        await robot.behaviors.restart("driver")
        assert robot.behaviors.query("driver").state is State.PARKED
        await robot.resources.add(other := wheels())
        await other.until(1.0, timeout=1.0)
        assert robot.behaviors.query("driver").state is State.RUNNING


@pytest.mark.promise("SUP-4")
async def test_after_a_rest_its_budget_is_full_again() -> None:
    """Who comes back to its mode has all its restarts, whatever it has used before."""
    crashes = Scripted(raises(RuntimeError("again")), name="a")
    modes = {"on": ["a"], "off": []}
    async with esair.Robot(behaviors=[crashes], modes=modes, mode="on") as robot:
        await asyncio.sleep(9.0)
        assert robot.behaviors.query("a").restarts == 3
        await robot.behaviors.switch("off", reason="a rest")
        assert robot.behaviors.query("a").restarts == 0
        begun = len(crashes.begun)
        await asyncio.sleep(20.0)  # the restart that was to come does not
        assert len(crashes.begun) == begun
        await robot.behaviors.switch("on", reason="and on")
        await asyncio.sleep(60.0)
        assert len(crashes.begun) - begun == 4


@pytest.mark.promise("SUP-4")
async def test_a_start_does_not_wait_for_what_has_failed() -> None:
    """Its restart comes later; the others begin at once."""

    async def fail(_behavior: object) -> None:
        raise RuntimeError("no map")

    began = asyncio.get_running_loop().time()
    broken = Scripted(for_ever, setup=fail, name="broken")
    async with esair.Robot(behaviors=[broken, Idle(name="other")]) as robot:
        assert asyncio.get_running_loop().time() - began < 0.1
        assert robot.behaviors.query("broken").state is State.RESTARTING


@pytest.mark.promise("SUP-4", "TURN-5")
async def test_a_restart_is_told_with_what_it_is_for() -> None:
    """In its order: the crash, the restart, the new run."""
    restart = esair.Restart(max=1, within=30.0)
    behavior = Scripted(raises(RuntimeError("always")), name="a", restart=restart)
    robot = esair.Robot(behaviors=[behavior])
    told: list[tuple[str, str]] = []
    robot.journal.listen(lambda event: told.append((event.kind.name, str(event.value))))
    async with robot:
        await asyncio.sleep(1.0)

    wanted = {"CRASHED", "RESTARTED"}
    assert [each for each in told if each[0] in wanted] == [
        ("CRASHED", "always"),
        ("RESTARTED", "always"),
        ("CRASHED", "always"),
    ]


@pytest.mark.promise("PRO-1", "PRO-2")
async def test_who_is_restarted_keeps_still_what_it_protects() -> None:
    """From the end of its run until the next one runs, as after a crash."""

    class Watch(esair.Behavior):
        wheels = esair.writes(float, priority=5, blind="safe")

        async def setup(self) -> None:
            await asyncio.sleep(0.5)

    policy = esair.Policy("wheels", allow={"*": esair.Access.WRITE})
    device = wheels()
    robot = esair.Robot(
        resources=[device], behaviors=[Watch(), Driver()], policies=[policy]
    )
    async with robot:
        await asyncio.sleep(1.0)
        device.commands.clear()
        await robot.behaviors.restart("watch")
        assert 1.0 not in device.commands
        await asyncio.sleep(0.2)
        assert device.commands[-1] == 1.0
