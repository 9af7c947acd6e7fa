"""The life of a resource: opened, lost, opened again, closed."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import itertools
import logging
import threading
from typing import Any

import pytest
from tests.patience import within

import esair
from esair import ResourceState
from esair.loop import COMMAND, OPENING, SAFE, urgency
from esair.testing import FakeActuator

pytestmark = pytest.mark.virtual_clock


def reader() -> Any:
    return esair.Behavior(name="user", reads={"sonar": esair.reads(float)})


@pytest.mark.promise("RES-2")
@pytest.mark.fault("D01", "D03")
async def test_a_lost_device_is_told_at_once_and_comes_back(
    fake_sensor: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """One log line down, one line up; its registrations go on."""
    caplog.set_level(logging.INFO, "esair")
    sonar, user = fake_sensor("sonar", 1.0), reader()

    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        assert await user.sonar.read() == 1.0
        right = user.sonar.registration
        sonar.unplug()
        await asyncio.sleep(0)  # it takes effect at the border of the turn
        assert robot.resources.query("sonar").state is ResourceState.LOST
        with pytest.raises(esair.DeviceLostError):
            await user.sonar.read()
        await asyncio.sleep(20.0)
        sonar.plug()
        await asyncio.sleep(0.2)
        assert await user.sonar.read() == 1.0
        assert user.sonar.registration is right
        status = robot.resources.query("sonar")
        assert (status.state, status.losses, status.error) == (
            ResourceState.READY,
            1,
            None,
        )

    lines = [
        r.getMessage() for r in caplog.records if r.getMessage().startswith("sonar")
    ]
    assert len(lines) == 2
    assert "lost" in lines[0]
    assert "back" in lines[1]


@pytest.mark.promise("RES-2")
async def test_a_device_that_is_not_there_at_the_start_comes_when_it_comes(
    fake_sensor: Any,
) -> None:
    """The robot starts; the device is LOST, and opened when it is plugged in."""
    sonar = fake_sensor("sonar", 1.0)
    sonar.unplug()

    async with esair.Robot(resources=[sonar]) as robot:
        assert robot.resources.query("sonar").state is ResourceState.LOST
        await asyncio.sleep(5.0)
        sonar.plug()
        await asyncio.sleep(0.15)
        assert robot.resources.query("sonar").state is ResourceState.READY


@pytest.mark.promise("RES-2")
@pytest.mark.fault("G06")
async def test_a_required_device_that_is_not_there_refuses_the_start(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """The error names it, and everything that was opened is closed, and safe."""
    sonar = fake_sensor("sonar", 1.0, required=True)
    wheels = fake_actuator("wheels", safe=0.0)
    sonar.unplug()

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(resources=[wheels, sonar]):
            pytest.fail("it started")

    assert [type(e) for e in caught.value.exceptions] == [esair.DeviceLostError]
    assert not wheels.is_open
    assert wheels.commands == [0.0, 0.0]


@pytest.mark.promise("RES-2")
async def test_lost_devices_are_tried_with_growing_delay() -> None:
    """0.1, 0.2, 0.4, ... 5 s between the tries."""
    tries: list[float] = []

    class Sonar(esair.Sensor[float]):
        async def open(self) -> None:
            tries.append(asyncio.get_running_loop().time())
            raise ConnectionError("nobody there")

        async def read(self) -> float:
            return 1.0

    async with esair.Robot(resources=[Sonar()]):
        await asyncio.sleep(20.0)

    pauses = [round(b - a, 3) for a, b in itertools.pairwise(tries)]
    assert pauses == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]


@pytest.mark.promise("RES-2")
@pytest.mark.fault("D04", "R13")
async def test_it_comes_back_disarmed_with_its_last_settings() -> None:
    """Settings first, then the safe command; the old set-point is not sent."""
    log: list[object] = []

    class Arm(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 10.0
        gain = esair.setting(1, min=0)

        async def open(self) -> None:
            log.append("open")

        async def close(self) -> None:
            log.append("close")

        async def apply(self, **changes: Any) -> None:
            log.append(changes)

        async def write(self, command: float) -> None:
            log.append(command)

    arm = Arm(gain=2)
    user = esair.Behavior(
        name="user", writes={"arm": esair.writes(float, configure=True)}
    )
    async with esair.Robot(resources=[arm], behaviors=[user]) as robot:
        await user.arm.configure(gain=3)  # type: ignore[attr-defined]
        await user.arm.write(1.0)  # type: ignore[attr-defined]
        arm.report_lost(ConnectionError("cable"))
        await asyncio.sleep(1.0)
        assert robot.resources.why("arm").holder is None
        assert log == [
            "open", {"gain": 2}, 0.0, {"gain": 3}, 1.0,
            "close", "open", {"gain": 3}, 0.0,
        ]  # fmt: skip


@pytest.mark.fault("D03")
@pytest.mark.parametrize("opening", [1, 2, 3])
async def test_a_loss_reported_while_it_is_opened_is_not_forgotten(
    opening: int,
) -> None:
    """A device that goes away during its opening is not READY for ever."""

    class Sonar(esair.Sensor[float]):
        opened = 0

        async def open(self) -> None:
            self.opened += 1
            if self.opened < opening:
                raise ConnectionError("not there yet")
            if self.opened == opening:
                self.report_lost()
                await asyncio.sleep(0.001)

        async def read(self) -> float:
            return 1.0

    sonar = Sonar()
    async with esair.Robot(resources=[sonar]) as robot:
        assert robot.resources.query("sonar").state is ResourceState.LOST
        await asyncio.sleep(2.0)
        assert sonar.opened == opening + 1
        assert robot.resources.query("sonar").state is ResourceState.READY


@pytest.mark.promise("RES-2")
@pytest.mark.fault("D19")
async def test_an_arrival_reported_while_it_is_closed_is_not_forgotten() -> None:
    """It is opened again soon after, though the delay would be long; never before."""
    log: list[tuple[str, float]] = []

    class Sonar(esair.Sensor[float]):
        gone = True

        def note(self, what: str) -> None:
            log.append((what, asyncio.get_running_loop().time()))

        async def open(self) -> None:
            self.note("open")
            if self.gone:
                raise ConnectionError("not there")

        async def close(self) -> None:
            await asyncio.sleep(0.5)
            self.note("closed")

        async def read(self) -> float:
            return 1.0

    sonar = Sonar()
    async with esair.Robot(resources=[sonar]) as robot:
        await asyncio.sleep(16.0)  # the delay is 5 s by now
        last = [time for what, time in log if what == "open"][-1]
        await asyncio.sleep(last + 5.7 - asyncio.get_running_loop().time() - 0.5)
        sonar.gone = False
        sonar.report_arrived()
        await asyncio.sleep(0.8)
        assert robot.resources.query("sonar").state is ResourceState.READY
    whats = [what for what, _ in log]
    assert all(a != b for a, b in itertools.pairwise(whats))


@pytest.mark.promise("RES-2")
@pytest.mark.fault("D19")
async def test_an_arrival_reported_while_it_is_opened_is_not_forgotten() -> None:
    """The opening that was on its way fails; the next one does not wait for long."""
    tries: list[float] = []
    arrives = 16.0

    class Sonar(esair.Sensor[float]):
        async def open(self) -> None:
            now = asyncio.get_running_loop().time()
            tries.append(now)
            await asyncio.sleep(0.3)
            if now > arrives:
                self.report_arrived()
            raise ConnectionError("it answers nothing yet")

        async def read(self) -> float:
            return 1.0

    arrives += asyncio.get_running_loop().time()
    async with esair.Robot(resources=[Sonar()]):
        await asyncio.sleep(30.0)
    late = [b - a for a, b in itertools.pairwise(tries) if a > arrives]
    assert late
    assert max(late) == pytest.approx(0.4)


@pytest.mark.promise("RES-2")
async def test_a_loss_names_its_cause() -> None:
    """What the driver has raised can be seen in the traceback of whoever reads."""
    bug = KeyError("scale")

    class Sonar(esair.Sensor[float]):
        async def open(self) -> None:
            raise bug

        async def read(self) -> float:
            return 1.0

    async with esair.Robot(resources=[Sonar()]) as robot:
        error = robot.resources.query("sonar").error
        assert isinstance(error, esair.DeviceLostError)
        assert error.__cause__ is bug


@pytest.mark.promise("RES-2")
async def test_out_and_in_within_one_moment(fake_sensor: Any) -> None:
    """A wiggle of the cable closes and opens it once."""
    sonar = fake_sensor("sonar", 1.0)

    async with esair.Robot(resources=[sonar]) as robot:
        sonar.unplug()
        sonar.plug()
        sonar.plug()
        await asyncio.sleep(0.2)
        assert robot.resources.query("sonar").state is ResourceState.READY
        assert sonar.opened == 2
        sonar.plug()  # an arrival of what is there is no news
        await asyncio.sleep(0.2)
        assert sonar.opened == 2


@pytest.mark.fault("D21", "D18")
async def test_an_opening_that_hangs_is_given_up(fake_sensor: Any) -> None:
    """The device counts as lost with a DriverStuckError, and is tried again."""

    class Sonar(esair.Sensor[float]):
        opened = 0

        async def open(self) -> None:
            self.opened += 1
            if self.opened == 1:
                await asyncio.sleep(1000)

        async def read(self) -> float:
            return 1.0

    async with esair.Robot(resources=[Sonar()]) as robot:
        status = robot.resources.query("sonar")
        assert status.state is ResourceState.LOST
        assert isinstance(status.error, esair.DriverStuckError)
        await asyncio.sleep(0.2)
        assert robot.resources.query("sonar").state is ResourceState.READY


@pytest.mark.fault("D18")
async def test_a_close_that_hangs_does_not_hold_the_stop_up() -> None:
    """The robot stops in time."""

    class Sonar(esair.Sensor[float]):
        async def close(self) -> None:
            await asyncio.sleep(1000)

        async def read(self) -> float:
            return 1.0

    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[Sonar()]):
        began = loop.time()
    assert loop.time() - began <= 1.2


@pytest.mark.fault("B10")
async def test_an_opening_that_ignores_its_cancellation_is_left_behind() -> None:
    """The removal returns, and what opens late never becomes READY."""
    go = asyncio.Event()

    class Sonar(esair.Sensor[float]):
        async def open(self) -> None:
            while not go.is_set():
                try:
                    await go.wait()
                except asyncio.CancelledError:
                    continue

        async def read(self) -> float:
            return 1.0

    loop = asyncio.get_running_loop()
    robot = esair.Robot(resources=[])
    async with robot:
        adding = asyncio.create_task(robot.resources.add(Sonar()))
        await asyncio.sleep(0.01)
        channel = robot.sensors.channels["sonar"]
        began = loop.time()
        adding.cancel()
        await asyncio.wait({adding})
        assert loop.time() - began <= 3.5
        assert robot.resources.names() == []
        go.set()
        await asyncio.sleep(1.0)
        assert channel.state is ResourceState.REMOVED


@pytest.mark.promise("ROB-3")
@pytest.mark.real_clock
@pytest.mark.fault("D21", "D22", "O16")
@pytest.mark.longer
async def test_a_stuck_thread_does_not_delay_the_stop(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It is left behind; when its call returns the safe command comes after it."""
    go, log = threading.Event(), []

    class Arm(esair.Actuator[float]):
        safe = 0.0

        def write(self, command: float) -> None:
            if command:
                go.wait(10.0)
            log.append(command)

    user = esair.Behavior(name="user", writes={"arm": esair.writes(float)})
    loop = asyncio.get_running_loop()
    robot = esair.Robot(resources=[Arm()], behaviors=[user])
    async with robot:
        writing = asyncio.create_task(user.arm.write(1.0))  # type: ignore[attr-defined]
        await asyncio.sleep(0.05)
        began = loop.time()
    took = loop.time() - began
    go.set()
    writing.cancel()
    await asyncio.wait({writing})
    for _ in range(200):
        if len(log) >= 3:
            break
        await asyncio.sleep(0.005)

    assert within(2.0, took)
    assert not robot.stopped[0].answered
    assert log[:3] == [0.0, 1.0, 0.0]
    assert log[-1] == 0.0
    assert any("stuck" in record.getMessage() for record in caplog.records)


