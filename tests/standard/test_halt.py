"""Halt, resume and stop: one latch for the whole robot, in every state."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from typing import Any

import pytest

import esair
from esair import BehaviorState, Refused
from esair.journal import Kind
from esair.loop import TurnLoop
from esair.supervisors import _halts
from esair.testing import FakeActuator, FakeSensor, VirtualLoop

pytestmark = pytest.mark.virtual_clock


class Drive(esair.Behavior):
    """Writes all the time, and keeps what it was answered."""

    wheels = esair.writes(float)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.answers: list[Any] = []

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            self.answers.append(await self.wheels.write(1.0))


class Turn(esair.Reaction):
    """Decides for another command at each step."""

    rate = 50.0
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=10)

    def react(self, sonar: float) -> float:
        return 0.5


@pytest.mark.promise("ROB-4")
async def test_nothing_but_safe_leaves_while_halted(
    fake_actuator: Any, fake_sensor: Any
) -> None:
    """Writes are refused with the reason; nobody crashes, whoever writes."""
    wheels, sonar = fake_actuator("wheels", safe=0.0), fake_sensor("sonar", 1.0)
    drive = Drive()
    async with esair.Robot(
        resources=[wheels, sonar], behaviors=[drive, Turn()]
    ) as robot:
        await wheels.until(0.5)
        before = len(wheels.commands)
        told = await robot.halt("somebody is in the cell")
        assert [(each.safe, each.answered) for each in told] == [(True, True)]
        drive.answers.clear()
        await asyncio.sleep(1.0)

        assert set(wheels.commands[before:]) == {0.0}
        refused = drive.answers[-1]
        assert isinstance(refused, Refused)
        assert (refused.holder, refused.rule) == ("halt", "somebody is in the cell")
        assert not any(drive.answers)
        assert robot.halted == "somebody is in the cell"
        why = robot.resources.why("wheels")
        assert why.holder == "halt"
        assert why.until is refused.until is None  # that is no matter of time
        for name in ("drive", "turn"):
            status = robot.behaviors.query(name)
            assert status.state is BehaviorState.RUNNING
            assert status.restarts == 0
    assert "somebody is in the cell" in robot.stopped.reason


@pytest.mark.promise("ROB-4")
async def test_a_halt_has_taken_effect_when_it_returns(fake_actuator: Any) -> None:
    """A write in the same turn is refused, without a wait in between."""
    wheels = fake_actuator("wheels", safe=0.0)
    outcomes = []

    class Once(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            outcomes.append(await self.wheels.write(1.0))
            self.halt_robot("first")
            self.halt_robot("second")
            outcomes.append(await self.wheels.write(2.0))

    async with esair.Robot(resources=[wheels], behaviors=[Once()]) as robot:
        await asyncio.sleep(0.5)
        assert outcomes[0]
        assert (outcomes[1].holder, outcomes[1].rule) == ("halt", "second")
        assert robot.behaviors.query("once").error is None
    assert wheels.commands[:2] == [0.0, 1.0]
    assert set(wheels.commands[2:]) == {0.0}


@pytest.mark.promise("ROB-4")
async def test_resume_lets_nothing_from_before_leave(fake_actuator: Any) -> None:
    """A write that waited for its turn is refused; holds are gone; slew starts at safe."""
    wheels = fake_actuator("wheels", safe=0.0, slew=10.0, command_timeout=1.0)
    outcomes: list[Any] = []

    class Queue(esair.Behavior):
        wheels = esair.writes(float, priority=5, hold=60.0)

        async def run(self) -> None:
            await self.wheels.write(1.0)
            await asyncio.sleep(0.1)
            wheels.stall()
            first = asyncio.ensure_future(self.wheels.write(2.0))
            await asyncio.sleep(0)
            outcomes.append(await self.wheels.write(3.0))
            await first

    class Other(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await asyncio.sleep(1.0)
            outcomes.append(await self.wheels.write(9.0))

    async with esair.Robot(resources=[wheels], behaviors=[Queue(), Other()]) as robot:
        await asyncio.sleep(0.15)
        halting = robot.halt("look")
        robot.resume()
        wheels.resume()
        await halting
        assert wheels.commands[-1] == 0.0
        await asyncio.sleep(1.0)
    assert [bool(each) for each in outcomes] == [False, True]
    assert outcomes[0].holder == "halt"
    assert 3.0 not in wheels.commands
    assert max(wheels.commands[-3:]) <= 0.0 + 10.0 * 1.0


@pytest.mark.promise("ROB-4")
async def test_a_robot_that_was_resumed_before_its_start_moves(
    fake_actuator: Any,
) -> None:
    """The halt before it is over."""
    wheels = fake_actuator("wheels", safe=0.0)
    robot = esair.Robot(resources=[wheels], behaviors=[Drive()])
    robot.halt("not yet")
    robot.resume()
    async with robot:
        await asyncio.sleep(0.1)
        assert max(wheels.commands) > 0.0


@pytest.mark.promise("ROB-4")
async def test_a_robot_that_was_halted_before_starts_halted(fake_actuator: Any) -> None:
    """It moves when the user resumes it, and not before; also what is added later."""
    wheels, arm = fake_actuator("wheels", safe=0.0), fake_actuator("arm", safe=0.0)

    class Reach(Drive):
        wheels = esair.writes(float, name="arm")

    robot = esair.Robot(resources=[wheels], behaviors=[Drive()])
    assert await robot.halt("not yet") == ()
    async with robot:
        await robot.resources.add(arm)
        reach = Reach()
        await robot.behaviors.add(reach)
        await asyncio.sleep(0.3)
        assert set(wheels.commands) == set(arm.commands) == {0.0}
        assert isinstance(reach.answers[-1], Refused)
        assert reach.answers[-1].rule == "not yet"
        robot.resume()
        await wheels.until(1.0)
        await arm.until(1.0)


@pytest.mark.promise("ROB-4")
async def test_a_thread_halts_before_anything_else_happens(fake_actuator: Any) -> None:
    """When the call returns in the thread nothing but safe is sent any more."""
    wheels = fake_actuator("wheels", safe=0.0)
    seen: list[Any] = []

    class Thread(esair.Behavior):
        def run(self) -> None:
            time.sleep(0.01)
            halting = self.halt_robot("seen by a thread")
            seen.append(list(wheels.commands))
            seen.append(halting.result(5.0))

    async with esair.Robot(resources=[wheels], behaviors=[Drive(), Thread()]) as robot:
        await asyncio.sleep(1.0)
        assert robot.halted == "seen by a thread"
    commands, told = seen
    assert [(each.safe, each.answered) for each in told] == [(True, True)]
    assert 1.0 in commands
    assert set(wheels.commands[commands.index(1.0) + 1 :]) == {0.0}


@pytest.mark.promise("ROB-4")
async def test_a_thread_that_halts_waits_no_longer_than_the_loop_needs(
    monkeypatch: Any,
) -> None:
    """Its patience is for a loop that is busy."""
    monkeypatch.setattr(_halts, "TAKEN_WITHIN", 20.0)
    began = time.monotonic()
    async with esair.Robot() as robot:
        await (await asyncio.to_thread(robot.halt, "from a thread"))
        assert robot.halted == "from a thread"
    assert time.monotonic() - began < 10.0


@pytest.mark.promise("ROB-4")
@pytest.mark.real_clock
async def test_a_thread_has_halted_when_its_call_returns(monkeypatch: Any) -> None:
    """What follows in the thread finds the loop halted, not about to be."""
    monkeypatch.setattr(_halts, "TAKEN_WITHIN", 20.0)
    heard: list[str] = []

    def halt() -> list[str]:
        robot.halt("from a thread")
        return list(heard)

    async with esair.Robot() as robot:
        robot.journal.listen(
            lambda event: heard.append(event.text), kinds=[Kind.HALTED]
        )
        assert await asyncio.to_thread(halt) == ["from a thread"]


@pytest.mark.promise("ROB-4")
@pytest.mark.real_clock
async def test_a_thread_halts_although_the_loop_is_stuck(fake_actuator: Any) -> None:
    """The latch is down at once; the loop sends safe as its next act."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    drive = Drive()
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        await wheels.until(1.0)
        thread = threading.Timer(0.05, robot.halt, ["stuck"])
        thread.start()
        time.sleep(0.3)  # noqa: ASYNC251 - the loop is stuck, that is the point
        before = len(wheels.commands)
        refused = await drive.wheels.write(2.0)
        assert (refused.holder, refused.rule) == ("halt", "stuck")
        time.sleep(0.3)  # noqa: ASYNC251
        drive.answers.clear()
        await asyncio.sleep(0.1)
        thread.join()
        assert set(wheels.commands[before:]) == {0.0}
        assert not any(drive.answers)


