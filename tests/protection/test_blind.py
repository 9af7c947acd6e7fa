"""Who cannot see holds still: the wheels are observed, not the intentions."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from tests.protection.road import (
    MAX_AGE,
    PERIOD,
    RATE,
    SPEED,
    Drive,
    ObstacleGuard,
    ObstacleStop,
    Wheels,
)

import esair
from esair.messages import BehaviorState
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock

AT_ONCE = 0.02  # m
IN_TIME = SPEED * (MAX_AGE + PERIOD + PERIOD)  # m

PROTECTORS = [ObstacleStop, ObstacleGuard]


def ranges(value: float = 2.0, **options: Any) -> FakeSensor[float]:
    return FakeSensor("sonar", value, type=float, rate=RATE, **options)


@pytest.mark.promise("PRO-1", "PRO-9")
@pytest.mark.parametrize("protector", PROTECTORS)
@pytest.mark.parametrize(
    "fault", ["lost", "removed", "bug", "stalled", "garbage", "nan"]
)
async def test_the_rover_stops_when_its_protection_cannot_see(
    protector: Any, fault: str
) -> None:
    """At once if that is known at once, else when the last reading is too old."""
    sonar, wheels, drive, stop = ranges(), Wheels(), Drive(), protector()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[drive, stop]) as robot:
        await asyncio.sleep(1.0)
        before = wheels.x
        assert before == pytest.approx(SPEED, abs=0.1)
        if fault == "lost":
            sonar.unplug()
        elif fault == "removed":
            await robot.resources.remove("sonar")
        elif fault == "bug":
            stop.bug = True
            await asyncio.sleep(PERIOD)  # it has to decide to meet it
            before = max(before, wheels.x - AT_ONCE)
        elif fault == "stalled":
            sonar.stall()
        else:
            sonar.feed(math.nan if fault == "nan" else "rubbish")  # type: ignore[arg-type]
        await asyncio.sleep(5.0)
        limit = AT_ONCE if fault in {"lost", "removed", "bug"} else IN_TIME
        assert wheels.x - before <= limit + 1e-9
        assert wheels.commands[-1] == 0.0
        refused = drive.answers[-1]
        assert type(refused) is esair.Refused
        assert refused.holder == stop.name
        assert refused.until is None
        assert "blind" in refused.rule
        assert robot.behaviors.query("drive").restarts == 0


@pytest.mark.promise("PRO-1", "PRO-2")
@pytest.mark.parametrize("protector", PROTECTORS)
@pytest.mark.parametrize("first", [True, False])
async def test_a_rover_without_its_sonar_does_not_start(
    protector: Any, first: bool
) -> None:
    """Whatever the order in the list; and it goes when the sonar comes."""
    sonar, wheels, stop, drive = ranges(), Wheels(), protector(), Drive()
    sonar.unplug()
    behaviors = [stop, drive] if first else [drive, stop]
    async with esair.Robot(resources=[sonar, wheels], behaviors=behaviors):
        await asyncio.sleep(3.0)
        assert set(wheels.commands) == {0.0}
        assert wheels.x == 0.0
        sonar.plug()
        await wheels.until(SPEED, timeout=3.0)


@pytest.mark.promise("PRO-1")
async def test_the_refusal_names_who_is_blind_and_why() -> None:
    """An answer with holder, rule and since, and no time at which it would end."""
    sonar, wheels, drive = ranges(), Wheels(), Drive()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[ObstacleStop(name="avoid"), drive]
    ) as robot:
        await asyncio.sleep(0.5)
        lost_at = asyncio.get_running_loop().time()
        sonar.unplug()
        await asyncio.sleep(0.2)
        refused = drive.answers[-1]
        why = robot.resources.why("wheels")
    assert (refused.holder, refused.priority, refused.until) == ("avoid", 100, None)
    assert refused.rule.startswith("avoid is blind: sonar lost")
    assert refused.since == pytest.approx(lost_at)
    assert why.holder == "avoid"
    assert any(
        "drive writes with priority 0; when blind: release" in w for w in why.writers
    )


@pytest.mark.promise("PRO-1")
async def test_a_higher_priority_passes_a_blind_one() -> None:
    """It moves the wheels undisturbed; when it has released them they are safe."""
    sonar, wheels = ranges(), Wheels()
    user: Any = esair.Behavior(
        name="user", writes={"wheels": esair.writes(float, priority=101)}
    )
    async with esair.Robot(resources=[sonar, wheels], behaviors=[ObstacleStop(), user]):
        sonar.unplug()
        await asyncio.sleep(0.1)
        for _ in range(5):
            assert await user.wheels.write(0.3)
            await asyncio.sleep(0.05)
        assert wheels.commands[-5:] == [0.3] * 5
        user.wheels.release()
        await asyncio.sleep(0.0)
        await asyncio.sleep(0.001)
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-1", "PRO-14")
async def test_an_opinion_may_be_missing() -> None:
    """With blind="release" lower priorities get through."""

    class Follow(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=10, blind="release")

        def react(self, sonar: float) -> float | None:
            return None

    sonar, wheels = ranges(), Wheels()
    sonar.unplug()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Follow(), Drive()]):
        await wheels.until(SPEED, timeout=2.0)


@pytest.mark.promise("PRO-1")
async def test_a_behavior_that_says_so_is_blind_until_it_runs() -> None:
    """While it starts and is down it keeps the wheels safe; when finished it does not."""
    go = asyncio.Event()

    class Watch(esair.Behavior):
        wheels = esair.writes(float, priority=5, blind="safe")
        restart = esair.Restart(max=1, delay=1.0)
        runs = 0

        async def run(self) -> None:
            self.runs += 1
            await go.wait()
            if self.runs == 1:
                raise RuntimeError("a bug")

    wheels, watch = Wheels(), Watch()
    async with esair.Robot(resources=[wheels], behaviors=[Drive(), watch]) as robot:
        await wheels.until(SPEED)
        go.set()
        await asyncio.sleep(0.3)
        assert robot.behaviors.query("watch").state is BehaviorState.RESTARTING
        assert wheels.commands[-1] == 0.0
        await asyncio.sleep(1.5)
        assert robot.behaviors.query("watch").state is BehaviorState.FINISHED
        assert wheels.commands[-1] == SPEED


@pytest.mark.promise("PRO-2")
async def test_behaviors_begin_when_what_protects_has_decided() -> None:
    """But not later than the patience after the start."""
    loop = asyncio.get_running_loop()
    begun: list[float] = []

    class Note(esair.Behavior):
        async def run(self) -> None:
            begun.append(loop.time())

    for value, patience in ((2.0, 1.0), (None, 0.7)):
        options = {} if value is None else {"value": value}
        sonar = FakeSensor("sonar", type=float, rate=RATE, **options)  # type: ignore[arg-type]
        stop = ObstacleStop()
        before = loop.time()
        async with esair.Robot(
            resources=[sonar, Wheels()], behaviors=[Note(), stop], start_patience=0.7
        ) as robot:
            await asyncio.sleep(0.01)
            assert robot.behaviors.query("obstacle_stop").steps == (value is not None)
        waited = begun[-1] - before
        assert waited < 0.1 if value is not None else waited == pytest.approx(patience)


@pytest.mark.promise("PRO-2")
async def test_only_the_users_remove_ends_a_hold(caplog: Any) -> None:
    """A crash and a failure for good keep it; the removal is logged."""
    caplog.set_level("INFO")
    sonar, wheels, stop = ranges(), Wheels(), ObstacleStop()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[stop, Drive()]
    ) as robot:
        await wheels.until(SPEED)
        stop.bug = True
        await asyncio.sleep(20.0)
        assert robot.behaviors.query("obstacle_stop").state is BehaviorState.FAILED
        moved = [c for c in wheels.commands if c]
        await asyncio.sleep(10.0)
        assert [c for c in wheels.commands if c] == moved
        await robot.behaviors.remove("obstacle_stop")
        await wheels.until(SPEED, timeout=1.0)
    assert any("no longer keeps safe" in r.getMessage() for r in caplog.records)


@pytest.mark.promise("PRO-2")
@pytest.mark.parametrize("protector", PROTECTORS)
async def test_replace_leaves_no_gap(protector: Any) -> None:
    """The old one decides until the new one has, or for a second."""
    sonar, wheels, drive = ranges(), Wheels(), Drive()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[protector(name="stop"), drive]
    ) as robot:
        await wheels.until(SPEED)
        await asyncio.sleep(0.2)
        told = len(wheels.commands)
        await robot.behaviors.replace("stop", protector())
        await asyncio.sleep(0.3)
        assert set(wheels.commands[told:]) == {SPEED}  # it saw all the time

        broken = protector()
        broken.bug = True
        await robot.behaviors.replace("stop", broken)
        await asyncio.sleep(5.0)
        assert wheels.commands[-1] == 0.0
        assert robot.actuators.protections.of("wheels")[0].component == "stop"
        assert len(robot.actuators.protections.of("wheels")) == 1


@pytest.mark.promise("PRO-2")
@pytest.mark.parametrize("protector", [ObstacleStop, ObstacleGuard])
async def test_who_has_failed_keeps_an_actuator_that_comes_again(
    protector: Any,
) -> None:
    """Its entry is older than the device: the new one obeys it before anybody writes."""

    class Failing(protector):  # type: ignore[misc]
        bug = True
        restart = esair.Restart(max=0)

    sonar, wheels, drive = ranges(), Wheels(), Drive()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[drive, Failing(name="failing")]
    ) as robot:
        await asyncio.sleep(0.3)
        assert robot.behaviors.query("failing").state is BehaviorState.FAILED
        await robot.resources.remove("wheels")
        drive.answers.clear()
        again = Wheels()
        await robot.resources.add(again)
        await asyncio.sleep(1.0)
        assert {each.rule for each in drive.answers} == {
            "failing is blind: it failed: RuntimeError: a bug"
        }
        assert set(again.commands) == {0.0}


@pytest.mark.promise("PRO-3")
async def test_a_performed_reaction_holds_while_it_is_performed() -> None:
    """At its own port's priority; the query says what is blind; then it is over."""
    errors: list[Exception] = []

    class Approach(ObstacleStop):
        """Stops too, as a step."""

    class Captain(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            try:
                await self.perform(Approach(), blind_timeout=1.0)
            except esair.DeviceLostError as error:
                errors.append(error)
            await asyncio.Event().wait()

    sonar, wheels = ranges(), Wheels()
    async with esair.Robot(
        resources=[sonar, wheels],
        behaviors=[Captain(), Drive()],
        policies=[esair.Policy("wheels", allow={"*": esair.Access.WRITE})],
    ) as robot:
        await wheels.until(SPEED)
        sonar.unplug()
        await asyncio.sleep(0.3)
        assert wheels.commands[-1] == 0.0
        assert robot.behaviors.query("captain").detail.startswith(
            "step approach is blind: sonar lost"
        )
        await asyncio.sleep(1.5)
        assert errors
        assert wheels.commands[-1] == SPEED
        assert robot.behaviors.query("captain").detail == ""


@pytest.mark.promise("PRO-4")
async def test_an_optional_sensor_blinds_nobody() -> None:
    """While it is absent react gets None."""
    seen: list[float | None] = []

    class Stop(esair.Reaction):
        rate = 20.0
        sonar = esair.reads(float, optional=True)
        wheels = esair.writes(float, priority=100)

        def react(self, sonar: float | None) -> float | None:
            seen.append(sonar)
            return None

    sonar, wheels = ranges(), Wheels()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Stop(), Drive()]):
        await asyncio.sleep(0.5)
        assert seen[-1] == 2.0
        sonar.unplug()
        await asyncio.sleep(0.5)
        assert seen[-1] is None
        assert wheels.commands[-1] == SPEED


