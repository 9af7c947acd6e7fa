"""What happens in the corners: late, twice, or in the middle of something else."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import attrs
import pytest

import esair
from esair.buses import Bus
from esair.loop import Order
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Uses(esair.Behavior):
    """Reads the sonar and writes the wheels when a test says so."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)


def parts() -> tuple[FakeSensor[float], FakeActuator[float], Uses]:
    return FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0), Uses()


@pytest.mark.promise("RS-3")
async def test_a_registration_outlives_its_resource_and_says_why():
    """After a removal both connections name it, not an unknown registration."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        reading, writing = user.sonar.registration, user.wheels.registration
        await robot.resources.remove("sonar")
        await robot.resources.remove("wheels")

        with pytest.raises(esair.ResourceRemovedError):
            await robot.sensors.read(reading)
        with pytest.raises(esair.ResourceRemovedError):
            await robot.actuators.write(writing, 1.0)


@pytest.mark.fault("R07")
async def test_what_is_no_registration_opens_nothing():
    """The table refuses what it did not issue, whatever it looks like."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        table = robot.sensors.channel("sonar").registrations
        forged: Any = "sonar"

        with pytest.raises(
            esair.NotRegisteredError, match="'sonar' is no registration: res"
        ):
            table.check(forged)


async def test_a_reader_that_left_is_passed_over():
    """A loss, a fault and an answer find nobody where a reader was cancelled."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        for end in (sonar.resume, sonar.unplug):
            sonar.stall()
            reads = [asyncio.create_task(user.sonar.read(fresh=True)) for _ in range(2)]
            await asyncio.sleep(0.01)
            reads[0].cancel()
            end()
            result, kept = await asyncio.gather(*reads, return_exceptions=True)

            assert isinstance(result, asyncio.CancelledError)
            assert kept == 1.0 or isinstance(kept, esair.DeviceLostError)
        assert robot.sensors.channel("sonar").state is esair.ResourceState.LOST


async def test_following_twice_feeds_once():
    """A follower that follows again still gets each reading once."""
    sonar, wheels, user = parts()

    class Count:
        registration: Any = None
        fed, order = 0, Order.WAKE

        def feed(self, reading: object) -> None:
            self.fed += 1

        def changed(self, error: object) -> None:
            return None

        def doubt(self, error: object) -> None: ...

        def limited(self) -> None: ...

    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        channel, count = robot.sensors.channel("sonar"), Count()
        channel.follow(count)
        channel.follow(count)
        sonar.feed(2.0)
        await asyncio.sleep(0.01)
        channel.unfollow(count)

        assert count.fed == channel.sequence


@pytest.mark.promise("AC-2")
async def test_a_holder_that_never_wrote_again_is_only_released():
    """Revoking who holds, but did not write last, sends no safe command."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0, hold=5.0)
        await asyncio.sleep(1.0)  # the command has timed out, the hold goes on
        channel = robot.actuators.channel("wheels")
        told = list(wheels.commands)
        assert channel.hold.holder is user.wheels.registration

        robot.resources.revoke(user.wheels.registration)
        await asyncio.sleep(0.1)

        assert channel.hold.holder is None
        assert wheels.commands == told


@pytest.mark.promise("AC-2")
async def test_a_release_leaves_the_time_out_to_do_its_work():
    """After a release the safe command comes when the command times out."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0)
        user.wheels.release()
        await asyncio.sleep(0.15)
        assert wheels.commands[-1] == 1.0
        await asyncio.sleep(0.1)

        assert wheels.commands[-1] == 0.0
        assert robot.resources.why("wheels").holder is None


@pytest.mark.fault("D25")
async def test_a_driver_that_cancels_is_not_the_callers_cancellation():
    """A driver's own CancelledError leaves the actuator usable."""

    class Odd(esair.Actuator[float]):
        safe = 0.0
        odd = False

        async def write(self, command: float) -> None:
            if self.odd:
                self.odd = False
                raise asyncio.CancelledError

    class Drive(esair.Behavior):
        odd = esair.writes(float)

    odd, drive = Odd(), Drive()
    async with esair.Robot(resources=[odd], behaviors=[drive]):
        odd.odd = True
        with pytest.raises((asyncio.CancelledError, esair.DeviceFaultError)):
            await drive.odd.write(1.0)

        assert await drive.odd.write(1.0)