class Tilt(esair.Reaction):
    """Halts the robot in the very look at a command, and lets that pass."""

    wheels = esair.guards(float)

    def __init__(self, halt: Any) -> None:
        super().__init__()
        self.halt = halt

    def react(self, wheels: float) -> float:
        if wheels > 0.6:
            self.halt()
        return wheels


class Checking(esair.Actuator[float]):
    """Halts in its own check, if told so."""

    safe = 0.0
    command_timeout = 5.0

    def __init__(self, halt: Any) -> None:
        super().__init__(name="wheels")
        self.halt = halt
        self.commands: list[float] = []

    def check(self, command: float) -> None:
        if command > 0.6:
            self.halt()

    async def write(self, command: float) -> None:
        self.commands.append(command)


class CheckingPlainly(Checking):
    """Has a driver that is called in a thread."""

    def write(self, command: float) -> None:  # type: ignore[override]
        self.commands.append(command)


@pytest.mark.promise("ROB-4", "AC-3")
@pytest.mark.parametrize("by", ["itself", "a thread"])
@pytest.mark.parametrize("place", ["guard", "check"])
@pytest.mark.parametrize("kind", [Checking, CheckingPlainly])
async def test_what_is_being_looked_at_does_not_leave_after_a_halt(
    kind: Any, place: str, by: str, monkeypatch: Any
) -> None:
    """A guard, or a check, takes its time: the gate is looked at once more after it."""
    monkeypatch.setattr(_halts, "TAKEN_WITHIN", 0.01)
    halted: list[list[float]] = []

    def halt() -> None:
        if by == "itself":
            robot.halt("it tilts")
        else:
            thread = threading.Thread(target=robot.halt, args=["it tilts"])
            thread.start()
            thread.join()
        halted.append(list(wheels.commands))

    wheels = kind(halt if place == "check" else lambda: None)
    drive = esair.Behavior(name="drive", writes={"wheels": esair.writes(float)})
    guards = [Tilt(halt)] if place == "guard" else []
    robot = esair.Robot(resources=[wheels], behaviors=[drive, *guards])
    async with robot:
        port: Any = drive.wheels  # type: ignore[attr-defined]
        assert await port.write(0.5)
        refused = await port.write(1.0)
        assert (refused.holder, refused.rule) == ("halt", "it tilts")
        await asyncio.sleep(0.1)
        assert set(wheels.commands[len(halted[0]) :]) == {0.0}