@pytest.mark.promise("PRO-4")
async def test_optional_sensors_alone_blind_nobody_who_has_no_rate() -> None:
    """It decides once without them, although nothing that it reads has come yet."""

    class Hint(esair.Reaction):
        sonar = esair.reads(float, optional=True)
        wheels = esair.writes(float, priority=10)

        def react(self, sonar: float | None) -> float | None:
            return sonar

    sonar: FakeSensor[float] = FakeSensor("sonar", type=float)
    wheels = FakeActuator("wheels", safe=0.0)
    drive: Any = esair.Behavior(name="drive", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Hint(), drive]):
        assert await drive.wheels.write(0.5)
        sonar.feed(0.25)
        await wheels.until(0.25, timeout=0.01)


@pytest.mark.promise("PRO-4")
@pytest.mark.parametrize("guards", [False, True], ids=["writes", "guards"])
async def test_an_optional_sensor_that_is_removed_blinds_nobody(guards: bool) -> None:
    """Nor when what does without it begins anew; added again, it is read again."""
    seen: list[float | None] = []

    class Extra(esair.Reaction):
        sonar = esair.reads(float, optional=True)
        other = esair.reads(float)

        def react(self, sonar: float | None, **given: float) -> float | None:
            seen.append(sonar)
            return given.get("wheels")

    extra = (
        Extra(guards={"wheels": esair.guards(float, latch=True)})
        if guards
        else Extra(writes={"wheels": esair.writes(float, priority=9)})
    )
    other: FakeSensor[float] = FakeSensor("other", 1.0, type=float, rate=RATE)
    wheels = Wheels()
    async with esair.Robot(
        resources=[ranges(), other, wheels], behaviors=[extra, Drive()]
    ) as robot:
        await asyncio.sleep(0.5)
        assert seen[-1] == 2.0
        before = len(wheels.commands)
        await robot.resources.remove("sonar")
        await asyncio.sleep(0.5)
        assert seen[-1] is None
        assert set(wheels.commands[before:]) == {SPEED}
        await robot.behaviors.restart("extra")
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("extra").state is esair.BehaviorState.RUNNING
        await robot.resources.add(ranges(3.0))
        if guards:  # it was begun anew, while the wheels turned
            await asyncio.sleep(0.2)
            robot.behaviors.reset("extra")
        await asyncio.sleep(0.5)
        assert seen[-1] == 3.0
        assert wheels.commands[-1] == SPEED
        await robot.resources.remove("other")
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-4")
async def test_a_step_goes_on_without_an_optional_sensor() -> None:
    """It is removed while a behavior performs what reads it."""
    seen: list[float | None] = []

    class Extra(esair.Reaction):
        sonar = esair.reads(float, optional=True)
        other = esair.reads(float)

        def react(self, sonar: float | None, other: float) -> None:
            seen.append(sonar)

    class Captain(esair.Behavior):
        async def run(self) -> None:
            await self.perform(Extra(), until=lambda: len(seen) > 20)

    other: FakeSensor[float] = FakeSensor("other", 1.0, type=float, rate=RATE)
    async with esair.Robot(resources=[ranges(), other], behaviors=[Captain()]) as robot:
        await asyncio.sleep(0.2)
        await robot.resources.remove("sonar")
        await asyncio.sleep(5.0)
        assert seen[-1] is None
        state = robot.behaviors.query("captain").state
        assert state is esair.BehaviorState.FINISHED


