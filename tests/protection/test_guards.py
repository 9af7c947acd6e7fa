"""Guards: what they let pass is what the device is told."""

from __future__ import annotations

import asyncio
import math
import threading
from typing import Any

import attrs
import numpy as np
import pytest
from tests.protection.road import PERIOD, RATE, SPEED, Drive, ObstacleGuard, Wheels

import esair
from esair.journal import Event, Kind
from esair.messages import BehaviorState
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


HALF: Any = np.float32(0.5)


@attrs.frozen
class Twist:
    linear: float
    angular: float


def ranges(value: float = 2.0) -> FakeSensor[float]:
    return FakeSensor("sonar", value, type=float, rate=RATE)


def user(priority: int = 0, kind: Any = float, name: str = "user") -> Any:
    """A behavior that does nothing but hold a port."""
    writes = {"wheels": esair.writes(kind, priority=priority)}
    return esair.Behavior(name=name, writes=writes)


class Button(esair.Reaction):
    """Lets nothing pass while it is pressed, nor afterwards."""

    button = esair.reads(bool)
    wheels = esair.guards(float, latch=True)

    def react(self, button: bool, wheels: float) -> float | None:
        return None if button else wheels


class Half(esair.Reaction):
    """Lets half of it pass."""

    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels / 2


@pytest.mark.promise("PRO-8")
async def test_a_belt_stops_when_its_door_opens() -> None:
    """It was told 1.0 once; nobody writes again."""

    class Shut(esair.Reaction):
        door = esair.reads(bool)
        belt = esair.guards(float)

        def react(self, door: bool, belt: float) -> float | None:
            return None if door else belt

    door: FakeSensor[bool] = FakeSensor("door", type=bool)
    belt: FakeActuator[float] = FakeActuator("belt", safe=0.0, command_timeout=60.0)
    operator: Any = esair.Behavior(name="op", writes={"belt": esair.writes(float)})
    async with esair.Robot(resources=[door, belt], behaviors=[Shut(), operator]):
        door.feed(False)
        await asyncio.sleep(0.01)
        assert await operator.belt.write(1.0)
        await asyncio.sleep(10.0)
        assert belt.commands == [0.0, 1.0]
        door.feed(True)
        await asyncio.sleep(0.01)
        assert belt.commands == [0.0, 1.0, 0.0]
        door.feed(False)
        await asyncio.sleep(10.0)
        assert belt.commands == [0.0, 1.0, 0.0]  # never more than what is on the wire


@pytest.mark.promise("PRO-8", "REA-3")
async def test_a_press_that_is_over_in_the_same_turn_is_seen_too() -> None:
    """By a guard that asks for every single reading; and it counts none as lost."""

    class Bumper(Button):
        button = esair.reads(bool, every=True)

    button = FakeSensor("button", False, type=bool)
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=60.0)
    drive = user()
    async with esair.Robot(
        resources=[button, wheels], behaviors=[Bumper(name="bumper"), drive]
    ) as robot:
        await asyncio.sleep(0.2)
        assert await drive.wheels.write(1.0)
        button.feed(True)
        button.feed(False)
        await wheels.until(0.0, timeout=0.01)
        refused = await drive.wheels.write(1.0)
        assert (bool(refused), refused.holder) == (False, "bumper")
        for _ in range(2000):
            button.feed(False)
            await asyncio.sleep(0.001)
        assert robot.journal.counts()["bumper"]["overflow"] == 0


@pytest.mark.promise("PRO-8", "MIN-3")
@pytest.mark.parametrize("rate", [None, 20.0])
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("name", ["above", "under"])
async def test_a_guard_latches_at_nothing_that_ends_in_the_same_turn(
    rate: float | None, order: int, name: str
) -> None:
    """Whoever steps first: its writer wants what is bad, so it is safe."""

    class Near(esair.Reaction):
        sonar = esair.reads(float, max_age=60.0)
        wheels = esair.guards(float, latch=True)

        def react(self, sonar: float, wheels: float) -> float | None:
            return None if sonar < 0.5 else wheels

    class Bad(esair.Reaction):
        sonar = esair.reads(float, max_age=60.0)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float:
            return math.nan if sonar < 0.5 else 1.0

    Near.rate = Bad.rate = rate
    sonar, wheels = FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[sonar, wheels],
        behaviors=[Near(name=name), Bad(name="between")][::order],
    ):
        await wheels.until(1.0, timeout=1.0)
        sonar.feed(0.4)
        await wheels.until(0.0, timeout=0.1)
        sonar.feed(1.0)
        await wheels.until(1.0, timeout=0.1)