@pytest.mark.promise("ROB-3")
@pytest.mark.real_clock
@pytest.mark.fault("D21", "D22")
@pytest.mark.longer
async def test_a_stop_tries_nothing_past_a_thread_that_was_given_up() -> None:
    """Its device was lost before the stop: no last try waits behind its call."""
    go = threading.Event()

    class Arm(esair.Actuator[float]):
        safe = 0.0
        deadline = 0.05

        def write(self, command: float) -> None:
            if command:
                go.wait(10.0)

    user = esair.Behavior(name="user", writes={"arm": esair.writes(float)})
    async with esair.Robot(resources=[Arm()], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.arm.write(1.0))  # type: ignore[attr-defined]
        await asyncio.wait({writing})
        life = robot._resources.lives["arm"]
        async with asyncio.timeout(10.0):
            while life.channel.state is not ResourceState.LOST:  # noqa: ASYNC110
                await asyncio.sleep(0.005)
    go.set()

    assert writing.exception() is not None
    assert life._last_try is None


@pytest.mark.promise("ROB-3")
@pytest.mark.real_clock
@pytest.mark.fault("D21", "D22")
async def test_a_stop_waits_a_moment_for_a_thread_that_was_given_up() -> None:
    """What its call does as it comes back is undone before the robot has stopped."""
    go, log = threading.Event(), []

    class Arm(esair.Actuator[float]):
        safe = 0.0
        deadline = 0.05

        def write(self, command: float) -> None:
            if command:
                go.wait(10.0)
            log.append(command)

    user = esair.Behavior(name="user", writes={"arm": esair.writes(float)})
    async with esair.Robot(resources=[Arm()], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.arm.write(1.0))  # type: ignore[attr-defined]
        await asyncio.wait({writing})
        channel = robot.actuators.channels["arm"]
        async with asyncio.timeout(10.0):
            while channel.state is not ResourceState.LOST:  # noqa: ASYNC110
                await asyncio.sleep(0.005)
        asyncio.get_running_loop().call_later(0.2, go.set)

    assert writing.exception() is not None
    assert go.is_set()
    assert log[:2] == [0.0, 1.0]
    assert log[-1] == 0.0