@pytest.mark.promise("PRO-4")
async def test_a_pushing_sensor_says_its_first_value() -> None:
    """By ``initial``, at each opening; without it what needs it is blind."""

    class Bumper(FakeSensor[bool]):
        initial = False

    class Bump(esair.Reaction):
        bumper = esair.reads(bool)
        wheels = esair.guards(float)

        def react(self, bumper: bool, wheels: float) -> float | None:
            return None if bumper else wheels

    for kind, moves in ((Bumper, True), (FakeSensor, False)):
        bumper: FakeSensor[bool] = kind("bumper", type=bool)
        wheels = Wheels()
        async with esair.Robot(resources=[bumper, wheels], behaviors=[Bump(), Drive()]):
            await asyncio.sleep(2.0)
            assert (SPEED in wheels.commands) is moves


@pytest.mark.promise("SC-3")
async def test_a_polled_reading_is_current_for_three_periods() -> None:
    """Nobody has to say so."""

    class Stop(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=100)

        def react(self, sonar: float) -> float | None:
            return None

    sonar, wheels = ranges(), Wheels()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Stop(), Drive()]):
        await asyncio.sleep(1.0)
        before = wheels.x
        sonar.stall()
        await asyncio.sleep(2.0)
        assert wheels.commands[-1] == 0.0
        assert wheels.x - before <= SPEED * (3 / RATE + PERIOD)


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize("bad", [math.nan, math.inf, 9.0, -1.0])
async def test_a_bad_reading_reaches_no_action_and_is_counted(bad: float) -> None:
    """Not finite, or outside the limits that the sensor declares."""
    seen: list[float] = []

    class Look(esair.Reaction):
        sonar = esair.reads(float)

        def react(self, sonar: float) -> None:
            seen.append(sonar)

    sonar: FakeSensor[float] = FakeSensor("sonar", type=float)
    sonar.limits = (0.0, 5.0)
    sonar.fault_limit = 100
    async with esair.Robot(resources=[sonar], behaviors=[Look()]) as robot:
        for value in (1.0, bad, 2.0):
            sonar.feed(value)
            await asyncio.sleep(0.01)
        assert robot.sensors.channels["sonar"].bad == 1
    assert seen == [1.0, 2.0]