@pytest.mark.fault("D21")
@pytest.mark.real_clock
async def test_a_blocking_write_that_does_not_return_is_stuck():
    """The caller learns it at the deadline; the thread is not waited for."""
    go = threading.Event()

    class Slow(esair.Actuator[float]):
        safe = 0.0
        deadline = 0.1
        fault_limit = 100

        def write(self, command: float) -> None:
            if command:
                go.wait(5.0)

    class Drive(esair.Behavior):
        slow = esair.writes(float)

    drive = Drive()
    async with esair.Robot(resources=[Slow()], behaviors=[drive]):
        with pytest.raises(esair.DriverStuckError):
            await drive.slow.write(1.0)
        go.set()


@pytest.mark.promise("ROB-2")
async def test_an_actuator_that_will_not_open_does_not_hold_up_the_stop():
    """The last try for its safe command ends after half a second."""

    class Jammed(FakeActuator[float]):
        jammed = False

        async def open(self) -> None:
            if self.jammed:
                await asyncio.Event().wait()
            await super().open()

    wheels = Jammed("wheels", safe=0.0)
    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[wheels]) as robot:
        wheels.jammed = True
        wheels.unplug()
        await asyncio.sleep(0.05)
        begin = loop.time()

    assert loop.time() - begin < 2.0
    assert not robot.stopped[0].answered


@pytest.mark.fault("X01")
async def test_an_addition_cancelled_while_opening_leaves_nothing():
    """The name is free again, and the device is closed."""

    class Hanging(FakeSensor[float]):
        async def open(self) -> None:
            await asyncio.Event().wait()

    async with esair.Robot() as robot:
        adding = asyncio.create_task(robot.resources.add(Hanging("sonar", 1.0)))
        await asyncio.sleep(0.1)
        adding.cancel()
        await asyncio.wait({adding})

        assert robot.resources.names() == []
        await robot.resources.add(FakeSensor("sonar", 1.0))