@pytest.mark.promise("ROB-4", "PRO-8")
async def test_a_guard_that_halts_sends_nothing_weaker_of_what_stands(
    fake_actuator: Any, fake_sensor: Any
) -> None:
    """What stands is looked at with each new reading, and that look may halt, too."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    sonar = fake_sensor("sonar", 1.0)

    class Near(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, sonar: float, wheels: float) -> float:
            if sonar < 0.5:
                thread = threading.Thread(target=robot.halt, args=["too near"])
                thread.start()
                thread.join()
            return min(wheels, sonar)

    drive = esair.Behavior(name="drive", writes={"wheels": esair.writes(float)})
    robot = esair.Robot(resources=[wheels, sonar], behaviors=[drive, Near()])
    async with robot:
        port: Any = drive.wheels  # type: ignore[attr-defined]
        assert await port.write(1.0)
        sonar.feed(0.2)
        await asyncio.sleep(0.3)
        assert 0.2 not in wheels.commands
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("ROB-4")
async def test_a_thread_resumes_with_the_next_turn(fake_actuator: Any) -> None:
    """A user's window has a thread of its own."""
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        await robot.halt("a look at it")
        before = len(wheels.commands)
        await asyncio.to_thread(robot.resume)
        await asyncio.sleep(0.1)

        assert robot.halted is None
        assert 1.0 in wheels.commands[before:]


