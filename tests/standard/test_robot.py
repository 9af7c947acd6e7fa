"""The robot: start, stop, and the order of both."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

import esair
from esair import BehaviorState, SupervisorPhase

pytestmark = pytest.mark.virtual_clock


class Drive(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(1.0)


class Ordered(esair.Actuator[float]):
    """An actuator that notes what happens to it."""

    safe = 0.0

    def __init__(self, log: list[str], **options: Any) -> None:
        super().__init__(**options)
        self.log = log

    async def open(self) -> None:
        self.log.append("open device")

    async def close(self) -> None:
        self.log.append("close device")

    async def write(self, command: float) -> None:
        self.log.append(f"write {command}")


@pytest.mark.promise("ROB-1", "ROB-2")
async def test_start_order_and_its_exact_reverse() -> None:
    """Bus, device, safe command, behavior; then behavior, safe command, device, bus."""
    log: list[str] = []

    class Wire(FakeWire):
        async def open(self) -> None:
            log.append("open bus")

        async def close(self) -> None:
            log.append("close bus")

    class Moves(esair.Behavior):
        ordered = esair.writes(float)

        async def setup(self) -> None:
            log.append("setup")

        async def run(self) -> None:
            await self.ordered.write(1.0)
            await asyncio.sleep(100)

        async def teardown(self) -> None:
            log.append("teardown")

    async with esair.Robot(
        resources=[Ordered(log, bus=Wire("wire"))], behaviors=[Moves()]
    ) as robot:
        assert robot.resources.phase is SupervisorPhase.WAIT_REQUEST
        assert robot.behaviors.phase is SupervisorPhase.WAIT_REQUEST
        await asyncio.sleep(0.01)

    while "open bus" in log:
        log.remove("open bus")
    assert log[:4] == ["open device", "write 0.0", "setup", "write 1.0"]
    assert sorted(log[4:6]) == ["teardown", "write 0.0"]
    assert log[6:9] == ["write 0.0", "close device", "close bus"]
    phases = {robot.resources.phase, robot.behaviors.phase}
    assert phases == {SupervisorPhase.STOPPED}


class FakeWire:
    """The least that a bus must be."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.executor: Any = None

    def on_lost(self, listener: Any) -> Any:
        return lambda: None

    def on_arrival(self, listener: Any) -> Any:
        return lambda: None


@pytest.mark.promise("ROB-1", "ROB-2")
@pytest.mark.parametrize("how", ["end", "error", "cancel", "exit", "interrupt"])
async def test_every_way_out_ends_with_the_safe_command(
    fake_actuator: Any, how: str
) -> None:
    """The end, an exception, a cancellation, SystemExit and KeyboardInterrupt."""
    wheels = fake_actuator("wheels", safe=0.0)
    robot = esair.Robot(resources=[wheels], behaviors=[Drive()])

    async def live() -> None:
        async with robot:
            await wheels.until(1.0)
            if how == "error":
                raise ValueError("bug")
            if how == "cancel":
                await asyncio.sleep(100)
            if how == "exit":
                raise SystemExit(3)
            if how == "interrupt":
                raise KeyboardInterrupt

    if how in {"exit", "interrupt"}:
        with pytest.raises((SystemExit, KeyboardInterrupt)):
            await live()
    else:
        living = asyncio.create_task(live())
        await asyncio.sleep(0.2)
        living.cancel()
        await asyncio.wait({living})
        assert living.cancelled() is (how == "cancel")

    assert wheels.commands[-1] == 0.0
    assert not wheels.is_open
    assert [(told.safe, told.answered) for told in robot.stopped] == [(True, True)]


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("X03", "X06")
@pytest.mark.parametrize("after", [0.0, 0.001, 0.5, 1.0])
async def test_a_second_cancellation_does_not_break_the_stop(
    fake_actuator: Any, after: float
) -> None:
    """The stop runs in a task of its own; whoever cancels again only hurries it."""
    wheels = fake_actuator("wheels", safe=0.0)

    class Slow(Drive):
        async def teardown(self) -> None:
            await asyncio.sleep(0.8)

    async def live() -> None:
        async with esair.Robot(resources=[wheels], behaviors=[Slow()]):
            await asyncio.sleep(100)

    living = asyncio.create_task(live())
    await asyncio.sleep(0.2)
    living.cancel()
    await asyncio.sleep(after)
    living.cancel()
    await asyncio.wait({living})

    assert living.cancelled()
    assert wheels.commands[-1] == 0.0
    assert not wheels.is_open