@pytest.mark.promise("RS-4", "RES-2")
@pytest.mark.fault("R12")
@pytest.mark.parametrize("takes", [0.05, 0.5, 1000.0])
async def test_a_loss_ends_a_change_of_settings_that_is_on_its_way(
    takes: float,
) -> None:
    """Its caller learns of the loss; the device returns with the settings from before."""

    class Camera(esair.Sensor[float]):
        gain = esair.setting(1)

        def __init__(self) -> None:
            super().__init__(gain=2)
            self.in_device: dict[str, Any] = {}
            self.takes = 0.0

        async def open(self) -> None:
            self.in_device = {"gain": 1}

        async def apply(self, **changes: Any) -> None:
            takes, self.takes = self.takes, 0.0
            await asyncio.sleep(takes)
            self.in_device.update(changes)

        async def read(self) -> float:
            return 1.0

    camera = Camera()
    user = esair.Behavior(
        name="user", reads={"camera": esair.reads(float, configure=True)}
    )
    async with esair.Robot(resources=[camera], behaviors=[user]) as robot:
        camera.takes = takes
        changing = asyncio.create_task(user.camera.configure(gain=3))  # type: ignore[attr-defined]
        await asyncio.sleep(0.01)
        camera.report_lost(ConnectionError("cable"))

        with pytest.raises(esair.DeviceLostError, match="cable"):
            await changing
        await asyncio.sleep(0.2)
        assert robot.resources.query("camera").state is ResourceState.READY
        assert camera.settings["gain"] == camera.in_device["gain"] == 2
        await asyncio.sleep(2.0)
        assert camera.settings["gain"] == camera.in_device["gain"] == 2