@pytest.mark.promise("PRO-12")
async def test_where_safe_is_a_place_to_go_protection_tells_it_to_stay() -> None:
    """The arm gets HOLD while somebody is blind, and its place at the stop."""
    arm: FakeActuator[Any] = FakeActuator("wheels", safe=0.0, command_timeout=5.0)
    arm.safe_moves = True
    sonar = ranges()
    async with esair.Robot(
        resources=[sonar, arm], behaviors=[ObstacleStop(), Drive(speed=30.0)]
    ):
        await arm.until(30.0)
        sonar.unplug()
        await asyncio.sleep(1.0)
        assert arm.commands[-1] is esair.HOLD
        assert 0.0 not in arm.commands[1:]
    assert arm.commands[-1] == 0.0


async def test_each_time_of_blindness_has_its_own_time_limit() -> None:
    """One that is over counts no more."""
    ended: list[float] = []

    class Approach(esair.Reaction):
        eye = esair.reads(float)

        def react(self, eye: float) -> None:
            return None

    class Goes(esair.Behavior):
        async def run(self) -> None:
            try:
                await self.perform(Approach(), blind_timeout=1.0)
            except esair.EsairError:
                ended.append(asyncio.get_running_loop().time())
            await asyncio.Event().wait()

    eye: FakeSensor[float] = FakeSensor("eye", 1.0, rate=20.0)
    async with esair.Robot(resources=[eye], behaviors=[Goes()]):
        await asyncio.sleep(1.0)
        eye.unplug()
        await asyncio.sleep(0.3)
        eye.plug()
        await asyncio.sleep(0.6)
        eye.unplug()
        gone = asyncio.get_running_loop().time()
        await asyncio.sleep(3.0)
    assert ended == [pytest.approx(gone + 1.0, abs=0.05)]