@pytest.mark.fault("T02")
async def test_a_suspend_leaves_lost_actuators_alone():
    """What is not there cannot be made safe now; it is when it comes back."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        wheels.unplug()
        await asyncio.sleep(0.01)
        robot._resources.resumed(10.0)

        assert robot.sensors.channel("sonar").newest is None
        assert robot.resources.query("wheels").state is esair.ResourceState.LOST


@pytest.mark.fault("L02")
async def test_a_bad_name_is_one_of_the_mistakes():
    """A name outside the grammar is reported with everything else."""

    class Ünfit(esair.Sensor[float]):
        async def read(self) -> float:
            return 1.0

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(resources=[Ünfit()]):
            pass

    assert caught.group_contains(
        esair.ConfigError, match="expected a lower-case letter"
    )


@pytest.mark.promise("RS-2")
async def test_an_exclusive_actuator_may_be_read_about_by_others():
    """Exclusive use is about writing: who may only configure is not in the way."""
    access = esair.Access
    policy = esair.Policy(
        "wheels",
        allow={"tuner": access.CONFIGURE, "driver": access.WRITE},
        exclusive=True,
    )
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], policies=[policy]) as robot:
        await robot.resources.register("tuner", "wheels", access.CONFIGURE)

        assert await robot.resources.register("driver", "wheels", access.WRITE)


@pytest.mark.fault("M11")
async def test_all_requests_together_are_bounded(monkeypatch: pytest.MonkeyPatch):
    """Over the bound of the whole robot a request is refused at once."""
    monkeypatch.setattr("esair.supervisors._mediator.REQUESTS", 1)

    class Quiet(esair.Behavior):
        inbox_size = 1

    one, two = Quiet(name="one"), Quiet(name="two")
    async with esair.Robot(behaviors=[one, two]):
        await one.put("two", 1)
        waiting = asyncio.create_task(one.put("two", 2))
        await asyncio.sleep(0)

        with pytest.raises(esair.BusyError, match="number of requests"):
            await two.get("one")
        assert await two.receive() == 1
        await waiting


@pytest.mark.virtual_clock
async def test_a_wrong_argument_in_a_thread_is_an_error_there():
    """A plain behavior that misspells an option gets the error, and does not hang."""
    sonar, wheels, _ = parts()

    class Plain(esair.Behavior):
        sonar = esair.reads(float)
        restart = esair.Restart(max=0)

        def run(self):
            self.sonar.read(max_ag=1)  # type: ignore[call-arg, unused-coroutine]

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Plain()]) as robot:
        await asyncio.sleep(0.1)

        assert isinstance(robot.behaviors.query("plain").error, TypeError)


@pytest.mark.promise("RES-2")
async def test_a_flapping_device_is_tried_ever_less_often():
    """A device that is lost as soon as it opened does not keep the robot busy."""

    class Flapping(FakeSensor[float]):
        async def open(self) -> None:
            await super().open()
            asyncio.get_running_loop().call_later(0.01, self.report_lost)

    sonar = Flapping("sonar", 1.0)
    async with esair.Robot(resources=[sonar]):
        await asyncio.sleep(60.0)

    assert 5 < sonar.opened < 25


@pytest.mark.promise("SUP-5")
async def test_nobody_registers_for_what_is_being_removed():
    """Between the first step of a removal and its end no new right is given."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0)
        wheels.stall()  # its safe command takes until its deadline
        removing = asyncio.create_task(robot.resources.remove("wheels"))
        await asyncio.sleep(0.01)

        with pytest.raises(esair.ResourceRemovedError):
            await robot.resources.register("user", "wheels", esair.Access.WRITE)
        await removing
        wheels.resume()


@attrs.frozen
class Pair:
    """A command of two numbers."""

    left: float
    right: float


@pytest.mark.fault("V01")
async def test_every_number_of_a_structure_is_looked_at():
    """A structure of numbers is sent as it is; one that is not finite is named."""
    wheels = FakeActuator("wheels", safe=Pair(0.0, 0.0))
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(Pair)})
    async with esair.Robot(resources=[wheels], behaviors=[user]):
        assert await user.wheels.write(Pair(1.0, 2.0))
        with pytest.raises(esair.BadValueError, match="right"):
            await user.wheels.write(Pair(1.0, float("nan")))

    safe = Pair(0.0, 0.0)
    assert wheels.commands == [safe, Pair(1.0, 2.0), safe, safe]


@pytest.mark.fault("R07")
async def test_the_right_to_an_actuator_reads_no_sensor():
    """The connection names what is not there."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        with pytest.raises(esair.UnknownNameError, match="no sensor is named 'wheels'"):
            await robot.sensors.read(user.wheels.registration)


@pytest.mark.promise("RS-3")
async def test_a_right_revoked_while_the_device_answers_gets_no_answer():
    """Who waits for a reading is refused when it comes."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        sonar.stall()
        reading = asyncio.create_task(user.sonar.read(fresh=True))
        await asyncio.sleep(0.01)
        robot.resources.revoke(user.sonar.registration)
        sonar.resume()

        with pytest.raises(esair.NotRegisteredError):
            await reading


