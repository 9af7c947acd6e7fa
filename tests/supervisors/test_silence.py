"""A part that says nothing, one that fails for good, one that has restarted."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest

import esair
from esair import ResourceState
from esair.journal import Event, Kind
from esair.messages import Stamped
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Part(esair.Sensor[float]):
    """Answers as its test says: well, wrongly, or not at all."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.error: Exception | None = None
        self.opened = 0

    async def open(self) -> None:
        self.opened += 1
        await self.read()

    async def read(self) -> float:
        if self.error is not None:
            raise self.error
        return 1.0


def silent() -> list[Exception]:
    nack = esair.DeviceFaultError("part", "nobody acknowledges")
    nack.errno = 121
    return [OSError(121, "remote I/O error"), nack, TimeoutError("no answer")]


@pytest.mark.promise("RES-3")
@pytest.mark.parametrize("error", silent(), ids=["system", "bus", "time"])
async def test_silence_spends_no_restarts(error: Exception) -> None:
    """A part without power is LOST for an hour, and there when it has power."""
    part = Part(rate=20.0)
    user: Any = esair.Behavior(name="user", reads={"part": esair.reads(float)})
    async with esair.Robot(resources=[part], behaviors=[user]) as robot:
        assert await user.part.read() == 1.0
        part.error = error
        for _ in range(4):
            with pytest.raises((OSError, TimeoutError)):
                await user.part.read(fresh=True)
        await asyncio.sleep(3600.0)
        assert robot.resources.query("part").state is ResourceState.LOST
        part.error = None
        await asyncio.sleep(5.1)
        assert await user.part.read() == 1.0


async def failed(robot: esair.Robot, part: Part) -> None:
    part.error = ValueError("checksum")
    part.report_lost(ValueError("checksum"))
    await asyncio.sleep(60.0)
    assert robot.resources.query("part").state is ResourceState.FAILED


@pytest.mark.promise("RES-3")
async def test_a_replug_leaves_failed() -> None:
    """Its restarts begin anew."""
    part = Part()
    async with esair.Robot(resources=[part]) as robot:
        await failed(robot, part)
        part.error = None
        part.report_arrived()
        await asyncio.sleep(0.1)
        assert robot.resources.query("part").state is ResourceState.READY
        await failed(robot, part)


@pytest.mark.promise("RES-3", "TURN-5")
async def test_failed_is_one_event_with_its_cause() -> None:
    """Whoever listens to the journal hears of it once, after all restarts."""
    part, heard = Part(), list[Event]()
    async with esair.Robot(resources=[part]) as robot:
        robot.journal.listen(heard.append)
        await failed(robot, part)
        await asyncio.sleep(60.0)
    (event,) = [each for each in heard if each.kind is Kind.FAILED]
    assert event.component == "part"
    assert "checksum" in event.text


@pytest.mark.promise("RES-3")
async def test_a_limit_of_a_call_is_judged_by_what_its_own_port_declares() -> None:
    """That another port allows less is no excuse: what was asked for is its own fault."""

    class Hasty(esair.Behavior):
        sonar = esair.reads(float, max_age=2.0)
        bumper = esair.reads(float, max_age=0.3)
        restart = esair.Restart(max=0)

        async def run(self) -> None:
            await asyncio.sleep(1.5)
            await self.sonar.read(max_age=0.7, timeout=0.1)

    sonar: FakeSensor[float] = FakeSensor("sonar", type=float)
    bumper = FakeSensor("bumper", 0.0)
    async with esair.Robot(resources=[sonar, bumper], behaviors=[Hasty()]) as robot:
        sonar.feed(0.5)
        await asyncio.sleep(3.0)
        assert robot.behaviors.query("hasty").state is esair.BehaviorState.FAILED