@pytest.mark.promise("PRO-1", "AC-2")
async def test_a_hold_that_ends_leaves_nothing_moving_after_a_loss_either() -> None:
    """Who is above the blind one moves as long as its hold lasts: each time it does."""
    sonar = ranges()
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=5.0)
    above: Any = esair.Behavior(
        name="above", writes={"wheels": esair.writes(float, priority=1000)}
    )
    robot = esair.Robot(resources=[sonar, wheels], behaviors=[above, ObstacleStop()])
    async with robot:
        sonar.unplug()
        await asyncio.sleep(0.1)
        for _ in range(2):
            assert await above.wheels.write(1.0, hold=0.3)
            await asyncio.sleep(0.1)
            assert wheels.commands[-1] == 1.0
            wheels.unplug()
            await asyncio.sleep(0.1)
            wheels.plug()
            await asyncio.sleep(0.5)
            for _ in range(2):
                assert await above.wheels.write(1.0, hold=0.3)
                await asyncio.sleep(0.2)
            assert wheels.commands[-1] == 1.0
            await asyncio.sleep(0.2)
            assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-9", "SUP-2")
@pytest.mark.parametrize("protector", PROTECTORS)
async def test_who_sees_takes_over_at_once(protector: Any) -> None:
    """The patience of a replacement is for one that cannot decide yet."""
    robot = esair.Robot(resources=[ranges(), Wheels()], behaviors=[protector()])
    async with robot:
        (name,) = robot.behaviors.names()
        began = asyncio.get_running_loop().time()
        await robot.behaviors.replace(name, protector())
        assert asyncio.get_running_loop().time() - began < 0.1