@pytest.mark.promise("RS-4")
@pytest.mark.fault("R12")
async def test_a_change_of_settings_that_ignores_the_loss_does_not_reach_its_successor(
    fake_sensor: Any,
) -> None:
    """The device is opened again only when the call has ended; nothing is recorded."""

    class Stubborn(esair.Sensor[float]):
        gain = esair.setting(1)

        def __init__(self) -> None:
            super().__init__()
            self.log: list[str] = []

        async def open(self) -> None:
            self.log.append("open")

        async def apply(self, **changes: Any) -> None:
            try:
                await asyncio.sleep(0.5)
            except asyncio.CancelledError:
                await asyncio.sleep(0.4)
            self.log.append("applied")

        async def read(self) -> float:
            return 1.0

    stubborn = Stubborn()
    user = esair.Behavior(
        name="user", reads={"stubborn": esair.reads(float, configure=True)}
    )
    async with esair.Robot(resources=[stubborn], behaviors=[user]):
        changing = asyncio.create_task(user.stubborn.configure(gain=3))  # type: ignore[attr-defined]
        await asyncio.sleep(0.1)
        stubborn.report_lost(ConnectionError("cable"))
        with pytest.raises(esair.DeviceLostError):
            await changing
        await asyncio.sleep(1.0)

    assert stubborn.log == ["open", "applied", "open"]
    assert stubborn.settings["gain"] == 1


@pytest.mark.promise("RS-4")
@pytest.mark.parametrize("heeds", [True, False])
async def test_a_change_of_settings_ends_with_the_replacement_of_its_resource(
    heeds: bool,
) -> None:
    """Whoever configures the old one is told; the new one keeps its own settings."""

    class Camera(esair.Sensor[float]):
        gain = esair.setting(1)
        takes = 0.0

        async def apply(self, **changes: Any) -> None:
            try:
                await asyncio.sleep(self.takes)
            except asyncio.CancelledError:
                if heeds:
                    raise
                await asyncio.sleep(0.5)

        async def read(self) -> float:
            return 1.0

    old, new = Camera(), Camera()
    old.takes = 0.9
    user = esair.Behavior(
        name="user", reads={"camera": esair.reads(float, configure=True)}
    )
    async with esair.Robot(resources=[old], behaviors=[user]) as robot:
        first, second = (
            asyncio.create_task(user.camera.configure(gain=gain))  # type: ignore[attr-defined]
            for gain in (3, 4)
        )
        await asyncio.sleep(0.01)
        await robot.resources.replace("camera", new)

        for change in (first, second):
            with pytest.raises(esair.DeviceLostError, match="replaced"):
                await change
        assert (old.settings["gain"], new.settings["gain"]) == (1, 1)


class Numbered(esair.Actuator[float]):
    """A motor with a serial number; a test exchanges it."""

    safe = 0.0

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.number: str | None = "A1"
        self.log: list[object] = []

    async def open(self) -> None:
        self.log.append("open")

    async def identify(self) -> str | None:
        return self.number

    async def write(self, command: float) -> None:
        self.log.append((self.number, command))


