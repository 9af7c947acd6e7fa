"""Reactions: one small decision on each step."""

from __future__ import annotations

import asyncio
import logging
import math
from typing import Any

import pytest

import esair
from esair import BehaviorState

pytestmark = pytest.mark.virtual_clock


class Copy(esair.Reaction):
    """Writes what it reads; None for a negative reading."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(float, priority=5)

    def react(self, sonar: float) -> float | None:
        return None if sonar < 0 else sonar


@pytest.mark.promise("REA-3")
async def test_it_runs_on_every_new_reading(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Each value that is pushed is decided on at once, once."""
    radar, wheels = fake_sensor("sonar"), fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[radar, wheels], behaviors=[Copy()]) as robot:
        for value in (1.0, 2.0, 3.0):
            radar.feed(value)
            await asyncio.sleep(0.001)
        assert wheels.commands == [0.0, 1.0, 2.0, 3.0]
        assert robot.behaviors.query("copy").steps == 3
        assert robot.journal.counts()["copy"]["skipped"] == 0


@pytest.mark.promise("REA-1")
async def test_no_opinion_gives_the_actuator_back_at_once(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """None lets lower priorities through in the same moment."""
    radar, wheels = fake_sensor("sonar"), fake_actuator("wheels", safe=0.0)
    low = esair.Behavior(name="low", writes={"wheels": esair.writes(float)})

    async with esair.Robot(resources=[radar, wheels], behaviors=[Copy(), low]) as robot:
        radar.feed(1.0)
        await asyncio.sleep(0.001)
        assert not await low.wheels.write(0.1)  # type: ignore[attr-defined]
        radar.feed(-1.0)
        await asyncio.sleep(0.001)
        assert robot.resources.why("wheels").holder is None
        assert await low.wheels.write(0.1)  # type: ignore[attr-defined]


def test_a_reaction_that_writes_by_hand_is_told_how() -> None:
    """Its port moves nothing: a command is what its step returns."""
    with pytest.raises(esair.NotRegisteredError, match="what react returns"):
        Copy().wheels  # noqa: B018 - as a step of a user says it


@pytest.mark.promise("REA-1")
async def test_it_keeps_state_and_returns_several_commands(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """A dictionary has a command for each port; one that is left out is given back."""

    class Steer(esair.Reaction):
        radar = esair.reads(float)
        left = esair.writes(float)
        right = esair.writes(float)
        count = 0

        def react(self, radar: float) -> dict[str, float] | None:
            self.count += 1
            return {"left": self.count, "right": -radar} if radar > 0 else {"left": 9.0}

    radar = fake_sensor("radar")
    left, right = fake_actuator("left", safe=0.0), fake_actuator("right", safe=0.0)
    async with esair.Robot(
        resources=[radar, left, right], behaviors=[Steer()]
    ) as robot:
        for value in (1.0, 2.0, -1.0):
            radar.feed(value)
            await asyncio.sleep(0.001)
        assert left.commands == [0.0, 1.0, 2.0, 9.0]
        assert right.commands == [0.0, -1.0, -2.0]
        assert robot.resources.why("left").holder == "steer"
        assert robot.resources.why("right").holder is None


@pytest.mark.promise("REA-1")
async def test_a_command_may_be_a_dictionary(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """With one actuator a dictionary without its name is the command itself."""

    class Arm(esair.Reaction):
        radar = esair.reads(float)
        arm = esair.writes(dict)

        def react(self, radar: float) -> dict[str, Any]:
            return {"x": radar} if radar < 2 else {"arm": {"x": 7.0}}

    radar, arm = fake_sensor("radar"), fake_actuator("arm", safe={"x": 0.0})
    async with esair.Robot(resources=[radar, arm], behaviors=[Arm()]):
        for value in (1.0, 2.0):
            radar.feed(value)
            await asyncio.sleep(0.001)
        assert arm.commands == [{"x": 0.0}, {"x": 1.0}, {"x": 7.0}]


@pytest.mark.promise("REA-2")
@pytest.mark.parametrize("wrong", [{"wheel": 1.0, "wheels": 1.0}, {"left": 1.0}, 5.0])
async def test_it_reaches_nothing_outside_its_profile(
    fake_sensor: Any, fake_actuator: Any, wrong: Any
) -> None:
    """A command for another actuator is an error of the reaction, and moves nothing."""

    class Reach(esair.Reaction):
        radar = esair.reads(float)
        restart = esair.Restart(max=0)

        def react(self, radar: float) -> Any:
            return wrong

    class ReachWithOne(Reach):
        wheels = esair.writes(float)

    radar = fake_sensor("radar")
    wheels, left = fake_actuator("wheels", safe=0.0), fake_actuator("left", safe=0.0)
    behaviors = [
        Reach(),
        *([ReachWithOne()] if isinstance(wrong, dict) and "wheels" in wrong else []),
    ]
    async with esair.Robot(
        resources=[radar, wheels, left], behaviors=behaviors
    ) as robot:
        radar.feed(1.0)
        await asyncio.sleep(0.01)
        for behavior in behaviors:
            status = robot.behaviors.query(behavior.name)
            assert status.state is BehaviorState.FAILED
            assert isinstance(status.error, esair.BadValueError)
        assert wheels.commands == left.commands == [0.0]


def test_a_profile_is_given_as_it_is_declared() -> None:
    """The name alone is that of a robot.toml."""
    with pytest.raises(esair.ConfigError, match=r"user: sonar: expected esair.reads"):
        esair.Behavior(name="user", reads={"sonar": "front"})  # type: ignore[dict-item]


def test_a_port_hides_nothing_that_an_action_has() -> None:
    """Its ``put`` would be a port, and its own ``put`` gone."""
    with pytest.raises(esair.ConfigError, match="an action has a 'put' of its own"):
        type("Puts", (esair.Behavior,), {"put": esair.writes(float)})


def test_a_port_with_a_name_that_is_taken_is_told_by_its_own_kind() -> None:
    """What is written, and what guards, is not read under another name."""
    for kind in (esair.reads, esair.writes, esair.guards):
        with pytest.raises(esair.ConfigError, match=rf"say {kind.__name__}\("):
            type("Puts", (esair.Reaction,), {"name": kind(float)})


@pytest.mark.promise("REA-2")
async def test_its_profile_can_be_given_instead_of_declared(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """The same class reads another sensor and writes another actuator."""
    front, arm = fake_sensor("front", 3.0), fake_actuator("arm", safe=0.0)
    copy = Copy(
        name="copy_front",
        reads={"sonar": esair.reads(float, name="front")},
        writes={"wheels": esair.writes(float, name="arm")},
    )

    async with esair.Robot(resources=[front, arm], behaviors=[copy]):
        await arm.until(3.0)


@pytest.mark.promise("REA-3")
@pytest.mark.parametrize("rate", [None, 20.0])
async def test_it_is_parked_while_a_sensor_is_lost(
    fake_sensor: Any, fake_actuator: Any, rate: float | None
) -> None:
    """Its actuator is made safe and given back; it goes on with the next reading."""
    copy = Copy()
    copy.rate = rate
    sonar = fake_sensor("sonar", 1.0)
    wheels = fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[sonar, wheels], behaviors=[copy]) as robot:
        await wheels.until(1.0)
        sonar.unplug()
        await asyncio.sleep(0.01)
        status = robot.behaviors.query("copy")
        assert status.state is BehaviorState.PARKED
        assert "sonar" in status.detail
        assert wheels.commands[-1] == 0.0
        why = robot.resources.why("wheels")
        assert (why.holder, why.until) == ("copy", None)
        assert why.rule.startswith("copy is blind: sonar lost")
        count = len(wheels.commands)
        await asyncio.sleep(1.0)
        assert len(wheels.commands) == count
        sonar.plug()
        await wheels.until(1.0)
        assert robot.behaviors.query("copy").state is BehaviorState.RUNNING


@pytest.mark.promise("REA-3", "SC-3")
@pytest.mark.fault("D14")
@pytest.mark.parametrize("rate", [None, 20.0])
async def test_it_is_parked_when_a_reading_is_too_old(
    fake_sensor: Any, fake_actuator: Any, rate: float | None
) -> None:
    """A sensor that is silent for max_age parks it, though nothing else happens."""
    copy = Copy()
    copy.rate = rate
    radar, wheels = (
        fake_sensor("sonar"),
        fake_actuator("wheels", safe=0.0, command_timeout=9.0),
    )

    async with esair.Robot(resources=[radar, wheels], behaviors=[copy]) as robot:
        for _ in range(2):
            radar.feed(1.0)
            await asyncio.sleep(0.45)
            assert wheels.commands[-1] == 1.0
            await asyncio.sleep(0.2)
            status = robot.behaviors.query("copy")
            assert status.state is BehaviorState.PARKED
            assert "older than 0.5 s" in status.detail
            assert wheels.commands[-1] == 0.0


@pytest.mark.promise("REA-3")
@pytest.mark.fault("L07")
async def test_it_is_parked_while_a_sensor_is_removed(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Another sensor under the same name wakes it up."""
    sonar, wheels = fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Copy()]) as robot:
        await wheels.until(1.0)
        await robot.resources.remove("sonar")
        await asyncio.sleep(0.01)
        assert robot.behaviors.query("copy").state is BehaviorState.PARKED
        assert wheels.commands[-1] == 0.0
        await robot.resources.add(fake_sensor("sonar", 2.0))
        await wheels.until(2.0)


@pytest.mark.promise("REA-3")
async def test_it_waits_for_the_first_reading_of_each_sensor(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Until then it is parked, and says for which it waits."""

    class Both(esair.Reaction):
        front = esair.reads(float, max_age=1.0)
        rear = esair.reads(float, max_age=2.0)
        wheels = esair.writes(float)

        def react(self, front: float, rear: float) -> float:
            return front + rear

    front, rear = fake_sensor("front"), fake_sensor("rear")
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[front, rear, wheels], behaviors=[Both()]
    ) as robot:
        front.feed(1.0)
        await asyncio.sleep(0.01)
        status = robot.behaviors.query("both")
        assert status.state is BehaviorState.PARKED
        assert "no reading of front, rear" in status.detail
        rear.feed(2.0)
        await wheels.until(3.0)
        await asyncio.sleep(1.5)
        assert "front" in robot.behaviors.query("both").detail
        await asyncio.sleep(1.0)
        front.feed(5.0)
        await asyncio.sleep(0.01)
        assert robot.behaviors.query("both").state is BehaviorState.PARKED


@pytest.mark.promise("REA-3")
@pytest.mark.long
async def test_100_hz_do_not_drift(
    fake_actuator: Any, request: pytest.FixtureRequest
) -> None:
    """Thousands of steps are done on their grid; nothing is skipped."""
    seconds = 3600.0 if request.config.getoption("--esair-soak") else 300.0
    times: list[float] = []
    loop = asyncio.get_running_loop()

    class Tick(esair.Reaction):
        rate = 100.0

        def react(self) -> None:
            times.append(loop.time())

    async with esair.Robot(behaviors=[Tick()]) as robot:
        await asyncio.sleep(seconds)
        assert robot.behaviors.query("tick").late == 0

    assert len(times) == pytest.approx(seconds * 100.0, abs=1)
    assert times[-1] - times[0] == pytest.approx((len(times) - 1) * 0.01, abs=1e-6)


@pytest.mark.promise("REA-3")
@pytest.mark.fault("T03")
async def test_late_steps_are_skipped_and_counted(fake_actuator: Any) -> None:
    """After a stall of half a second there is one step, not fifty."""
    times: list[float] = []
    loop: Any = asyncio.get_running_loop()

    class Tick(esair.Reaction):
        rate = 100.0

        def react(self) -> None:
            times.append(loop.time())

    async with esair.Robot(behaviors=[Tick()]) as robot:
        await asyncio.sleep(1.0)
        before = len(times)
        loop.advance(0.5)
        await asyncio.sleep(0.1)
        assert len(times) - before <= 12
        assert robot.behaviors.query("tick").late == pytest.approx(49, abs=1)


@pytest.mark.fault("T02")
@pytest.mark.promise("SC-3")
async def test_after_a_suspend_everything_is_stale_and_safe(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """No step decides on a reading from before; it goes on with the next one."""
    seen: list[float] = []

    class Drive(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)
        rate = 10.0

        def react(self, sonar: float) -> float:
            seen.append(sonar)
            return 1.0

    loop: Any = asyncio.get_running_loop()
    sonar, wheels = fake_sensor("sonar"), fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Drive()]) as robot:
        sonar.feed(7.0)
        await wheels.until(1.0)
        loop.suspend(0.05)  # too short to matter
        await asyncio.sleep(0.15)
        assert robot.behaviors.query("drive").state is BehaviorState.RUNNING
        loop.suspend(60.0)
        steps = len(seen)
        await asyncio.sleep(0.15)
        assert len(seen) == steps
        assert robot.behaviors.query("drive").state is BehaviorState.PARKED
        assert wheels.commands[-1] == 0.0
        sonar.feed(8.0)
        await wheels.until(1.0)
        assert seen[steps] == 8.0


@pytest.mark.promise("REA-1")
async def test_the_newest_command_wins_while_a_driver_waits(fake_sensor: Any) -> None:
    """Steps never wait for a slow driver, and old commands are never sent late."""
    log: list[float] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 5.0

        async def write(self, command: float) -> None:
            if command:
                await asyncio.sleep(0.1)
            log.append(command)

    class Follow(esair.Reaction):
        radar = esair.reads(float)
        slow = esair.writes(float)

        def react(self, radar: float) -> float:
            return radar

    radar = fake_sensor("radar")
    async with esair.Robot(resources=[radar, Slow()], behaviors=[Follow()]) as robot:
        for value in range(1, 10):
            radar.feed(float(value))
            await asyncio.sleep(0.03)
        await asyncio.sleep(0.3)
        assert robot.behaviors.query("follow").steps == 9

    assert log[1:-2] == sorted(log[1:-2])
    assert log[-3] == 9.0
    assert len(log) < 9


@pytest.mark.promise("REA-1")
async def test_what_waited_for_a_safe_command_is_the_newest() -> None:
    """A device that was busy being safe is told nothing that was decided before."""
    told: list[float] = []
    clock = asyncio.get_running_loop().time

    class Busy(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 0.3
        deadline = 5.0

        async def write(self, command: float) -> None:
            told.append(clock() - command if command else math.inf)
            await asyncio.sleep(0.4 if command else 0.7)

    class Hurry(esair.Reaction):
        rate = 20.0
        busy = esair.writes(float)

        def react(self) -> float:
            return clock()

    async with esair.Robot(resources=[Busy()], behaviors=[Hurry()]):
        await asyncio.sleep(5.0)
        assert told[3:] != []
        assert max(age for age in told if age < math.inf) <= 0.06


@pytest.mark.promise("REA-1")
async def test_a_reaction_renews_no_command_but_its_own() -> None:
    """What its performer writes by the same right leaves as it was said."""
    told: list[float] = []
    answers: list[Any] = []

    class Busy(esair.Actuator[float]):
        safe = 0.0
        deadline = 5.0

        async def write(self, command: float) -> None:
            told.append(command)
            await asyncio.sleep(0.3)

    class Cruise(esair.Reaction):
        rate = 20.0
        busy = esair.writes(float)

        def react(self) -> float:
            return 0.25

    class Overtaker(esair.Behavior):
        busy = esair.writes(float)

        async def run(self) -> None:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.perform(Cruise(), timeout=2.0))
                await asyncio.sleep(0.5)  # one of its commands is on its way
                answers.append(await self.busy.write(0.75))

    async with esair.Robot(resources=[Busy()], behaviors=[Overtaker()]):
        await asyncio.sleep(3.0)
    assert [answer.command for answer in answers] == [0.75]
    assert told.count(0.75) == 1


@pytest.mark.promise("REA-1")
@pytest.mark.fault("D23")
async def test_a_failed_write_leaves_no_old_command_behind(fake_sensor: Any) -> None:
    """What waited for a write that failed is dropped, not sent after a newer one."""
    log: list[float] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 5.0

        async def write(self, command: float) -> None:
            if command:
                await asyncio.sleep(0.1)
            if command == 1.0:
                raise ValueError("noise")
            log.append(command)

    class Follow(esair.Reaction):
        radar = esair.reads(float)
        slow = esair.writes(float)

        def react(self, radar: float) -> float:
            return radar

    radar = fake_sensor("radar")
    async with esair.Robot(resources=[radar, Slow()], behaviors=[Follow()]) as robot:
        for value, pause in ((1.0, 0.05), (2.0, 0.15), (3.0, 0.5)):
            radar.feed(value)
            await asyncio.sleep(pause)
        assert robot.journal.counts()["follow"]["rejected"] == 1

    assert log == [0.0, 3.0, 0.0, 0.0]


@pytest.mark.promise("REA-1")
async def test_what_waits_for_a_write_is_given_back_with_the_rest(
    fake_sensor: Any,
) -> None:
    """A command that has not left when the reaction wants nothing any more never does."""
    log: list[float] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 5.0

        async def write(self, command: float) -> None:
            log.append(command)
            if command:
                await asyncio.sleep(0.1)

    class Follow(esair.Reaction):
        radar = esair.reads(float)
        slow = esair.writes(float)

        def react(self, radar: float) -> float | None:
            return None if radar < 0 else radar

    radar = fake_sensor("radar")
    async with esair.Robot(resources=[radar, Slow()], behaviors=[Follow()]):
        for value in (1.0, 2.0, -1.0):
            radar.feed(value)
            await asyncio.sleep(0.03)
        await asyncio.sleep(0.5)
    assert set(log) == {0.0, 1.0}


@pytest.mark.promise("ROB-3")
@pytest.mark.fault("D30")
async def test_one_slow_actuator_does_not_hold_the_other_up(fake_sensor: Any) -> None:
    """Each of a reaction's actuators gets its command when its own driver is ready."""
    log: list[tuple[str, float]] = []

    class Wheel(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 5.0

        async def write(self, command: float) -> None:
            if command:
                await asyncio.sleep(0.9 if self.name == "left" else 0.01)
            log.append((self.name, command))

    class Steer(esair.Reaction):
        radar = esair.reads(float)
        left = esair.writes(float)
        right = esair.writes(float)

        def react(self, radar: float) -> dict[str, float]:
            return {"left": radar, "right": radar}

    radar = fake_sensor("radar")
    wheels = [Wheel(name="left"), Wheel(name="right")]
    async with esair.Robot(resources=[radar, *wheels], behaviors=[Steer()]):
        for value in (1.0, 2.0, 3.0):
            radar.feed(value)
            await asyncio.sleep(0.05)
        assert [c for name, c in log if name == "right"] == [0.0, 1.0, 2.0, 3.0]


class Divide(esair.Reaction):
    """Its command is not finite where its reading is 0."""

    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=10)

    def react(self, sonar: float) -> float:
        return 1.0 / sonar if sonar else math.inf


@pytest.mark.promise("ROB-3")
@pytest.mark.fault("V01")
async def test_a_bad_command_is_rejected_counted_and_logged_once(
    fake_sensor: Any, fake_actuator: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """The reaction goes on; the log does not fill up."""
    radar, wheels = fake_sensor("sonar"), fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[radar, wheels], behaviors=[Divide()]) as robot:
        for _ in range(50):
            radar.feed(0.0)
            await asyncio.sleep(0.001)
        radar.feed(1.0)
        await wheels.until(1.0)
        assert robot.behaviors.query("divide").state is BehaviorState.RUNNING

    lines = [r for r in caplog.records if "rejected" in r.getMessage()]
    assert len(lines) == 1
    assert lines[0].levelno == logging.WARNING


@pytest.mark.promise("ROB-2")
async def test_no_reaction_steps_once_the_robot_stops(
    fake_sensor: Any, fake_actuator: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Nor does one that a behavior performs: its command would only be rejected."""
    radar, wheels = fake_sensor("sonar"), fake_actuator("wheels", safe=0.0)

    class Follow(esair.Behavior):
        async def run(self) -> None:
            await self.perform(Copy())

    async with esair.Robot(resources=[radar, wheels], behaviors=[Follow()]):
        radar.feed(1.0)
        await wheels.until(1.0)
        asyncio.get_running_loop().call_soon(radar.feed, 2.0)

    assert wheels.commands == [0.0, 1.0, 0.0, 0.0]
    assert caplog.records == []


@pytest.mark.promise("ROB-3")
@pytest.mark.fault("B02", "B05")
@pytest.mark.parametrize(
    "error", [ValueError("bug"), SystemExit(1), KeyboardInterrupt()], ids=type
)
async def test_a_reaction_that_raises_is_contained_and_restarted(
    fake_sensor: Any, fake_actuator: Any, error: BaseException
) -> None:
    """Its actuator is made safe; it comes back disarmed; others run on."""

    class Crash(esair.Reaction):
        radar = esair.reads(float)
        wheels = esair.writes(float)
        crashed = False

        def react(self, radar: float) -> float:
            if radar == 2.0 and not self.crashed:
                self.crashed = True
                raise error
            return radar

    radar, wheels = (
        fake_sensor("radar"),
        fake_actuator("wheels", safe=0.0, command_timeout=5.0),
    )
    async with esair.Robot(resources=[radar, wheels], behaviors=[Crash()]) as robot:
        radar.feed(1.0)
        await asyncio.sleep(0.01)
        radar.feed(2.0)
        await asyncio.sleep(0.01)
        assert wheels.commands == [0.0, 1.0, 0.0]
        assert robot.behaviors.query("crash").state is BehaviorState.RESTARTING
        await asyncio.sleep(0.2)
        radar.feed(3.0)
        await asyncio.sleep(0.01)
        assert wheels.commands[-1] == 3.0
        assert robot.behaviors.query("crash").restarts == 1


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"rate": 0}, "rate"),
        ({"rate": "fast"}, "rate"),
        ({"react": None}, "react"),
        ({"react": "async"}, "react"),
        ({"react": lambda self, other: None}, "react"),
        ({"restart": 3}, "restart"),
        ({"sonar": esair.reads(float, max_age=0)}, "sonar.max_age"),
        ({"sonar": esair.reads(float, name="No Name")}, "sonar"),
        ({"wheels": esair.writes(float, hold=-1.0)}, "wheels.hold"),
        ({"wheels": esair.writes(float, priority=True)}, "wheels.priority"),
        ({"sonar": esair.writes(float)}, "react"),
        ({"wheels": esair.reads(float)}, None),
        ({"sonar": esair.reads(str)}, "sonar"),
    ],
)
@pytest.mark.promise("REA-2")
async def test_mistakes_of_a_reaction_stop_the_start(
    fake_sensor: Any, fake_actuator: Any, body: dict[str, Any], field: str | None
) -> None:
    """Each is named before anything is opened."""

    async def later(self: Any, sonar: float) -> None:
        return None

    body = dict(body)
    if "react" in body and body["react"] is None:
        bases: tuple[type, ...] = (esair.Reaction,)
        del body["react"]
        body["sonar"] = esair.reads(float)
    else:
        bases = (Copy,)
        if body.get("react") == "async":
            body["react"] = later
    wrong = type("Wrong", bases, body)
    sonar = fake_sensor("sonar", 1.0, type=float)
    wheels = fake_actuator("wheels", safe=0.0)

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(resources=[sonar, wheels], behaviors=[wrong()]):
            pytest.fail("it started")

    errors = [e for e in caught.value.exceptions if isinstance(e, esair.ConfigError)]
    if field is not None:
        assert field in [error.field for error in errors]
    assert errors
    assert sonar.opened == wheels.opened == 0


async def test_a_reaction_without_sensors_needs_a_rate(fake_actuator: Any) -> None:
    """Nothing would ever make it run."""

    class Blink(esair.Reaction):
        lamp = esair.writes(float)

        def react(self) -> float:
            return 1.0

    with pytest.raises(ExceptionGroup, match="cannot start") as caught:
        async with esair.Robot(
            resources=[fake_actuator("lamp", safe=0.0)], behaviors=[Blink()]
        ):
            pytest.fail("it started")
    assert "needs a rate" in str(caught.value.exceptions[0])


@pytest.mark.promise("REA-3")
async def test_a_stop_leaves_no_write_of_a_reaction_behind(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Neither a poll nor a write that hangs outlives the robot."""
    sonar, wheels = fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Copy()]):
        await wheels.until(1.0)
        wheels.stall()
        await asyncio.sleep(0.15)
        sonar.stall()
        await asyncio.sleep(0.15)
        wheels.resume()
    assert wheels.commands[-1] == 0.0