@pytest.mark.promise("PRO-9", "TURN-2")
@pytest.mark.parametrize("name", ["above", "under"])
async def test_a_guard_latches_at_no_loss_that_stops_the_writer_too(name: str) -> None:
    """Both lose the same sensor: whoever is told first, and whatever they are called."""

    class Near(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float, latch=True)

        def react(self, sonar: float, wheels: float) -> float | None:
            return wheels

    class Follow(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, blind="release")

        def react(self, sonar: float) -> float:
            return SPEED

    sonar, wheels = ranges(), Wheels()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Near(name=name), Follow(name="between")]
    ):
        await wheels.until(SPEED, timeout=1.0)
        sonar.unplug()
        await wheels.until(0.0, timeout=0.1)
        sonar.plug()
        await wheels.until(SPEED, timeout=1.0)


@pytest.mark.promise("PRO-6", "TURN-2")
@pytest.mark.parametrize("names", [["first", "later"], ["later", "first"]])
async def test_equal_guards_are_asked_by_their_names(names: list[str]) -> None:
    """In whatever order they were added."""

    class Nothing(esair.Reaction):
        wheels = esair.guards(float)

        def react(self, wheels: float) -> None: ...

    wheels, driver = Wheels(), user()
    async with esair.Robot(resources=[wheels], behaviors=[driver]) as robot:
        for name in names:
            await robot.behaviors.add(Nothing(name=name))
        refused = await driver.wheels.write(0.3)
        assert isinstance(refused, esair.Refused)
        assert refused.holder == "first"


@pytest.mark.promise("PRO-7")
async def test_what_a_guard_refuses_is_safe_and_the_writer_keeps_the_hold() -> None:
    """Safe is sent once; a lower priority does not turn the wheels meanwhile."""
    sonar, wheels, high, low = ranges(), Wheels(), user(10), user(0, name="low")
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[ObstacleGuard(), high, low]
    ):
        assert await high.wheels.write(0.3)
        sonar.feed(0.2)
        await asyncio.sleep(0.01)
        before = len(wheels.commands)
        for _ in range(5):
            refused = await high.wheels.write(0.3)
            assert type(refused) is esair.Refused
            assert refused.holder == "obstacle_guard"
            assert "guards wheels" in refused.rule
            beaten = await low.wheels.write(0.1)
            assert type(beaten) is esair.Refused
            assert beaten.holder == "user"
            await asyncio.sleep(PERIOD)
        assert wheels.commands == [0.0, 0.3, 0.0]
        assert len(wheels.commands) == before


@pytest.mark.promise("PRO-7", "PRO-8")
async def test_a_weaker_command_says_what_was_asked_and_by_whom() -> None:
    """What stands is judged as it was asked: it does not shrink by itself."""
    sonar, wheels, op = ranges(), Wheels(), user()
    wheels.command_timeout = 5.0
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Half(), op]):
        written = await op.wheels.write(0.8)
        assert (written.command, written.asked, written.by) == (0.4, 0.8, "half")
        await asyncio.sleep(2.0)
        assert wheels.commands == [0.0, 0.4]


@pytest.mark.promise("PRO-8")
async def test_a_standing_command_is_made_weaker_never_stronger() -> None:
    """By each new reading."""

    class Near(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(Twist)

        def react(self, sonar: float, wheels: Twist) -> Twist | None:
            return attrs.evolve(wheels, linear=min(wheels.linear, sonar / 10))

    sonar = ranges(9.0)
    wheels: FakeActuator[Twist] = FakeActuator(
        "wheels", safe=Twist(0.0, 0.0), command_timeout=9.0
    )
    op = user(kind=Twist)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Near(), op]):
        await op.wheels.write(Twist(0.8, 1.0))
        for value in (5.0, 8.0, 2.0, 9.0):
            sonar.feed(value)
            await asyncio.sleep(0.01)
        assert wheels.commands[1:] == [
            Twist(0.8, 1.0),
            Twist(0.5, 1.0),
            Twist(0.2, 1.0),
        ]
        assert await op.wheels.write(Twist(0.7, 1.0))
        assert wheels.commands[-1] == Twist(0.7, 1.0)