@pytest.mark.promise("ROB-4")
async def test_no_reason_keeps_a_robot_from_being_halted(fake_actuator: Any) -> None:
    """Not even one that cannot be put into words."""

    class Mute:
        def __str__(self) -> str:
            raise ValueError("no words")

    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        await wheels.until(1.0)
        await robot.halt(Mute())  # type: ignore[arg-type]

        assert robot.halted == "no reason was given"
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("ROB-4")
async def test_only_the_user_resumes(fake_actuator: Any) -> None:
    """A behavior that tries gets an error, and the robot stays halted."""
    wheels = fake_actuator("wheels", safe=0.0)
    errors: list[Exception] = []

    class Cheat(esair.Behavior):
        async def run(self) -> None:
            try:
                robot.resume()
            except esair.AccessDeniedError as error:
                errors.append(error)

    robot = esair.Robot(resources=[wheels], behaviors=[Drive(), Cheat()])
    robot.halt("wait")
    async with robot:
        await asyncio.sleep(0.2)
        assert robot.halted == "wait"
    assert len(errors) == 1
    assert set(wheels.commands) == {0.0}


@pytest.mark.promise("ROB-4")
async def test_halting_what_is_stopped_or_stops_is_only_logged(
    fake_actuator: Any, caplog: Any
) -> None:
    """It raises nothing, and tells what each actuator was told last."""
    wheels = fake_actuator("wheels", safe=0.0)
    told = []

    class Last(esair.Behavior):
        async def teardown(self) -> None:
            told.append(await self.halt_robot("while stopping"))

    async with esair.Robot(resources=[wheels], behaviors=[Last()]) as robot:
        pass
    told.append(await robot.halt("too late"))
    robot.resume()
    assert [each[0].safe for each in told] == [True, True]
    assert "while stopping" in caplog.text
    assert "too late" in caplog.text


@pytest.mark.promise("ROB-4")
async def test_a_behavior_stops_the_robot(fake_actuator: Any, caplog: Any) -> None:
    """Everybody ends, safe is last, `ended` returns, the reason is kept."""
    wheels = fake_actuator("wheels", safe=0.0)

    class Boss(esair.Behavior):
        async def run(self) -> None:
            await asyncio.sleep(0.2)
            await self.stop_robot("the work is done")

    caplog.set_level("INFO", "esair")
    async with esair.Robot(resources=[wheels], behaviors=[Drive(), Boss()]) as robot:
        await robot.ended()
        stopped = await robot.stop("again")
        assert stopped is robot.stopped
    assert stopped.reason == "boss: the work is done"
    assert [(each.resource, each.safe) for each in stopped] == [("wheels", True)]
    assert 1.0 in wheels.commands
    assert wheels.commands[-1] == 0.0
    assert "the work is done" in caplog.text