@pytest.mark.promise("SC-3")
@pytest.mark.real_clock
async def test_even_a_new_reading_can_be_too_old():
    """Older than the limit is older than the limit, though it came just now."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]):
        with pytest.raises(esair.StaleReadingError):
            await user.sonar.read(fresh=True, max_age=1e-9)


@pytest.mark.promise("SC-1")
async def test_an_answer_at_the_very_deadline_counts():
    """It comes in the same moment as the end of the patience, but before it."""
    sonar, wheels, user = parts()
    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        channel = robot.sensors.channel("sonar")
        sonar.stall()
        due = loop.time() + 0.5
        loop.call_at(due, channel.publish, 7.0, float("inf"))
        assert await user.sonar.read(fresh=True, timeout=0.5) == 7.0
        assert loop.time() == due
        sonar.resume()


@pytest.mark.promise("SC-2")
@pytest.mark.fault("D23")
@pytest.mark.fault("D01")
async def test_a_loss_ends_a_poll_that_came_before_a_reader():
    """The reader had just asked for a transaction; the poll was it."""
    ended: list[str] = []

    class Slow(FakeSensor[float]):
        deadline = 60.0

        async def read(self) -> float:
            try:
                await asyncio.sleep(30.0)
            finally:
                ended.append("read")
            return 1.0

    slow, loop = Slow("sonar", 1.0), asyncio.get_running_loop()
    _, wheels, user = parts()
    async with esair.Robot(resources=[slow, wheels], behaviors=[user]) as robot:
        channel = robot.sensors.channel("sonar")
        reading = asyncio.create_task(user.sonar.read())
        channel.asking._turn(loop.time())
        await asyncio.sleep(0.1)
        slow.unplug()
        await asyncio.sleep(0.1)

        assert ended == ["read"]
        with pytest.raises(esair.DeviceLostError):
            await reading


async def test_an_error_is_only_for_those_who_asked_before_it():
    """Who wants a value that is newer than that call gets the next one."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]):
        sonar.stall()
        early, left = (
            asyncio.create_task(user.sonar.read(fresh=True)) for _ in range(2)
        )
        await asyncio.sleep(0.01)
        late = asyncio.create_task(user.sonar.read(fresh=True))
        await asyncio.sleep(0.01)
        sonar.fail(OSError("glitch"))
        sonar.resume()
        left.cancel()  # in the tick of the error

        with pytest.raises(esair.DeviceFaultError, match="glitch"):
            await early
        assert await late == 1.0
        assert left.cancelled() or await asyncio.wait({left})


@pytest.mark.fault("D25", "X01")
async def test_a_driver_that_cancels_itself_is_at_fault():
    """A call belongs to nobody's task: who has cancelled its caller has not cancelled it."""

    class Sonar(esair.Sensor[float]):
        cancels = False

        async def read(self) -> float:
            if self.cancels:
                raise asyncio.CancelledError
            return 1.0

    class Wheels(esair.Actuator[float]):
        safe = 0.0
        cancels = False

        async def write(self, command: float) -> None:
            if self.cancels:
                raise asyncio.CancelledError

    sonar, wheels, user = Sonar(), Wheels(), Uses()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:

        async def clean_up() -> None:
            try:
                await asyncio.Event().wait()
            finally:
                wheels.cancels = True
                await user.wheels.write(1.0)

        task = asyncio.create_task(clean_up())
        await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.wait({task})
        wheels.cancels = False

        assert isinstance(task.exception(), esair.DeviceFaultError)
        assert robot.resources.query("wheels").faults == 1
        assert await user.wheels.write(1.0)