@pytest.mark.promise("PRO-8")
async def test_a_command_that_waits_is_judged_when_it_is_its_turn() -> None:
    """Behind a busy driver."""
    sonar, wheels, op = ranges(), Wheels(), user()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[ObstacleGuard(), op]):
        wheels.stall()
        first = asyncio.ensure_future(op.wheels.write(0.1))
        await asyncio.sleep(0.001)
        second = asyncio.ensure_future(op.wheels.write(0.2))
        await asyncio.sleep(0.001)
        sonar.feed(0.1)
        await asyncio.sleep(0.001)
        wheels.resume()
        await asyncio.wait({first, second})
        await asyncio.sleep(0.5)
        assert 0.2 not in wheels.commands
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-8", "CALL-1")
@pytest.mark.real_clock
@pytest.mark.parametrize("near", [False, True])
async def test_a_command_in_the_queue_of_a_thread_is_fenced_by_its_guard(
    near: bool,
) -> None:
    """It has passed the guard, who withdraws it before the thread comes to it."""
    go, told = threading.Event(), []

    class Blocking(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 30.0
        deadline = 10.0

        def write(self, command: float) -> None:
            told.append(command)

    sonar, wheels, op = ranges(), Blocking(name="wheels"), user()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[ObstacleGuard(), op]
    ) as robot:
        executor = robot.actuators.channels["wheels"].driver.executor
        blocker = asyncio.ensure_future(executor.call(go.wait, timeout=10.0))
        await asyncio.sleep(0.02)
        writing = asyncio.ensure_future(op.wheels.write(0.3))
        await asyncio.sleep(0.02)
        sonar.feed(0.1 if near else 1.5)
        await asyncio.sleep(0.01)
        go.set()
        await blocker
        answer = await writing
        assert bool(answer) is not near
        assert (0.3 in told) is not near
        if near:
            assert answer.holder == "obstacle_guard"


@pytest.mark.promise("PRO-6", "PRO-9")
@pytest.mark.parametrize("gives", [0.9, -0.1, math.nan, "much", True, False])
async def test_a_guard_gives_nothing_else_than_less(gives: Any) -> None:
    """More, a wrong type or NaN is a crash of the guard, and nothing passes."""

    class Strange(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float)
        restart = esair.Restart(max=0)

        def react(self, sonar: float, wheels: float) -> Any:
            return gives if wheels == 0.8 else wheels

    sonar, wheels, op = ranges(), Wheels(), user()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Strange(), op]
    ) as robot:
        assert await op.wheels.write(0.1)
        refused = await op.wheels.write(0.8)
        assert type(refused) is esair.Refused
        await asyncio.sleep(0.01)
        assert robot.behaviors.query("strange").state is BehaviorState.FAILED
        assert not await op.wheels.write(0.1)
        assert wheels.commands == [0.0, 0.1, 0.0]