@pytest.mark.promise("ROB-4")
async def test_a_behavior_stops_the_robot_in_its_first_step(fake_actuator: Any) -> None:
    """It runs, so the robot has started; in `setup` it has not."""
    wheels = fake_actuator("wheels", safe=0.0)

    class Once(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(1.0)
            await self.stop_robot("that was all")

    class Never(esair.Behavior):
        async def setup(self) -> None:
            await self.stop_robot("not today")

    async with esair.Robot(resources=[wheels], behaviors=[Once()]) as robot:
        await robot.ended()
    assert wheels.commands[:2] == [0.0, 1.0]
    assert wheels.commands[-1] == 0.0
    assert robot.stopped.reason == "once: that was all"
    with pytest.raises(esair.StoppingError, match="not today"):
        await esair.Robot(behaviors=[Never()]).__aenter__()


@pytest.mark.real_clock
@pytest.mark.promise("ROB-4")
async def test_a_stop_from_another_loop_is_refused_while_it_runs(
    fake_actuator: Any,
) -> None:
    """With the word for it: `halt`. The robot goes on, and stops in its own loop."""
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        with pytest.raises(esair.ConfigError, match="for threads is halt"):
            await asyncio.to_thread(asyncio.run, robot.stop("from afar"))
        assert await robot.behaviors.command("list") == "drive: running"
        assert (await robot.stop("from here")).reason == "from here"
    assert wheels.commands[-1] == 0.0
    assert await asyncio.to_thread(asyncio.run, robot.stop("again")) is robot.stopped


@pytest.mark.promise("ROB-4")
async def test_the_block_of_a_stopped_robot_goes_on(fake_actuator: Any) -> None:
    """The user stops it in its own block, looks at it, and leaves."""
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        await wheels.until(1.0)
        await robot.stop("enough")
        assert wheels.commands[-1] == 0.0
        with pytest.raises(esair.StoppingError):
            await robot.resources.remove("wheels")
    assert robot.stopped.reason == "enough"


@pytest.mark.promise("ROB-4")
async def test_a_stop_before_or_in_the_start_keeps_it_from_starting(
    fake_actuator: Any,
) -> None:
    """Nothing moves, and the error says who stopped it."""
    wheels = fake_actuator("wheels", safe=0.0)
    robot = esair.Robot(resources=[wheels])
    await robot.stop("never mind")
    with pytest.raises(esair.StoppingError, match="never mind"):
        await robot.__aenter__()
    assert wheels.commands == []

    class Slow(esair.Behavior):
        async def setup(self) -> None:
            await asyncio.sleep(3.0)

    robot = esair.Robot(resources=[wheels], behaviors=[Slow()])

    async def stop() -> None:
        await asyncio.sleep(0.1)
        await robot.stop("changed my mind")

    stopping = asyncio.ensure_future(stop())
    with pytest.raises(esair.StoppingError, match="changed my mind"):
        await robot.__aenter__()
    await stopping
    assert set(wheels.commands) == {0.0}


async def test_the_reason_of_every_other_way_out(fake_actuator: Any) -> None:
    """The end of the block, an error in it, a cancellation."""
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        pass
    assert robot.stopped.reason == "its program has left it"
    robot = esair.Robot(resources=[fake_actuator("wheels", safe=0.0)])
    with pytest.raises(ValueError, match="bug"):
        async with robot:
            raise ValueError("bug")
    assert robot.stopped.reason == "ValueError: bug"


@pytest.mark.promise("SEC-1", "ROB-4")
async def test_no_reason_reaches_the_log_raw(caplog: pytest.LogCaptureFixture) -> None:
    """A reason may come from a client, or from what a device has said."""
    reason = "a cat\x1b[2J\u202e\nERROR all is well"

    class Guard(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, sonar: float, wheels: float) -> float:
            return wheels

    sonar: FakeSensor[float] = FakeSensor("sonar", 1.0, type=float)
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    with caplog.at_level(logging.INFO, logger="esair"):
        robot = esair.Robot(resources=[sonar, wheels], behaviors=[Guard()])
        robot.halt(reason)
        async with robot:
            robot.behaviors.mute("guard", 0.1, reason)
            await asyncio.sleep(0.2)
            await robot.halt(reason)
            await robot.stop(reason)
    told = [record.getMessage() for record in caplog.records]
    assert sum("a cat\\x1b[2J\\u202e" in line for line in told) >= 4
    assert [line for line in told if not line.isprintable()] == []


@pytest.mark.promise("ROB-4")
async def test_resume_lets_no_decision_from_before_leave() -> None:
    """What a reaction has decided waits until the driver is done: that too is forgotten."""

    class Follow(esair.Reaction):
        sonar = esair.reads(float, every=True)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float:
            return sonar

    class Slow(FakeActuator[float]):
        async def write(self, command: float) -> None:
            await super().write(command)
            await asyncio.sleep(0.2)

    sonar: FakeSensor[float] = FakeSensor("sonar", type=float)
    wheels = Slow("wheels", safe=0.0, command_timeout=5.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Follow()]) as robot:
        await asyncio.sleep(0.5)
        for value in (0.5, 0.7):
            sonar.feed(value)
            await asyncio.sleep(0.05)
        assert wheels.commands[-1] == 0.5
        robot.halt("somebody is in the cell")
        robot.resume()
        await asyncio.sleep(2.0)
        assert 0.7 not in wheels.commands
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("ROB-4")
async def test_a_halt_after_the_stop_is_answered_at_once(fake_actuator: Any) -> None:
    """Nothing is sent to what is closed, and the journal ends with the stop."""
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        pass
    seen: list[Any] = []
    robot.journal.listen(seen.append)
    told = robot.halt("too late")
    assert told.done()
    assert seen == []