@pytest.mark.promise("RES-2")
@pytest.mark.fault("D05")
async def test_another_device_in_the_place_of_one_is_refused(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It stays lost, and is told nothing, until the right one is back."""
    motor = Numbered()
    async with esair.Robot(resources=[motor]) as robot:
        motor.number = "B2"
        motor.report_lost(ConnectionError("cable"))
        await asyncio.sleep(60.0)
        status = robot.resources.query("numbered")
        assert status.state is ResourceState.LOST
        assert isinstance(status.error, esair.DeviceFaultError)
        assert "'A1'" in str(status.error)
        assert "'B2'" in str(status.error)
        assert ("B2", 0.0) not in motor.log

        motor.number = "A1"
        await asyncio.sleep(6.0)
        assert robot.resources.query("numbered").state is ResourceState.READY
    warnings = [r.getMessage() for r in caplog.records if "identity" in r.getMessage()]
    assert len(warnings) == 1


@pytest.mark.fault("D05")
async def test_a_declared_identity_holds_from_the_first_opening() -> None:
    """What is required and another device refuses the start."""
    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(resources=[Numbered(identity="Z9", required=True)]):
            pytest.fail("it started")

    assert caught.group_contains(esair.DeviceFaultError, match="identity")


@pytest.mark.fault("D05")
async def test_a_device_that_cannot_tell_yet_is_remembered_later() -> None:
    """The first answer counts, not the first opening."""
    motor = Numbered()
    motor.number = None
    async with esair.Robot(resources=[motor]) as robot:
        for number, state in (("A1", "ready"), ("B2", "lost")):
            motor.number = number
            motor.report_lost(ConnectionError("cable"))
            await asyncio.sleep(1.0)
            assert robot.resources.query("numbered").state.value == state


@pytest.mark.fault("D05")
async def test_an_identity_needs_somebody_who_asks_for_it(fake_sensor: Any) -> None:
    """A resource whose class cannot identify its device is described wrongly."""
    sonar = fake_sensor("sonar", 1.0, identity="A1")

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(resources=[sonar]):
            pytest.fail("it started")

    assert caught.group_contains(esair.ConfigError, match="identity")


@pytest.mark.fault("D05")
async def test_a_behavior_waits_for_the_right_device() -> None:
    """Another device in the place is not the behavior's failure: it is parked."""

    class Drive(esair.Behavior):
        numbered = esair.writes(float)

        async def run(self) -> None:
            async for _ in esair.every(0.05):
                await self.numbered.write(1.0)

    motor = Numbered()
    async with esair.Robot(resources=[motor], behaviors=[Drive()]) as robot:
        await asyncio.sleep(0.1)
        motor.number = "B2"
        motor.report_lost(ConnectionError("cable"))
        await asyncio.sleep(60.0)
        assert robot.behaviors.query("drive").state is esair.BehaviorState.PARKED
        motor.number = "A1"
        await asyncio.sleep(6.0)
        status = robot.behaviors.query("drive")
        assert (status.state, status.restarts) == (esair.BehaviorState.RUNNING, 0)


@pytest.mark.promise("CALL-1")
async def test_a_close_waits_for_a_call_that_ends_in_time() -> None:
    """A driver that is closed amid a call may leave its bus in any state."""

    class Sonar(esair.Sensor[float]):
        rate = 1.3

        def __init__(self) -> None:
            super().__init__()
            self.log: list[str] = []

        async def read(self) -> float:
            asked = asyncio.get_running_loop().time()
            while asyncio.get_running_loop().time() < asked + 0.2:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(0.01)
            self.log.append("read")
            return 1.0

        async def close(self) -> None:
            self.log.append("close")

    class User(esair.Behavior):
        sonar = esair.reads(float)

        async def run(self) -> None:
            await self.sonar.read(fresh=True)

    sonar = Sonar()
    async with esair.Robot(resources=[sonar], behaviors=[User()]):
        await asyncio.sleep(0.05)
    assert sonar.log == ["read", "close"]


@pytest.mark.promise("CALL-1")
async def test_a_device_that_an_old_opening_may_have_set_up_is_opened_at_once() -> None:
    """It is there: nobody waits for it as for one that is gone."""

    class Sonar(esair.Sensor[float]):
        rate = 1.3

        def __init__(self) -> None:
            super().__init__()
            self.openings: list[float] = []

        async def open(self) -> None:
            loop = asyncio.get_running_loop()
            self.openings.append(loop.time())
            if len(self.openings) > 3:
                return
            if len(self.openings) < 3:
                raise ConnectionError("not there")
            until = loop.time() + 3.0
            while loop.time() < until:  # it heeds no cancellation
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(0.01)

        async def read(self) -> float:
            return 1.0

    sonar = Sonar()
    async with esair.Robot(resources=[sonar]):
        await asyncio.sleep(6.0)
    late = sonar.openings[2] + 3.0
    after = [each for each in sonar.openings if each >= late]
    assert len(after) == 1
    assert after[0] - late < 0.15


@pytest.mark.promise("SUP-4")
async def test_the_users_restart_of_a_device_fills_its_budget() -> None:
    """It may fail as often again before it has failed for good."""

    class Sonar(esair.Sensor[float]):
        restart = esair.Restart(max=1, within=1000.0, delay=0.1)

        def __init__(self) -> None:
            super().__init__()
            self.openings = 0

        async def open(self) -> None:
            self.openings += 1
            raise ValueError("its answer makes no sense")

        async def read(self) -> float:
            return 1.0

    sonar = Sonar()
    async with esair.Robot(resources=[sonar]) as robot:
        await asyncio.sleep(5.0)
        assert robot.resources.query("sonar").state is ResourceState.FAILED
        failed_after = sonar.openings
        restarting = asyncio.create_task(robot.resources.restart("sonar"))
        await asyncio.sleep(5.0)
        assert robot.resources.query("sonar").state is ResourceState.FAILED
        assert sonar.openings == 2 * failed_after
        await asyncio.wait({restarting})


@pytest.mark.promise("SC-2")
async def test_a_device_is_asked_no_more_when_nobody_follows_it() -> None:
    """Polling begins with the first who follows, and ends with the last."""

    class Sonar(esair.Sensor[float]):
        rate = 20.0
        asked = 0

        async def read(self) -> float:
            self.asked += 1
            return 1.0

    class Look(esair.Behavior):
        sonar = esair.reads(float)

        async def run(self) -> None:
            async for _ in self.sonar:
                continue

    sonar = Sonar()
    async with esair.Robot(resources=[sonar], behaviors=[Look()]) as robot:
        await asyncio.sleep(0.5)
        assert sonar.asked > 5
        await robot.behaviors.remove("look")
        asked = sonar.asked
        await asyncio.sleep(1.0)
        assert sonar.asked == asked


@pytest.mark.promise("ROB-2")
async def test_an_opening_that_ends_after_the_last_try_is_closed() -> None:
    """The stop waits for it, and closes it."""

    class Slow(esair.Actuator[float]):
        safe = 0.0

        def __init__(self) -> None:
            super().__init__()
            self.log: list[object] = []
            self.gone = False
            self.is_slow = False

        async def open(self) -> None:
            if self.gone:
                raise ConnectionError("not there")
            if self.is_slow:
                loop = asyncio.get_running_loop()
                until = loop.time() + 0.7
                while loop.time() < until:  # it heeds no cancellation
                    with contextlib.suppress(asyncio.CancelledError):
                        await asyncio.sleep(0.1)
            self.log.append("open")

        async def close(self) -> None:
            self.log.append("close")

        async def write(self, command: float) -> None:
            self.log.append(command)

    slow = Slow()
    async with esair.Robot(resources=[slow], grace=2.0) as robot:
        slow.gone = True
        slow.report_lost(ConnectionError("cable"))
        await asyncio.sleep(1.0)
        slow.log.clear()
        slow.gone, slow.is_slow = False, True

    assert not robot.stopped[0].answered
    await asyncio.sleep(5.0)
    assert slow.log.count("open") == 1
    assert slow.log[-1] == "close"


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("D19")
async def test_a_last_try_does_not_open_what_is_still_being_opened() -> None:
    """An opening that ignores its end is not joined by a second one."""

    class Deaf(esair.Actuator[float]):
        safe = 0.0
        at_once = 0
        most = 0
        gone = False
        go: asyncio.Event

        async def open(self) -> None:
            self.at_once += 1
            self.most = max(self.most, self.at_once)
            while self.gone and not self.go.is_set():
                try:
                    await self.go.wait()
                except asyncio.CancelledError:
                    continue
            self.at_once -= 1

        async def write(self, command: float) -> None:
            return None

    deaf = Deaf()
    deaf.go = asyncio.Event()
    async with esair.Robot(resources=[deaf], grace=0.2) as robot:
        deaf.gone = True
        deaf.report_lost(ConnectionError("cable"))
        await asyncio.sleep(0.15)
    deaf.go.set()
    await asyncio.sleep(0.1)

    assert "stuck" in robot.stopped[0].error
    assert deaf.most == 1


@pytest.mark.promise("ROB-2")
async def test_a_last_try_waits_for_no_setting_from_before() -> None:
    """It was given up; what it would still set matters less than a last safe command."""

    class Deaf(esair.Actuator[float]):
        safe = 0.0
        gain = esair.setting(0, min=0, max=9)

        def __init__(self) -> None:
            super().__init__(name="deaf")
            self.told: list[float] = []

        async def write(self, command: float) -> None:
            self.told.append(command)

        async def apply(self, *, gain: int) -> None:
            end = asyncio.get_running_loop().time() + 1.7
            while (left := end - asyncio.get_running_loop().time()) > 0.0:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(left)

    class User(esair.Behavior):
        deaf = esair.writes(float, configure=True)

    deaf, user = Deaf(), User()
    async with esair.Robot(resources=[deaf], behaviors=[user]) as robot:
        await user.deaf.write(1.0)
        setting = asyncio.ensure_future(user.deaf.configure(gain=1))
        await asyncio.sleep(0.01)
        deaf.report_lost(ConnectionError("cable"))
        await asyncio.sleep(0.0)
        deaf.report_arrived()
    await asyncio.gather(setting, return_exceptions=True)

    assert deaf.told[-2:] == [1.0, 0.0]
    assert robot.stopped[0].answered


class Returning(esair.Actuator[float]):
    """Gone, then there again; what it is told takes a while."""

    safe = 0.0
    gone = False

    def __init__(self) -> None:
        super().__init__(name="returning")
        self.log: list[object] = []

    async def open(self) -> None:
        if self.gone:
            raise ConnectionError("not there")
        self.log.append("open")

    async def write(self, command: float) -> None:
        for _ in range(4):
            await asyncio.sleep(0.05)
        self.log.append(command)

    async def lose(self) -> None:
        self.gone = True
        self.report_lost(ConnectionError("cable"))
        await asyncio.sleep(0.01)
        self.gone = False
        self.log.clear()


@pytest.mark.promise("ROB-2", "SUP-3")
async def test_a_removal_and_the_stop_share_one_last_try() -> None:
    """The second neither ends what the first has begun, nor begins another."""
    motor = Returning()
    async with esair.Robot(resources=[motor], behaviors=[]) as robot:
        await motor.lose()
        removal = asyncio.create_task(robot.resources.remove("returning"))
        await asyncio.sleep(0.1)
        await robot.stop("enough")
        await removal

    assert motor.log == ["open", 0.0]
    assert [(told.resource, told.answered) for told in robot.stopped] == [
        ("returning", True)
    ]


@pytest.mark.promise("ROB-2")
async def test_a_busy_computer_leaves_time_for_a_last_try() -> None:
    """Its time passed while nothing could run: the device is told safe all the same."""
    motor = Returning()
    loop: Any = asyncio.get_running_loop()
    async with esair.Robot(resources=[motor], behaviors=[]) as robot:
        await motor.lose()
        stop = asyncio.create_task(robot.stop("enough"))
        await asyncio.sleep(0.12)
        loop.advance(2.0)
        await stop

    assert motor.log == ["open", 0.0]
    assert robot.stopped[0].answered


@pytest.mark.promise("ROB-2")
async def test_a_busy_computer_leaves_time_for_the_safe_command() -> None:
    """The stop waits for its answer a little longer than the time that has passed."""
    motor = Returning()
    loop: Any = asyncio.get_running_loop()
    async with esair.Robot(resources=[motor], behaviors=[]) as robot:
        stop = asyncio.create_task(robot.stop("enough"))
        await asyncio.sleep(0.12)
        loop.advance(5.0)
        await stop

    assert robot.stopped[0].answered


@pytest.mark.promise("RS-4")
@pytest.mark.fault("X01")
@pytest.mark.parametrize("fails", [False, True])
async def test_the_end_of_the_event_loop_ends_a_change_of_settings(fails: bool) -> None:
    """Also while it is being undone: no setting is recorded that nobody confirmed."""

    class Camera(esair.Sensor[float]):
        gain = esair.setting(1)

        async def apply(self, **changes: Any) -> None:
            if fails and changes["gain"] == 3:
                raise OSError("no")
            await asyncio.sleep(0.5)

        async def read(self) -> float:
            return 1.0

    camera = Camera()
    user = esair.Behavior(
        name="user", reads={"camera": esair.reads(float, configure=True)}
    )
    async with esair.Robot(resources=[camera], behaviors=[user]):
        changing = asyncio.create_task(user.camera.configure(gain=3))  # type: ignore[attr-defined]
        await asyncio.sleep(0.1)
        for task in asyncio.all_tasks():  # as asyncio.run does at its end
            if task.get_name() == "configure camera":
                task.cancel()
        await asyncio.wait({changing})

        assert changing.cancelled()
        assert camera.settings["gain"] == 1


def translated(error: OSError) -> esair.DeviceFaultError:
    """A bus says it in its own words, with the number of the system."""
    fault = esair.DeviceFaultError("sonar", str(error))
    fault.errno = error.errno
    return fault


@pytest.mark.promise("RES-2")
@pytest.mark.fault("G06", "O17")
@pytest.mark.parametrize(
    "error",
    [
        OSError("not here"),
        PermissionError(13, "denied"),
        OSError(16, "busy"),
        translated(OSError(121, "nobody answers")),
        translated(OSError(16, "busy")),
    ],
    ids=["unknown", "denied", "busy", "silent in other words", "busy in other words"],
)
async def test_a_device_that_cannot_be_opened_comes_when_it_comes(
    error: OSError,
) -> None:
    """In use, not allowed yet, or unknown to the system: it is tried for ever."""

    class Sonar(esair.Sensor[float]):
        there = False

        async def open(self) -> None:
            if not self.there:
                raise error

        async def read(self) -> float:
            return 1.0

    sonar, user = Sonar(), reader()
    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        await asyncio.sleep(100.0)
        assert robot.resources.query("sonar").state is ResourceState.LOST
        sonar.there = True
        await asyncio.sleep(5.0)
        assert await user.sonar.read() == 1.0


@pytest.mark.promise("ROB-2", "RS-4")
@pytest.mark.parametrize("verb", ["remove", "stop"])
async def test_what_is_lost_as_it_is_made_safe_gets_its_last_try(verb: str) -> None:
    """It may move still: it is opened once more, and told."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=9.0)
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        await user.motor.write(1.0)
        motor.fail(ConnectionError("cable"))
        if verb == "remove":
            await robot.resources.remove("motor")
        else:
            await robot.stop("a test")
    assert motor.opened == 2
    assert motor.commands[-1] == 0.0
    assert not motor.is_open


@pytest.mark.promise("ROB-2", "CALL-4")
async def test_a_last_try_closes_what_was_opened_late() -> None:
    """No device is opened twice, whatever was given up before."""

    class Late(esair.Actuator[float]):
        safe = 0.0
        deadline = 0.05

        def __init__(self) -> None:
            super().__init__(name="late")
            self.log: list[object] = []
            self.hangs = self.gone = False

        async def open(self) -> None:
            if self.gone:
                raise ConnectionError("not there")
            if self.hangs:
                self.gone = True
                until = asyncio.get_running_loop().time() + 20.0
                while (left := until - asyncio.get_running_loop().time()) > 0.0:
                    with contextlib.suppress(asyncio.CancelledError):
                        await asyncio.sleep(left)
                self.hangs = self.gone = False
            self.log.append("open")

        async def close(self) -> None:
            self.log.append("close")

        async def write(self, command: float) -> None:
            self.log.append(command)

    late = Late()
    async with esair.Robot(resources=[late], grace=1.0) as robot:
        late.hangs = True
        late.report_lost(ConnectionError("cable"))
        await asyncio.sleep(0.1)
        late.log.clear()
        while "open" not in late.log:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0.001)
        state = robot.resources.query("late").state
        assert state is ResourceState.LOST
    opened = 0
    for each in late.log:
        opened += (each == "open") - (each == "close")
        assert opened <= 1
    assert late.log[-2:] == [0.0, "close"]


@pytest.mark.promise("RES-2")
@pytest.mark.parametrize("silent", [True, False])
@pytest.mark.parametrize("depth", [1, 2, 3])
async def test_a_part_that_acknowledges_nothing_is_waited_for(
    depth: int, silent: bool
) -> None:
    """However deep a driver has wrapped that, in a circle too; any other fault is one."""

    class Sonar(esair.Sensor[float]):
        async def open(self) -> None:
            first = OSError(errno.EREMOTEIO if silent else errno.EPERM, "it says")
            error: Exception = first
            for n in range(depth):
                outer = ValueError(f"layer {n}")
                outer.__cause__ = error
                error = outer
            first.__cause__ = error
            raise error

        async def read(self) -> float:
            return 1.0

    async with esair.Robot(resources=[Sonar()]) as robot:
        await asyncio.sleep(300.0)
        failed = robot.resources.query("sonar").state is ResourceState.FAILED
        assert failed is not silent


@pytest.mark.promise("RES-2")
async def test_a_fault_that_the_device_itself_shows_is_not_waited_for() -> None:
    """The system has given it no number: it would be the same for ever."""

    class Sonar(esair.Sensor[float]):
        async def open(self) -> None:
            raise esair.DeviceFaultError("sonar", "its memory is broken")

        async def read(self) -> float:
            return 1.0

    async with esair.Robot(resources=[Sonar()]) as robot:
        await asyncio.sleep(300.0)
        assert robot.resources.query("sonar").state is ResourceState.FAILED


@pytest.mark.promise("BUS-5")
async def test_only_the_opening_of_an_actuator_goes_first_on_its_bus() -> None:
    """As its safe command does; a sensor's waits in line, as its reading does."""
    levels: dict[str, int] = {}

    def note(device: esair.Resource, doing: str) -> None:
        levels[f"{device.name} {doing}"] = urgency.get().level

    class Sonar(esair.Sensor[float]):
        async def open(self) -> None:
            note(self, "open")

        async def read(self) -> float:
            note(self, "read")
            return 1.0

    class Wheels(esair.Actuator[float]):
        safe = 0.0

        async def open(self) -> None:
            note(self, "open")

        async def write(self, command: float) -> None:
            note(self, f"write {command:g}")

    class Drive(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(await self.sonar.read())

    async with esair.Robot(resources=[Sonar(), Wheels()], behaviors=[Drive()]):
        await asyncio.sleep(0.1)
    assert levels == {
        "sonar open": 0,
        "sonar read": 0,
        "wheels open": COMMAND + OPENING,
        "wheels write 1": COMMAND,
        "wheels write 0": COMMAND + SAFE,
    }