@pytest.mark.promise("ROB-3")
@pytest.mark.fault("B02", "B05", "B15")
@pytest.mark.parametrize(
    "error",
    [
        ValueError("bug"),
        SystemExit(1),
        KeyboardInterrupt(),
        RecursionError(),
        MemoryError(),
    ],
    ids=lambda error: type(error).__name__,
)
async def test_one_components_failure_takes_nobody_down(
    fake_actuator: Any, error: BaseException
) -> None:
    """Whatever a behavior raises, its neighbour misses no beat."""
    wheels = fake_actuator("wheels", safe=0.0)

    class Crash(esair.Behavior):
        async def run(self) -> None:
            await asyncio.sleep(0.1)
            raise error

    async with esair.Robot(resources=[wheels], behaviors=[Crash(), Drive()]) as robot:
        await asyncio.sleep(20.0)
        assert robot.behaviors.query("crash").state is BehaviorState.FAILED
        assert robot.behaviors.query("drive").restarts == 0
        assert len(wheels.commands) == pytest.approx(401, abs=2)


@pytest.mark.promise("ROB-1")
async def test_every_mistake_is_reported_at_once_before_anything_opens(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Names, types, rights and missing safe commands come in one group."""
    sonar, bare = fake_sensor("sonar", 1.0, type=str), fake_actuator("bare")

    class Wrong(esair.Behavior):
        sonar = esair.reads(float)
        whels = esair.writes(float)
        inbox_size = 0
        outbox_policy = "perhaps"  # type: ignore[assignment]

    class WrongToo(esair.Behavior):
        sonar = esair.reads(float)
        bares = esair.writes(float)

    robot = esair.Robot(
        resources=[sonar, fake_sensor("sonar", "2", type=str), bare, "lamp"],  # type: ignore[list-item]
        behaviors=[Wrong(), WrongToo(), WrongToo(), "walk"],  # type: ignore[list-item]
        policies=["sonar", esair.Policy("sonra"), esair.Policy("sonar")],  # type: ignore[list-item]
    )
    with pytest.raises(ExceptionGroup) as caught:
        async with robot:
            pytest.fail("it started")

    text = "\n".join(map(str, caught.value.exceptions))
    for part in ("'sonar' is already there", "bare: safe", "inbox_size", "outbox_policy",
                 "lamp", "walk", "wrong_too: bares: no resource", "did you mean 'bare'",
                 "it reads float, but 'sonar' gives str", "'wrong_too' is already there",
                 "policies: expected an esair.Policy", "did you mean 'sonar'",
                 "'wrong_too' may not READ 'sonar'"):  # fmt: skip
        assert part in text, part
    assert sonar.opened == bare.opened == 0


@pytest.mark.promise("ROB-1", "ROB-3")
async def test_a_component_is_in_one_robot_at_a_time(fake_actuator: Any) -> None:
    """Two robots that hold one device, or one behavior, would fight over it."""
    wheels, drive = fake_actuator("wheels", safe=0.0), Drive()
    still = esair.Behavior(name="still")
    async with esair.Robot(resources=[wheels], behaviors=[drive, still]):
        other = esair.Robot(
            resources=[wheels, fake_actuator("arm", safe=0.0)], behaviors=[drive]
        )
        with pytest.raises(ExceptionGroup) as caught:
            await other.__aenter__()
        assert [str(e).split(":")[0] for e in caught.value.exceptions] == [
            "wheels",
            "drive",
        ]
        async with esair.Robot(resources=[fake_actuator("arm", safe=0.0)]) as third:
            with pytest.raises(esair.ConfigError, match="in a running robot already"):
                await third.resources.add(wheels)
            with pytest.raises(esair.ConfigError, match="in a running robot already"):
                await third.resources.replace("arm", wheels)
            with pytest.raises(esair.ConfigError, match="in a running robot already"):
                await third.behaviors.add(still)
            await third.behaviors.add(esair.Behavior(name="other"))
            with pytest.raises(esair.ConfigError, match="in a running robot already"):
                await third.behaviors.replace("other", still)
        assert (wheels.name, still.name) == ("wheels", "still")
        await wheels.until(1.0)

    async with esair.Robot(resources=[wheels], behaviors=[drive]):
        await wheels.until(1.0)  # one after the other is fine


@pytest.mark.promise("SUP-1")
async def test_commands_wait_from_the_beginning_of_the_start() -> None:
    """Before it nobody would ever see to them: they are refused."""

    class Slow(esair.Sensor[float]):
        async def open(self) -> None:
            await asyncio.sleep(0.5)

        async def read(self) -> float:
            return 1.0

    robot = esair.Robot(resources=[Slow()])
    for early in (robot.behaviors.remove("drive"), robot.resources.remove("slow")):
        with pytest.raises(esair.StoppingError, match="enter the robot first"):
            await early

    adding = asyncio.create_task(robot.behaviors.add(esair.Behavior(name="added")))
    async with robot:
        await adding
        assert robot.behaviors.query("added").state is BehaviorState.RUNNING


def test_only_a_robot_is_run() -> None:
    """Anything else is refused by name, before a loop is made."""
    with pytest.raises(esair.ConfigError, match=r"an esair\.Robot, not 'rover'"):
        esair.run("rover")  # type: ignore[arg-type]


async def test_a_robot_is_not_run_in_a_running_loop() -> None:
    """The error says what to write there, and no coroutine is left that nobody awaits."""
    with pytest.raises(esair.ConfigError, match="async with robot"):
        esair.run(esair.Robot())


@pytest.mark.promise("ROB-1")
async def test_a_robot_is_used_once(fake_sensor: Any) -> None:
    """A robot that has stopped is not started again; make another one."""
    robot = esair.Robot(resources=[fake_sensor("sonar", 1.0)])
    async with robot:
        pass
    with pytest.raises(esair.StoppingError, match="make another one"):
        await robot.__aenter__()


@pytest.mark.parametrize("grace", [0, -1, math.nan, math.inf, True, "long"])
def test_the_grace_is_a_number_of_seconds(grace: Any) -> None:
    """Anything else is refused by the constructor."""
    with pytest.raises(esair.ConfigError, match="grace"):
        esair.Robot(grace=grace)


@pytest.mark.parametrize(
    "name", ["", "Rover", "1rover", "my rover", "r" * 64, None, "röver"]
)
@pytest.mark.fault("L02")
def test_a_robots_name_is_a_name(name: Any) -> None:
    """Lower-case letters, digits and underscores."""
    with pytest.raises(esair.ConfigError, match="name"):
        esair.Robot(name=name)


@pytest.mark.promise("ROB-1")
async def test_ended_raises_what_has_failed_for_good(fake_actuator: Any) -> None:
    """A robot whose behaviors have ended has ended; a failure is not silent."""

    class Crash(esair.Behavior):
        restart = esair.Restart(max=0)

        async def run(self) -> None:
            raise ValueError("bug")

    class Done(esair.Behavior):
        async def run(self) -> None:
            return None

    async with esair.Robot(behaviors=[Done()]) as robot:
        await robot.ended()
    async with esair.Robot(behaviors=[Done(), Crash()]) as robot:
        with pytest.raises(esair.BehaviorFailedError, match="crash") as caught:
            await robot.ended()
        assert isinstance(caught.value.__cause__, ValueError)


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("T02")
async def test_the_wheels_watch_forgets_a_stopped_robot(fake_actuator: Any) -> None:
    """A suspend after the stop reaches nobody."""
    wheels = fake_actuator("wheels", safe=0.0)
    loop: Any = asyncio.get_running_loop()

    async with esair.Robot(resources=[wheels], behaviors=[Drive()]):
        await asyncio.sleep(0.1)
    count = len(wheels.commands)
    loop.suspend(5.0)
    async for tick in esair.every(0.1):
        if tick > 0.3:
            break
    assert len(wheels.commands) == count


@pytest.mark.fault("T01", "T05")
@pytest.mark.parametrize("start", [0.0, 10 * 365 * 86400.0])
async def test_only_monotonic_time_decides(
    fake_actuator: Any, monkeypatch: pytest.MonkeyPatch, start: float
) -> None:
    """Wall time may jump, and the clock may be ten years old: beats stay exact."""
    import time

    monkeypatch.setattr(time, "time", lambda: -1e9)
    loop: Any = asyncio.get_running_loop()
    loop.advance(start)
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Drive()]):
        await asyncio.sleep(10.0)
        assert len(wheels.commands) == pytest.approx(201, abs=2)


@pytest.mark.parametrize("field", ["operator", "page", "record"])
def test_what_is_none_of_its_kind_is_named(field: str) -> None:
    """With the field, and what was expected."""
    with pytest.raises(esair.ConfigError, match=f"{field}: expected .*not True"):
        esair.Robot(**{field: True})  # type: ignore[arg-type]


@pytest.mark.promise("ROB-2", "ROB-6", "SUP-3")
@pytest.mark.parametrize("is_halted", [False, True])
@pytest.mark.parametrize("deadline", [1.0, 2.0, 3.0, 60.0])
async def test_what_hangs_is_reported_before_the_time_of_the_stop_is_over(
    fake_actuator: Any, deadline: float, is_halted: bool
) -> None:
    """The stop is one deadline: that of a driver does not make it any longer."""
    wheels, slow = fake_actuator("wheels", safe=0.0), fake_actuator("slow", safe=0.0)
    slow.deadline = deadline

    class Both(Drive):
        slow = esair.writes(float)

        async def run(self) -> None:
            async for _ in esair.every(0.05):
                await self.wheels.write(1.0)
                if slow.commands[-1] == 0.0:
                    await self.slow.write(1.0)
                    slow.stall()

    robot = esair.Robot(resources=[wheels, slow], behaviors=[Both()])
    async with robot:
        await wheels.until(1.0)
        await asyncio.sleep(0.1)
        if is_halted:
            robot.halt("a look at it")
        began = asyncio.get_running_loop().time()
    took = asyncio.get_running_loop().time() - began
    assert took <= robot.grace + 2.0
    answered = {told.resource: told.answered for told in robot.stopped}
    assert answered == {"wheels": True, "slow": False}