@pytest.mark.promise("ROB-4", "RES-2")
async def test_resume_lets_nothing_reach_a_device_that_is_lost() -> None:
    """It was there at the halt: its driver is not called before it is open again."""

    class Wheels(esair.Actuator[float]):
        safe = 0.0
        gone = False

        def __init__(self) -> None:
            super().__init__()
            self.told: list[float] = []

        async def open(self) -> None:
            if self.gone:
                raise ConnectionError("the cable")

        async def write(self, command: float) -> None:
            self.told.append(command)

    wheels = Wheels()
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        await robot.halt("somebody is in the cell")
        wheels.gone = True
        wheels.report_lost()
        robot.resume()
        with pytest.raises(esair.DeviceLostError):
            await user.wheels.write(1.0)
        assert 1.0 not in wheels.told


class Arm(esair.Actuator[float]):
    """To be safe it has to go somewhere; its driver needs time for each command."""

    safe = 0.0
    safe_moves = True
    deadline = 1.0
    command_timeout = 10.0

    def __init__(self) -> None:
        super().__init__()
        self.took: list[object] = []
        self.moved = asyncio.Event()

    async def write(self, command: float) -> None:
        await asyncio.sleep(0.05)
        self.took.append(command)
        if command == 1.0:
            self.moved.set()


@pytest.mark.promise("ROB-4", "PRO-12")
@pytest.mark.parametrize("shipped", [False, True])
@pytest.mark.parametrize("pause", [0.0, 0.01, 0.04, 0.06])
def test_a_halt_while_it_is_told_to_stay_sends_safe(
    shipped: bool, pause: float
) -> None:
    """Whenever the halt comes: what was told to stay, and has answered, is told safe."""
    arm = Arm()

    class See(esair.Reaction):
        sonar = esair.reads(float, max_age=0.5)
        arm = esair.writes(float, priority=10)

        def react(self, sonar: float) -> None:
            return None

    class Reach(esair.Behavior):
        arm = esair.writes(float)

        async def run(self) -> None:
            await self.arm.write(1.0)
            await asyncio.Event().wait()

    async def main() -> None:
        sonar = FakeSensor("sonar", 1.0, type=float, rate=50.0)
        robot = esair.Robot(resources=[arm, sonar], behaviors=[See(), Reach()])
        async with robot:
            await arm.moved.wait()
            sonar.unplug()  # See is blind: the arm is told to stay
            for _ in range(4):
                await asyncio.sleep(0)
            assert robot.behaviors.query("see").detail
            await asyncio.sleep(pause)
            told = await robot.halt("look")
            assert [(each.safe, each.answered) for each in told] == [(True, True)]
            assert arm.took[-1] == 0.0

    factory = TurnLoop if shipped else VirtualLoop
    with asyncio.Runner(loop_factory=factory) as runner:
        runner.run(main())


@pytest.mark.promise("ROB-4", "BEH-3")
async def test_what_a_performed_reaction_kept_for_a_busy_driver_is_dropped(
    fake_actuator: Any, fake_sensor: Any
) -> None:
    """As that of any reaction: nothing that was decided before the halt moves after it."""

    class Copy(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float | None:
            return sonar or None

    class Captain(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.perform(Copy())

    wheels, sonar = fake_actuator("wheels", safe=0.0), fake_sensor("sonar", 1.0)
    async with esair.Robot(
        resources=[wheels, sonar],
        behaviors=[Captain()],
        policies=[esair.Policy("wheels", allow={"captain": esair.Access.WRITE})],
    ) as robot:
        await wheels.until(1.0)
        wheels.slow(0.1)
        sonar.feed(2.0)
        await asyncio.sleep(0.01)
        sonar.feed(3.0)  # which waits until the driver is done
        await asyncio.sleep(0.01)
        sonar.feed(0.0)  # it wants nothing any more
        halted = robot.halt("enough")
        robot.resume()
        await halted
        await asyncio.sleep(1.0)
        assert 3.0 not in wheels.commands
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("ROB-4")
async def test_a_halt_in_the_last_moment_of_the_robot_is_answered() -> None:
    """Its end does not cut off the answer before that begins."""
    robot = esair.Robot()

    async def halts() -> tuple[Any, ...]:
        return await robot.halt("late")

    async with robot:
        halting = asyncio.create_task(halts())
    assert await asyncio.wait_for(halting, 1.0) == ()