@pytest.mark.promise("PRO-1")
async def test_a_shorter_hold_of_another_is_not_waited_for_longer() -> None:
    """The blind one holds when the last command's hold ends, not the one before it."""
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=10.0)

    class Careful(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=1)

        def react(self, sonar: float) -> None:
            return None

    class Long(esair.Behavior):
        wheels = esair.writes(float, priority=2)

        async def run(self) -> None:
            await self.wheels.write(0.3, hold=3.0)
            await asyncio.sleep(10.0)

    class Short(esair.Behavior):
        wheels = esair.writes(float, priority=3)

        async def run(self) -> None:
            await asyncio.sleep(1.0)
            await self.wheels.write(0.4, hold=0.1)
            await asyncio.sleep(10.0)

    sonar = ranges()
    robot = esair.Robot(
        resources=[sonar, wheels], behaviors=[Careful(), Long(), Short()]
    )
    async with robot:
        sonar.unplug()
        await wheels.until(0.4, timeout=2.0)
        assert wheels.commands[-1] == 0.4
        await asyncio.sleep(0.15)
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("TURN-2", "PRO-1")
async def test_who_takes_over_above_a_hold_is_not_stopped_before() -> None:
    """One gives it back, another takes it in the same turn: one command, not two."""

    class High(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=109)

        def react(self, sonar: float) -> float | None:
            return 0.9 if sonar > 1.0 else None

    class Low(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=105)

        def react(self, sonar: float) -> float:
            return 0.5

    sonar, wheels = ranges(), Wheels()
    hidden = FakeSensor("hidden", 1.0, type=float)
    blind = ObstacleStop(reads={"sonar": esair.reads(float, name="hidden")})
    async with esair.Robot(
        resources=[sonar, wheels, hidden], behaviors=[High(), Low(), blind]
    ):
        await wheels.until(0.9, timeout=1.0)
        hidden.unplug()
        await asyncio.sleep(PERIOD / 2)
        sonar.feed(0.5)
        await wheels.until(0.5, timeout=1.0)
        moved = wheels.commands.index(0.9)
        assert 0.0 not in wheels.commands[moved:]
        sonar.unplug()
        await asyncio.sleep(0.001)
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-2")
@pytest.mark.parametrize("rate", [None, RATE, 7.0])
async def test_replacing_who_moves_does_not_stop_it(rate: float | None) -> None:
    """The new one's first decision leaves, and the old one moves nothing any more."""

    class Follow(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)
        speed = 0.5

        def react(self, sonar: float) -> float:
            return self.speed

    Follow.rate = rate
    old, new = Follow(), Follow()
    new.speed = 0.7
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=0.5)
    async with esair.Robot(resources=[ranges(), wheels], behaviors=[old]) as robot:
        await wheels.until(0.5, timeout=1.0)
        await asyncio.sleep(0.31)
        await robot.behaviors.replace("follow", new)
        assert wheels.commands[-1] == 0.7
        await asyncio.sleep(0.31)
        assert set(wheels.commands[1:]) == {0.5, 0.7}