@pytest.mark.promise("PRO-6")
@pytest.mark.parametrize(
    ("asked", "gives", "safe"),
    [
        (0.8, HALF, 0.0),
        (5, np.int64(3), 0),
        (Twist(0.8, 0.1), Twist(HALF, 0.1), Twist(0.0, 0.0)),
    ],
)
async def test_a_number_of_another_class_may_be_less(
    asked: Any, gives: Any, safe: Any
) -> None:
    """As it may be a command: NumPy's are what a laser scan is made of."""

    class Slow(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(type(safe))

        def react(self, sonar: float, wheels: Any) -> Any:
            return gives

    wheels, op = FakeActuator("wheels", safe=safe), user(kind=type(safe))
    async with esair.Robot(resources=[ranges(), wheels], behaviors=[Slow(), op]):
        written = await op.wheels.write(asked)
        assert (written.command, written.by) == (gives, "slow")
        assert wheels.commands == [safe, gives]


@pytest.mark.promise("PRO-6")
async def test_guards_are_asked_by_priority_each_about_what_is_left() -> None:
    """The one that is asked first has the higher priority."""
    asked: list[tuple[str, float]] = []

    class Cut(esair.Reaction):
        rate = 20.0
        part = 1.0

        def react(self, wheels: float) -> float:
            asked.append((self.name, wheels))
            return wheels * self.part

    first = Cut(name="first", guards={"wheels": esair.guards(float, priority=2)})
    second = Cut(name="second", guards={"wheels": esair.guards(float, priority=1)})
    first.part = second.part = 0.5
    wheels, op = Wheels(), user(1000)
    async with esair.Robot(resources=[wheels], behaviors=[second, first, op]):
        written = await op.wheels.write(0.8)
        assert asked[:2] == [("first", 0.8), ("second", 0.4)]
        assert (written.command, written.by) == (0.2, "second")


@pytest.mark.promise("PRO-9")
async def test_a_blind_guard_may_let_something_pass() -> None:
    """A creep, say; and never more than was asked."""

    class Creep(ObstacleGuard):
        def blind(self, wheels: float) -> float | None:
            return min(wheels, 0.05)

    sonar, wheels, op = ranges(), Wheels(), user()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Creep(name="g"), op]):
        assert (await op.wheels.write(0.5)).by is None
        sonar.unplug()
        await asyncio.sleep(0.01)
        assert wheels.commands[-1] == 0.05  # what stood is made weaker at once
        written = await op.wheels.write(0.5)
        assert (written.command, written.by) == (0.05, "g")


@pytest.mark.promise("PRO-9")
async def test_a_guard_that_takes_too_long_is_blind(monkeypatch: Any) -> None:
    """Its verdict comes too late to be of use."""
    loop: Any = asyncio.get_running_loop()

    class Slow(ObstacleGuard):
        budget = 0.01

        def react(self, sonar: float, wheels: float) -> float | None:
            if wheels > 0.3:
                loop._now += 0.02
            return wheels

    if not hasattr(loop, "_now"):
        pytest.skip("the virtual clock cannot be moved by hand")
    sonar, wheels, op = ranges(), Wheels(), user()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Slow(), op]):
        assert await op.wheels.write(0.2)
        assert not await op.wheels.write(0.5)
        assert 0.5 not in wheels.commands


@pytest.mark.promise("PRO-9")
async def test_a_latched_guard_waits_for_the_user() -> None:
    """The reset is refused while its cause lasts."""

    button: FakeSensor[bool] = FakeSensor("button", False, type=bool, rate=20.0)
    wheels, op = Wheels(), user()
    async with esair.Robot(
        resources=[button, wheels], behaviors=[Button(name="stop"), op]
    ) as robot:
        assert await op.wheels.write(0.5)
        button.feed(True)
        await asyncio.sleep(0.01)
        assert wheels.commands[-1] == 0.0
        with pytest.raises(esair.AccessDeniedError, match="still refuses"):
            robot.behaviors.reset("stop")
        button.feed(False)
        await asyncio.sleep(0.1)
        refused = await op.wheels.write(0.5)
        assert not refused
        assert "latched" in refused.rule
        robot.behaviors.reset("stop")
        assert await op.wheels.write(0.5)

        button.unplug()  # blind while something moved
        await asyncio.sleep(0.1)
        button.plug()
        await asyncio.sleep(1.0)
        assert not await op.wheels.write(0.5)
        robot.behaviors.reset("stop")
        assert await op.wheels.write(0.5)