@pytest.mark.fault("D21")
async def test_a_driver_may_say_itself_that_it_is_stuck():
    """Its error reaches the caller as it is: from a read, a write and a setting."""
    stuck = esair.DriverStuckError("arm", "ask", 0.3)

    class Sonar(esair.Sensor[float]):
        async def read(self) -> float:
            await asyncio.sleep(0.01)
            raise stuck

    class Arm(esair.Actuator[float]):
        safe = 0.0
        gain = esair.setting(0)
        fault_limit = 100

        async def write(self, command: float) -> None:
            if command:
                await asyncio.sleep(0.01)
                raise stuck

        async def apply(self, **changes: Any) -> None:
            if changes["gain"] == 1:
                raise stuck

    user: Any = esair.Behavior(
        name="user",
        reads={"sonar": esair.reads(float)},
        writes={"arm": esair.writes(float, configure=True)},
    )
    async with esair.Robot(resources=[Sonar(), Arm()], behaviors=[user]):
        for attempt in (
            lambda: user.sonar.read(),
            lambda: user.arm.write(1.0),
            lambda: user.arm.configure(gain=1),
        ):
            with pytest.raises(esair.DriverStuckError) as caught:
                await attempt()
            assert caught.value is stuck


@pytest.mark.fault("D21")
async def test_an_opening_may_say_itself_that_it_is_stuck():
    """It is lost with that error."""
    stuck = esair.DriverStuckError("arm", "ask", 0.3)

    class Arm(esair.Actuator[float]):
        safe = 0.0

        async def open(self) -> None:
            raise stuck

        async def write(self, command: float) -> None:
            return None

    async with esair.Robot(resources=[Arm()]) as robot:
        assert robot.resources.query("arm").error is stuck


@pytest.mark.fault("D29")
@pytest.mark.parametrize("faults", [0, 1, 2])
async def test_a_device_lost_on_its_safe_command_is_not_called_safe(faults: int):
    """It is lost, tried no further, and reported with what it did not answer."""

    class Wheels(esair.Actuator[float]):
        safe = 0.0
        fault_limit = 100
        errors: list[Exception]

        async def write(self, command: float) -> None:
            if command == 0.0 and self.errors:
                raise self.errors.pop(0)

    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    wheels = Wheels()
    wheels.errors = []
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0)
        wheels.errors = [*[OSError("no")] * faults, ConnectionError("gone")]
        robot.resources.revoke(user.wheels.registration)
        await asyncio.sleep(0.05)

        told = robot.actuators.channel("wheels").told()
        assert robot.resources.query("wheels").state is esair.ResourceState.LOST
        assert not told.answered
        assert "gone" in told.error


@pytest.mark.promise("ROB-2")
async def test_revoking_after_the_stop_is_no_error():
    """A right that was issued while the robot stopped can still be given back."""
    rights: list[Any] = []

    class Late(esair.Behavior):
        async def teardown(self) -> None:
            asked = robot.resources.register("late", "wheels", esair.Access.WRITE)
            rights.append(await asked)

    wheels = FakeActuator("wheels", safe=0.0)
    policy = esair.Policy("wheels", allow={"late": esair.Access.WRITE})
    robot = esair.Robot(resources=[wheels], behaviors=[Late()], policies=[policy])
    async with robot:
        pass
    robot.resources.revoke(rights[0])

    assert not rights[0].usable
    assert set(wheels.commands) == {0.0}


@pytest.mark.fault("D28")
async def test_an_error_that_comes_after_the_removal_is_nobodys():
    """A stream that ends late, in an error, is no trouble to anybody."""
    ended = asyncio.Event()

    class Pusher(esair.Sensor[float]):
        async def stream(self) -> Any:
            try:
                yield 1.0
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                await asyncio.sleep(3.0)
                ended.set()
                raise OSError("late") from None

    async with esair.Robot(resources=[Pusher()]) as robot:
        await asyncio.sleep(0.01)
        await robot.resources.remove("pusher")
        await asyncio.sleep(5.0)

        assert ended.is_set()
        assert robot.resources.names() == []