@pytest.mark.promise("RES-3")
@pytest.mark.parametrize("state", list("RLF"), ids=["ready", "lost", "failed"])
async def test_the_user_restarts_a_device_in_any_state(state: str) -> None:
    """It is closed and opened again, and tried once when the call returns."""
    part = Part()
    async with esair.Robot(resources=[part]) as robot:
        if state == "F":
            await failed(robot, part)
        elif state == "L":
            part.error = ConnectionError("cable")
            part.report_lost()
            await asyncio.sleep(30.0)
        part.error = None
        for opened in range(part.opened, part.opened + 4):
            began = asyncio.get_running_loop().time()
            await robot.resources.restart("part")
            assert part.opened == opened + 1
            assert asyncio.get_running_loop().time() - began < 0.2
        assert robot.resources.query("part").state is ResourceState.READY
        with pytest.raises(esair.UnknownNameError):
            await robot.resources.restart("nobody")


@pytest.mark.promise("RES-4")
async def test_a_power_cycle_is_noticed_set_up_again_and_disarmed(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The device is told safe, whoever wrote; one line says what has happened."""
    caplog.set_level(logging.INFO, "esair")
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=10.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0)
        wheels.power_cycle()
        await asyncio.sleep(1.5)
        assert wheels.opened == 2
        assert wheels.commands == [0.0, 1.0, 0.0]
        assert robot.resources.why("wheels").holder is None
        assert robot.resources.query("wheels").state is ResourceState.READY
        assert await user.wheels.write(2.0)
        await asyncio.sleep(5.0)
        assert wheels.opened == 2
    lines = [
        r.getMessage() for r in caplog.records if "set-up is gone" in r.getMessage()
    ]
    assert len(lines) == 1


@pytest.mark.promise("RES-4", "CALL-3")
async def test_a_device_is_asked_for_its_set_up_between_its_calls() -> None:
    """Never while it answers another one; and soon after it was silent."""
    busy = most = asked = 0

    class Slow(esair.Sensor[float]):
        deadline = 0.05
        takes = 0.04

        async def call(self, seconds: float) -> None:
            nonlocal busy, most
            busy += 1
            most = max(most, busy)
            try:
                await asyncio.sleep(seconds)
            finally:
                busy -= 1

        async def read(self) -> float:
            await self.call(self.takes)
            return 1.0

        async def is_set_up(self) -> bool:
            nonlocal asked
            asked += 1
            await self.call(0.02)
            return True

    slow = Slow(rate=20.0)
    user: Any = esair.Behavior(name="user", reads={"slow": esair.reads(float)})
    async with esair.Robot(resources=[slow], behaviors=[user]):

        async def follow() -> None:
            async for _ in user.slow:
                pass

        following = asyncio.create_task(follow())
        await asyncio.sleep(5.0)
        assert (most, asked) == (1, 4)
        slow.takes = 0.2
        await asyncio.sleep(0.25)
        assert most == 1
        assert asked == 6  # when it was silent, and when it was so again
        following.cancel()


class Lamp(FakeActuator[float]):
    """Says at once, after a while, or not at all whether it is set up."""

    set_up_period = 0.5
    says: Any = True
    takes = 0.0

    def is_set_up(self) -> Any:
        return self._says() if self.takes else self._now()

    def _now(self) -> bool:
        if isinstance(self.says, Exception):
            raise self.says
        return bool(self.says)

    async def _says(self) -> bool:
        await asyncio.sleep(self.takes)
        return self._now()

    blocking = False


class Eye(FakeSensor[float]):
    """The same of a sensor."""

    set_up_period, says, takes, blocking = 0.5, Lamp.says, Lamp.takes, False
    is_set_up, _now, _says = Lamp.is_set_up, Lamp._now, Lamp._says  # type: ignore[assignment]


@pytest.mark.promise("ROB-4", "RES-4")
async def test_what_is_safe_does_not_wait_until_a_set_up_is_told() -> None:
    """Which may take as long as the part is silent, and moves nothing."""
    lamp = Lamp("lamp", safe=0.0)
    lamp.takes = 0.2
    user: Any = esair.Behavior(name="user", writes={"lamp": esair.writes(float)})
    async with esair.Robot(resources=[lamp], behaviors=[user]) as robot:
        await asyncio.sleep(0.45)
        assert await user.lamp.write(1.0)
        await asyncio.sleep(0.1)
        robot.halt("a test")
        await lamp.until(0.0, timeout=0.01)


@pytest.mark.promise("RES-4", "CALL-3")
@pytest.mark.parametrize("takes", [0.0, 0.2])
@pytest.mark.parametrize("make", [Lamp, Eye])
async def test_a_device_tells_of_its_set_up_at_once_or_after_a_while(
    make: Any, takes: float
) -> None:
    """What is asked of it meanwhile has its turn afterwards; its faults count."""
    part = make("part", 1.0)
    part.takes = takes
    user: Any = esair.Behavior(
        name="user",
        reads={"part": esair.reads(float)} if make is Eye else {},
        writes={"part": esair.writes(float)} if make is Lamp else {},
    )

    async def use() -> object:
        if make is Lamp:
            return await user.part.write(1.0)
        return await user.part.read(fresh=True)

    async with esair.Robot(resources=[part], behaviors=[user]) as robot:
        began = asyncio.get_running_loop().time()
        await asyncio.sleep(0.55)
        assert await use()
        took = asyncio.get_running_loop().time() - began
        assert took == pytest.approx(0.5 + takes if takes else 0.55)
        part.says = ValueError("checksum")
        await asyncio.sleep(1.0)
        assert robot.resources.query("part").faults >= 1
        assert robot.resources.query("part").state is ResourceState.READY
        part.says = False
        await asyncio.sleep(1.0)
        assert robot.resources.query("part").losses >= 1
        part.says = True
        await asyncio.sleep(0.1)
        assert await use()


@pytest.mark.promise("RES-4")
async def test_a_sensor_that_restarts_is_opened_again() -> None:
    """Its readings from before are gone with it."""
    sonar = FakeSensor("sonar", 1.0)
    user: Any = esair.Behavior(name="user", reads={"sonar": esair.reads(float)})
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        assert await user.sonar.read() == 1.0
        sonar.power_cycle()
        await asyncio.sleep(1.3)
        assert (sonar.opened, sonar.has_power_cycled) == (2, False)


@pytest.mark.fault("D25")
async def test_errors_that_cause_each_other_do_not_hold_the_loop() -> None:
    """Found by torture: whoever looked for the first cause never came to an end."""
    part = Part(name="part")
    part.error = error = esair.DeviceFaultError("part", "injected")
    error.__cause__ = ValueError("another one")
    error.__cause__.__cause__ = error
    async with esair.Robot(resources=[part]) as robot:
        assert robot.resources.query("part").state is not ResourceState.READY


@pytest.mark.fault("R12")
async def test_a_change_that_failed_does_not_cause_itself() -> None:
    """The error of the driver is told as it is."""

    class Stubborn(Part):
        async def apply(self, **changes: Any) -> None:
            raise esair.DeviceFaultError("part", "injected")

    class Changes(esair.Behavior):
        part = esair.reads(float, configure=True)

    changes = Changes()
    async with esair.Robot(resources=[Stubborn(name="part")], behaviors=[changes]):
        with pytest.raises(esair.DeviceFaultError) as raised:
            await changes.part.configure(rate=20.0)
    assert raised.value.__cause__ is not raised.value


@pytest.mark.promise("RES-4")
async def test_each_restart_of_a_device_is_answered_soon() -> None:
    """It is there, whatever it has forgotten: nobody waits ever longer for it."""
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        for number in range(6):
            assert wheels.opened == number + 1
            wheels.power_cycle()
            await asyncio.sleep(wheels.set_up_period + 0.2)
            assert robot.resources.query("wheels").state is ResourceState.READY


@pytest.mark.parametrize("ago", [0.0, 0.2])
async def test_a_device_is_silent_that_says_nothing_after_a_question(
    ago: float,
) -> None:
    """Also where its last reading came in the very moment of that."""
    sonar = FakeSensor("sonar", 1.0, type=float, rate=1.0)
    user: Any = esair.Behavior(name="user", reads={"sonar": esair.reads(float)})
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        await asyncio.sleep(1.0)
        await user.sonar.read(fresh=True)
        await asyncio.sleep(ago)
        sonar.stall()
        with pytest.raises(esair.StaleReadingError, match="did not answer in") as told:
            await user.sonar.read(fresh=True, timeout=0.5)
        assert told.value.age == pytest.approx(ago + 0.5)


async def test_a_device_that_answers_with_what_is_old_is_not_silent() -> None:
    """It has said something since: only that was measured too early."""

    class Slow(esair.Sensor[float]):
        rate = 10.0

        async def read(self) -> Any:
            return Stamped(1.0, asyncio.get_running_loop().time() - 60.0)

    user: Any = esair.Behavior(name="user", reads={"slow": esair.reads(float)})
    async with esair.Robot(resources=[Slow()], behaviors=[user]):
        with pytest.raises(esair.StaleReadingError) as raised:
            await user.slow.read(fresh=True, timeout=0.5)
        assert "did not answer" not in str(raised.value)


@pytest.mark.promise("RES-3")
async def test_an_old_silence_is_no_excuse(fake_sensor: Any) -> None:
    """Its sensor has spoken since: what a behavior fails at later is its own fault."""

    class Slow(esair.Behavior):
        sonar = esair.reads(float, max_age=1.5)

        async def run(self) -> None:
            await asyncio.sleep(3.07)
            raise esair.StaleReadingError("sonar", 2.0, 1.5)

    class Other(esair.Behavior):
        sonar = esair.reads(float)

        async def run(self) -> None:
            async for _ in self.sonar:
                pass

    sonar = fake_sensor("sonar", 1.0, rate=20.0)
    async with esair.Robot(resources=[sonar], behaviors=[Slow(), Other()]) as robot:
        await asyncio.sleep(3.1)
        assert robot.behaviors.query("slow").state is esair.BehaviorState.RESTARTING


@pytest.mark.promise("BUS-5")
async def test_calls_that_got_no_turn_are_counted_and_are_no_fault() -> None:
    """Nobody has asked the device."""
    part = Part(rate=20.0)
    user: Any = esair.Behavior(name="user", reads={"part": esair.reads(float)})
    async with esair.Robot(resources=[part], behaviors=[user]) as robot:
        part.error = esair.NoTurnError("part", "read", 0.5)
        for _ in range(4):
            with pytest.raises(esair.NoTurnError):
                await user.part.read(fresh=True)
        status = robot.resources.query("part")
        assert (status.state, status.faults) == (ResourceState.READY, 0)
        assert robot.journal.counts()["part"]["no_turns"] == 4


@pytest.mark.promise("RES-3")
async def test_a_silence_that_was_over_by_another_opening_disturbs_no_restart() -> None:
    """When its sensor speaks at last, a behavior that has failed since is begun anew."""

    class Reads(esair.Behavior):
        sonar = esair.reads(float, max_age=0.5)
        restart = esair.Restart(delay=1.0)
        runs = 0

        async def run(self) -> None:
            self.runs += 1
            if self.runs == 1:
                await self.sonar.read(timeout=1.0)
            if self.runs == 2:
                raise ValueError("its own mistake")
            await asyncio.sleep(1e6)

    reads = Reads()
    sonar: FakeSensor[float] = FakeSensor("sonar", type=float)
    async with esair.Robot(resources=[sonar], behaviors=[reads]) as robot:
        await asyncio.sleep(1.2)
        assert robot.behaviors.query("reads").detail == "sonar is silent"
        sonar.unplug()
        await asyncio.sleep(0.1)
        sonar.plug()
        await asyncio.sleep(0.5)
        state = robot.behaviors.query("reads").state
        assert (reads.runs, state) == (2, esair.BehaviorState.RESTARTING)
        sonar.feed(1.0)
        await asyncio.sleep(2.0)
        assert reads.runs == 3