@pytest.mark.promise("PRO-9")
async def test_only_reset_ends_a_latch() -> None:
    """A restart or a replacement of the guard keeps it; so does a new actuator."""

    button: FakeSensor[bool] = FakeSensor("button", False, type=bool, rate=20.0)
    wheels, op = Wheels(), user()
    async with esair.Robot(
        resources=[button, wheels], behaviors=[Button(name="stop"), op]
    ) as robot:
        assert await op.wheels.write(0.5)
        button.feed(True)
        await asyncio.sleep(0.1)
        button.feed(False)
        await asyncio.sleep(0.1)
        await robot.behaviors.restart("stop")
        await asyncio.sleep(0.1)
        assert "latched" in (await op.wheels.write(0.5)).rule
        await robot.behaviors.replace("stop", Button(name="stop"))
        await asyncio.sleep(0.1)
        assert "latched" in (await op.wheels.write(0.5)).rule
        await robot.resources.remove("wheels")
        await robot.resources.add(wheels)
        await robot.behaviors.restart(op.name)
        await asyncio.sleep(0.1)
        assert "latched" in (await op.wheels.write(0.5)).rule
        robot.behaviors.reset("stop")
        assert await op.wheels.write(0.5)


@pytest.mark.promise("PRO-9", "ROB-3")
async def test_a_guard_that_leaves_the_program_at_a_reset_does_not() -> None:
    """It is asked whether it would still refuse: what it does there is its own."""
    button: FakeSensor[bool] = FakeSensor("button", False, type=bool, rate=20.0)
    wheels, op = Wheels(), user()

    class Leaves(Button):
        leaves = False

        def react(self, button: bool, wheels: float) -> float | None:
            if self.leaves:
                raise SystemExit(3)
            return super().react(button, wheels)

    guard = Leaves(name="stop")
    async with esair.Robot(resources=[button, wheels], behaviors=[guard, op]) as robot:
        button.feed(True)
        await asyncio.sleep(0.1)
        assert not await op.wheels.write(0.5)
        button.feed(False)
        await asyncio.sleep(0.1)
        guard.leaves = True
        with pytest.raises(esair.AccessDeniedError, match="it fails: SystemExit"):
            robot.behaviors.reset("stop")
        guard.leaves = False
        robot.behaviors.reset("stop")
        assert await op.wheels.write(0.5)


@pytest.mark.promise("PRO-10")
async def test_the_user_may_mute_for_a_while() -> None:
    """At most for the limit of the class; then it guards again by itself."""
    sonar, wheels, op = ranges(0.1), Wheels(), user(5)
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[ObstacleGuard(name="g"), op]
    ) as robot:
        assert not await op.wheels.write(0.1)
        with pytest.raises(esair.BadValueError, match="mute_limit"):
            robot.behaviors.mute("g", 31.0, "out of the corner")
        with pytest.raises(esair.BadValueError, match="reason"):
            robot.behaviors.mute("g", 1.0, "")
        robot.behaviors.mute("g", 30.0, "as long as its class lets")
        robot.behaviors.mute("g", 1.0, "out of the corner")
        why = str(robot.resources.why("wheels"))
        assert "MUTED" in why
        assert "out of the corner" in why
        for _ in range(10):
            assert await op.wheels.write(0.1)
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.001)
        assert wheels.commands[-1] == 0.0  # what stood is judged again
        assert not await op.wheels.write(0.1)


@pytest.mark.promise("PRO-10")
async def test_a_blind_hold_may_be_muted_too() -> None:
    """And comes back when the time is over."""

    class Stop(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=100)

        def react(self, sonar: float) -> None:
            return None

    sonar, wheels = ranges(), Wheels()
    sonar.unplug()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Stop(), Drive()]
    ) as robot:
        await asyncio.sleep(0.2)
        robot.behaviors.mute("stop", 1.0, "home by hand")
        await wheels.until(SPEED)
        await asyncio.sleep(1.05)
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-10")
async def test_the_operator_passes_blind_holds_and_no_guard() -> None:
    """Whatever priority a reaction has."""

    class Stop(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=5000)

        def react(self, sonar: float) -> None:
            return None

    sonar, wheels, op = ranges(), Wheels(), user(1000)
    sonar.unplug()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Stop(), op]) as robot:
        assert await op.wheels.write(0.1)
        await robot.behaviors.add(ObstacleGuard())
        assert not await op.wheels.write(0.1)
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-10")
async def test_guarding_is_a_right() -> None:
    """A policy may deny it; ``exclusive`` is about writers only."""
    policy = esair.Policy("wheels", allow={"*": esair.Access.WRITE})
    with pytest.raises(ExceptionGroup) as denied:
        async with esair.Robot(
            resources=[ranges(), Wheels()],
            behaviors=[ObstacleGuard()],
            policies=[policy],
        ):
            pass
    assert "GUARD" in str(denied.value.exceptions[0])
    allow = {"*": esair.Access.WRITE, "obstacle_guard": esair.Access.GUARD}
    policy = esair.Policy("wheels", allow=allow, exclusive=True)
    wheels = Wheels()
    async with esair.Robot(
        resources=[ranges(), wheels],
        behaviors=[ObstacleGuard(), Drive()],
        policies=[policy],
    ):
        await wheels.until(SPEED)