@pytest.mark.promise("PRO-1")
@pytest.mark.parametrize(("priority", "moves_until"), [(10, 0.5), (11, 1.0)])
async def test_only_who_is_above_a_blind_one_moves_until_its_hold_is_over(
    priority: int, moves_until: float
) -> None:
    """Of the same priority it is stopped when the other one does not see any more."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0, command_timeout=9.0)

    class Long(esair.Behavior):
        wheels = esair.writes(float, priority=priority, hold=1.0)

        async def run(self) -> None:
            await self.wheels.write(1.0)
            await asyncio.sleep(9.0)

    class Careful(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=10)

        def react(self, sonar: float) -> None:
            return None

    sonar = ranges()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Long(), Careful()]):
        await wheels.until(1.0)
        began = wheels.landed[-1]
        await asyncio.sleep(0.5)
        sonar.unplug()
        await wheels.until(0.0)
        assert wheels.landed[-1] - began == pytest.approx(moves_until, abs=0.01)


@pytest.mark.promise("PRO-1", "RS-5")
async def test_who_is_parked_because_another_device_has_come_is_blind() -> None:
    """It does not run, so what it keeps safe stays so; `why` says what does not fit."""

    class Watch(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=5, blind="safe")

        async def run(self) -> None:
            async for _ in self.sonar:
                pass

    drive, wheels = Drive(), Wheels()
    async with esair.Robot(
        resources=[ranges(), wheels], behaviors=[drive, Watch()]
    ) as robot:
        await wheels.until(SPEED)
        await robot.resources.remove("sonar")
        await robot.resources.add(FakeSensor("sonar", "near", type=str))
        await asyncio.sleep(0.1)
        drive.answers.clear()
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("watch").state is BehaviorState.PARKED
        detail = robot.behaviors.query("watch").detail
        assert "sonar" in detail
        assert {each.rule for each in drive.answers} == {f"watch is blind: {detail}"}
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("PRO-1", "SUP-4")
async def test_who_is_restarted_has_decided_nothing_yet() -> None:
    """The reason is its own, as at its first start: nothing of the run before."""
    rules: list[str] = []
    sonar, wheels = ranges(), Wheels()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[ObstacleStop(name="avoid")]
    ) as robot:
        await asyncio.sleep(0.52)
        restarting = asyncio.create_task(robot.behaviors.restart("avoid"))
        while not restarting.done():
            await asyncio.sleep(0)
            rules.append(robot.resources.why("wheels").rule)
        await restarting
    blind = {rule for rule in rules if "blind" in rule}
    assert blind == {"avoid is blind: it has not decided yet"}


@pytest.mark.promise("PRO-1")
@pytest.mark.parametrize("at", [0.0, 0.5, 3.0])
async def test_who_cannot_see_from_the_start_is_blind_since_then(at: float) -> None:
    """Whenever that was, by the clock of the loop."""
    sonar, wheels = ranges(), Wheels()
    sonar.unplug()
    await asyncio.sleep(at)
    began = asyncio.get_running_loop().time()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[ObstacleStop(name="avoid")]
    ) as robot:
        await asyncio.sleep(1.0)
        assert robot.resources.why("wheels").since == pytest.approx(began, abs=0.01)