@pytest.mark.fault("X01")
async def test_a_cancelled_start_leaves_what_it_has_not_tried():
    """Devices that hang in their opening are given up, all at the same time."""

    class Hanging(FakeSensor[float]):
        async def open(self) -> None:
            await asyncio.Event().wait()

    robot = esair.Robot(resources=[Hanging(name, 1.0) for name in ("a", "b", "c")])
    loop = asyncio.get_running_loop()
    starting = asyncio.create_task(robot.__aenter__())
    await asyncio.sleep(0.1)
    began = loop.time()
    starting.cancel()
    await asyncio.wait({starting})

    assert starting.cancelled()
    assert loop.time() - began < 1.5
    assert robot.resources.names() == []


@pytest.mark.promise("RS-5")
async def test_nobody_registers_for_what_another_type_takes_the_place_of():
    """Until the new one is there, a right to the old one would be void for ever."""
    sonar, wheels, user = parts()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0)
        wheels.stall()  # its safe command takes until its deadline
        new = FakeSensor("wheels", 1.0)
        replacing = asyncio.create_task(robot.resources.replace("wheels", new))
        await asyncio.sleep(0.01)
        with pytest.raises(esair.ResourceRemovedError):
            await robot.resources.register("user", "wheels", esair.Access.READ)
        await replacing
        wheels.resume()

        right = await robot.resources.register("user", "wheels", esair.Access.READ)
        assert (await robot.sensors.read(right)).value == 1.0


@pytest.mark.promise("RES-1", "BUS-1")
@pytest.mark.real_clock
async def test_blocking_drivers_on_one_bus_share_its_thread():
    """Their calls come one after the other, on the worker thread of the bus."""
    threads: list[str] = []

    class Line(Bus):
        async def _open(self) -> None:
            return None

        async def _close(self) -> None:
            return None

    class Part(esair.Sensor[float]):
        def read(self) -> float:
            threads.append(threading.current_thread().name)
            return 1.0

    line = Line(name="line")
    both = [Part(name=name, bus=line) for name in ("one", "two")]
    user: Any = esair.Behavior(
        name="user", reads={part.name: esair.reads(float) for part in both}
    )
    async with esair.Robot(resources=both, behaviors=[user]):
        assert await user.one.read() == await user.two.read() == 1.0

    assert len(set(threads)) == 1
    assert "line" in threads[0]


@pytest.mark.promise("AC-4")
@pytest.mark.parametrize("moves", [False, True])
async def test_who_lets_go_for_another_robot_waits_until_it_is_safe(
    moves: bool,
) -> None:
    """And hears whether the device has answered, if it was told to be safe."""
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=9.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels], behaviors=[user]):
        if moves:
            await user.wheels.write(1.0)
        wheels.slow(0.05)
        assert await user.wheels._let_go()
        assert wheels.commands == ([0.0, 1.0, 0.0] if moves else [0.0])


@pytest.mark.promise("ROB-2")
async def test_the_stop_waits_for_a_write_in_flight_and_then_for_safe() -> None:
    """Each has its time: who answers within its deadline has answered."""

    wheels = FakeActuator("wheels", safe=0.0, command_timeout=0.3)
    wheels.deadline = 1.0
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels], behaviors=[user], grace=1.0) as robot:
        wheels.slow(0.28)
        wheels.swallow(1)
        writing = asyncio.ensure_future(user.wheels.write(1.0))
        await asyncio.sleep(0.01)
        wheels.slow(0.95)
    await asyncio.wait({writing})
    writing.exception()
    assert wheels.commands[-2:] == [1.0, 0.0]
    assert robot.stopped[0].answered


@pytest.mark.promise("AC-4")
async def test_a_safe_command_that_is_stuck_is_not_begun_before_itself() -> None:
    """The report of the stop says what is wrong with it."""
    sonar, wheels, user = parts()
    robot = esair.Robot(resources=[sonar, wheels], behaviors=[user])
    async with robot:
        assert await user.wheels.write(1.0)
        wheels.stall()
    assert robot.stopped is not None
    (told,) = robot.stopped
    assert (told.command, told.answered) == (0.0, False)
    assert told.error == "it has not answered yet"