@pytest.mark.promise("PRO-5")
@pytest.mark.parametrize("more", ["a writes", "a second guards"])
async def test_a_guard_guards_one_actuator_and_writes_none(more: str) -> None:
    """Everything else is a mistake that stops the start."""
    other: dict[str, Any] = (
        {"writes": {"arm": esair.writes(float)}}
        if more == "a writes"
        else {"guards": {"arm": esair.guards(float)}}
    )
    guard = ObstacleGuard(**other)
    arm: FakeActuator[float] = FakeActuator("arm", safe=0.0)
    with pytest.raises(ExceptionGroup) as mistakes:
        async with esair.Robot(resources=[ranges(), Wheels(), arm], behaviors=[guard]):
            pass
    assert "guards one actuator and writes none" in str(mistakes.value.exceptions)


@pytest.mark.promise("PRO-6")
async def test_safe_and_the_stop_pass_no_guard() -> None:
    """Not even one that refuses everything."""

    class Never(esair.Reaction):
        rate = 10.0
        wheels = esair.guards(float)
        asked = 0

        def react(self, wheels: float) -> float | None:
            self.asked += 1
            return wheels if wheels else None

    wheels, op, never = Wheels(), user(), Never()
    async with esair.Robot(resources=[wheels], behaviors=[never, op]):
        assert await op.wheels.write(0.4)
        await asyncio.sleep(1.0)
        assert wheels.commands == [0.0, 0.4, 0.0]
    assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-13")
async def test_why_shows_who_writes_who_guards_and_what_blindness_does() -> None:
    """For each actuator, in words."""
    sonar, wheels = ranges(), Wheels()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[ObstacleGuard(), Drive()]
    ) as robot:
        await wheels.until(SPEED)
        (row,) = robot.resources.why()
        assert row.writers == ("drive writes with priority 0; when blind: release",)
        assert row.guards == ("obstacle_guard guards it with priority 0",)
        sonar.unplug()
        await asyncio.sleep(0.01)
        assert "is blind: sonar lost" in str(robot.resources.why("wheels"))


@pytest.mark.promise("PRO-9")
@pytest.mark.parametrize("stays", [True, False])
async def test_a_late_motion_is_answered_as_it_was_made_safe(stays: bool) -> None:
    """Told to stay it is told so again; told its safe place, it is sent there again."""

    class Arm(FakeActuator[float]):
        safe_moves = True

    arm = Arm("arm", safe=0.0, command_timeout=5.0)
    arm.deadline = 2.0
    sonar, op = ranges(), esair.Behavior(name="op", writes={"arm": esair.writes(float)})

    class Fence(esair.Reaction):
        sonar = esair.reads(float)
        arm = esair.guards(float)

        def react(self, sonar: float, arm: float) -> float | None:
            return None if sonar < 0.4 else arm

    op_port: Any = op
    async with esair.Robot(resources=[sonar, arm], behaviors=[Fence(), op]) as robot:
        arm.slow(0.5)
        writing = asyncio.create_task(op_port.arm.write(0.7))
        await asyncio.sleep(0.01)
        arm.slow(0.0)
        if stays:
            sonar.feed(0.1)
        else:
            robot.halt("a test")
        await asyncio.sleep(1.0)
        safe = esair.HOLD if stays else 0.0
        assert arm.commands[-3:] == [safe, 0.7, safe]
        await asyncio.wait({writing})
        writing.exception()
        robot.resume()


@pytest.mark.promise("PRO-8")
@pytest.mark.parametrize("takes", [0.0, 0.05])
async def test_what_stands_is_made_less_by_a_call_like_any_other(takes: float) -> None:
    """Told, waited for, and at fault if the device does not take it."""

    class Scale(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, sonar: float, wheels: float) -> float | None:
            return wheels * sonar

    sonar, op = ranges(1.0), user()
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=60.0)
    told: list[Event] = []
    robot = esair.Robot(resources=[sonar, wheels], behaviors=[Scale(), op])
    robot.journal.listen(told.append, kinds=[Kind.SENT])
    async with robot:
        channel = robot.actuators.channels["wheels"]
        assert (await op.wheels.write(0.8)).command == 0.8
        wheels.slow(takes)
        sonar.feed(0.5)
        await asyncio.sleep(0.001)
        assert channel.told()[1:4] == (0.4, False, not takes)
        assert (await op.wheels.write(0.6)).command == 0.3
        assert wheels.commands == [0.0, 0.8, 0.4, 0.3]
        assert channel.told().answered
        wheels.fail(ValueError("brown-out"), times=1)
        sonar.feed(0.25)
        await asyncio.sleep(takes + 0.001)
        assert robot.resources.query("wheels").faults == 1
        await wheels.until(0.0, timeout=1.0)
    assert [(each.peer, each.value) for each in told] == [
        ("user", 0.8),
        ("", 0.4),
        ("user", 0.3),
        ("", 0.15),
    ]


@pytest.mark.promise("PRO-8")
@pytest.mark.parametrize("answer", [None, esair.REFUSE])
async def test_refuse_is_the_word_for_none(answer: Any) -> None:
    """Nothing passes, and a latch closes, whichever a guard says."""

    class Closed(Button):
        def react(self, button: bool, wheels: float) -> Any:
            return answer if button else wheels

    button = FakeSensor("button", True, type=bool, rate=RATE)
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[button, wheels], behaviors=[Closed(name="closed"), user()]
    ) as robot:
        await asyncio.sleep(1.0)
        port: Any = robot.behaviors.action("user").wheels  # type: ignore[union-attr]
        refused = await port.write(1.0)
        assert not refused
        assert "latched" in refused.rule
        button.feed(False)
        await asyncio.sleep(0.5)
        robot.behaviors.reset("closed")
        assert await port.write(1.0)


class Small(esair.Reaction):
    """Lets pass what is small, and refuses the rest."""

    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels if abs(wheels) <= 0.51 else None


@pytest.mark.promise("PRO-7")
async def test_what_is_refused_leaves_nothing_moving() -> None:
    """Safe is told with the refusal, not with the next reading; the writer keeps the hold."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    driver = user()
    async with esair.Robot(
        resources=[ranges(), wheels], behaviors=[driver, Small()]
    ) as robot:
        await asyncio.sleep(0.33)
        assert await driver.wheels.write(0.43)
        assert wheels.commands[-1] == 0.43
        refused = await driver.wheels.write(0.87)
        await asyncio.sleep(0)  # its task begins
        told = list(wheels.commands)
        assert not refused
        assert refused.holder == "small"
        assert told[-1] == 0.0
        assert robot.resources.why("wheels").holder == "user"


@pytest.mark.promise("PRO-7")
@pytest.mark.parametrize("stays", [False, True], ids=["zero", "stay"])
async def test_a_guard_that_says_hold_refuses_and_goes_on(stays: bool) -> None:
    """It is no command of its own that could be too much, whatever safe is."""

    class Stay(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, sonar: float, wheels: float) -> Any:
            return esair.HOLD if sonar < 1.0 else wheels

    sonar, asks = ranges(0.5), user()
    wheels = FakeActuator[float]("wheels", safe=0.0)
    if stays:
        wheels.safe = esair.HOLD
    robot = esair.Robot(resources=[sonar, wheels], behaviors=[Stay(), asks])
    async with robot:
        await asyncio.sleep(PERIOD)
        refused = await asks.wheels.write(1.0)
        assert refused.rule == "stay guards wheels"
        sonar.feed(2.0)
        await asyncio.sleep(2 * PERIOD)
        assert await asks.wheels.write(1.0) == esair.Written(1.0, 1.0, None)
        assert robot.behaviors.query("stay").restarts == 0
