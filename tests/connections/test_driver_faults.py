"""What drivers do wrong, and who learns of it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import pytest

import esair
from esair.connections import is_loss, translate

pytestmark = pytest.mark.virtual_clock


class Odd(BaseException):
    """Something that no driver should raise."""


class MuteError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no text")


ODD = [
    Odd("?"),
    SystemExit(3),
    KeyboardInterrupt(),
    MuteError(),
    asyncio.CancelledError(),
    GeneratorExit(),
]


@pytest.mark.promise("ROB-3")
@pytest.mark.fault("D25")
@pytest.mark.parametrize("error", ODD, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("waits", [False, True])
async def test_an_odd_error_of_a_driver_is_contained(
    user_of: Any, error: BaseException, waits: bool
) -> None:
    """Reader and writer get a DeviceFaultError; the robot goes on."""

    class Sonar(esair.Sensor[float]):
        async def read(self) -> float:
            if waits:
                await asyncio.sleep(0.01)
            raise error

    class Arm(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            if command:
                if waits:
                    await asyncio.sleep(0.01)
                raise error

    user = user_of("user", sonar=esair.reads(float), arm=esair.writes(float))
    async with esair.Robot(resources=[Sonar(), Arm()], behaviors=[user]) as robot:
        with pytest.raises(esair.DeviceFaultError, match=type(error).__name__):
            await user.sonar.read()
        with pytest.raises(
            esair.DeviceFaultError, match=type(error).__name__
        ) as caught:
            await user.arm.write(1.0)
        cause: BaseException | None = caught.value
        for _ in range(3):
            cause = cause if cause is error else cause and cause.__cause__
        assert cause is error
        assert robot.resources.query("sonar").faults == 1


@pytest.mark.promise("ROB-3")
@pytest.mark.fault("D25")
@pytest.mark.parametrize("error", ODD, ids=lambda error: type(error).__name__)
async def test_an_odd_error_in_open_and_close_is_contained(
    error: BaseException,
) -> None:
    """A driver that raises SystemExit in open does not end the program."""

    class Sonar(esair.Sensor[float]):
        opened = 0

        async def open(self) -> None:
            self.opened += 1
            if self.opened == 1:
                raise error

        async def close(self) -> None:
            raise error

        async def read(self) -> float:
            return 1.0

    sonar = Sonar()
    async with esair.Robot(resources=[sonar]) as robot:
        assert robot.resources.query("sonar").state is esair.ResourceState.LOST
        await asyncio.sleep(1.0)
        assert robot.resources.query("sonar").state is esair.ResourceState.READY


@pytest.mark.fault("X02")
async def test_a_cancelled_writer_is_no_fault_of_the_device(
    fake_actuator: Any, user_of: Any
) -> None:
    """Whoever is cancelled in a write is cancelled, and the next one writes."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=2.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        wheels.stall()
        writing = asyncio.create_task(user.wheels.write(1.0))
        await asyncio.sleep(0.01)
        writing.cancel()
        await asyncio.wait({writing})
        wheels.resume()

        assert writing.cancelled()
        assert await user.wheels.write(2.0)
        assert robot.resources.query("wheels").faults == 0


@pytest.mark.fault("D23")
async def test_one_error_is_the_callers_and_the_next_call_works(
    fake_sensor: Any, user_of: Any
) -> None:
    """A single fault does not close the device."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        sonar.fail(ValueError("checksum"))
        with pytest.raises(
            esair.DeviceFaultError, match="ValueError: checksum"
        ) as caught:
            await user.sonar.read()
        assert isinstance(caught.value.__cause__, ValueError)
        assert await user.sonar.read() == 1.0
        assert sonar.opened == 1
        assert robot.resources.query("sonar").faults == 1


@pytest.mark.fault("D24")
async def test_faults_in_a_row_close_and_reopen_the_device(
    fake_sensor: Any, user_of: Any
) -> None:
    """Three in a row; a good answer in between begins the count anew."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        for times in (2, 2, 3):
            sonar.fail(ValueError("checksum"), times=times)
            for _ in range(times):
                with pytest.raises(esair.DeviceFaultError):
                    await user.sonar.read(fresh=True)
            if times == 2:
                await user.sonar.read(fresh=True)
        assert robot.resources.query("sonar").state is esair.ResourceState.LOST
        await asyncio.sleep(0.5)
        assert sonar.opened == 2
        assert await user.sonar.read() == 1.0


class Grumbling(esair.Actuator[float]):
    """Wheels that turn as they are told, and complain of it, or do not come back."""

    safe = 0.0
    deadline = 0.05

    def __init__(self, way: str) -> None:
        super().__init__(name="wheels")
        self.way = way
        self.hangs = False
        self.turns: list[tuple[float, float]] = []

    async def open(self) -> None:
        if self.hangs:
            raise ConnectionError("busy")
        await asyncio.sleep(0.5)

    def turn(self, command: float) -> None:
        self.turns.append((asyncio.get_running_loop().time(), command))

    async def write(self, command: float) -> None:
        self.turn(command)
        if command and self.way == "grumbles":
            raise ValueError("checksum")
        if command and self.way == "hangs":
            self.hangs = True
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(60.0)
            await asyncio.sleep(4.0)
            self.hangs = False
            self.turn(command)


@pytest.mark.promise("AC-2", "CALL-2")
@pytest.mark.fault("D24", "D21")
@pytest.mark.parametrize(
    ("way", "within"), [("grumbles", 0.2), ("hangs", 0.51), ("restarted", 0.2)]
)
async def test_a_device_that_is_closed_is_made_safe_first(
    way: str, within: float, user_of: Any
) -> None:
    """It is there, and turns as it was told; what it does late is undone at once."""
    wheels = Grumbling(way)
    user = user_of("user", wheels=esair.writes(float))
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        for _ in range(wheels.fault_limit if way == "grumbles" else 1):
            with contextlib.suppress(esair.EsairError):
                await user.wheels.write(1.0)
        if way == "restarted":
            await robot.resources.restart("wheels")
        await asyncio.sleep(6.0)
    turns = wheels.turns
    moved = [n for n, (_, command) in enumerate(turns) if command]
    assert len(moved) == {"grumbles": 3, "hangs": 2, "restarted": 1}[way]
    for n in moved:
        stopped = next(time for time, command in turns[n:] if command == 0.0)
        assert stopped - turns[n][0] <= within


@pytest.mark.promise("RES-2")
@pytest.mark.fault("D24", "B17")
async def test_a_device_that_is_always_at_fault_fails_for_good(
    fake_sensor: Any, user_of: Any
) -> None:
    """Its restarts are bounded; FAILED is visible and everything else runs."""
    sonar, other = fake_sensor("sonar", 1.0), fake_sensor("other", 2.0)
    user = user_of("user", sonar=esair.reads(float), other=esair.reads(float))

    async with esair.Robot(resources=[sonar, other], behaviors=[user]) as robot:
        sonar.fail(ValueError("checksum"), times=None)
        for _ in range(400):
            with pytest.raises((esair.DeviceFaultError, esair.DeviceLostError)):
                await user.sonar.read(fresh=True)
            await asyncio.sleep(0.05)

        assert robot.resources.query("sonar").state is esair.ResourceState.FAILED
        assert sonar.opened == 4
        assert await user.other.read() == 2.0
        with pytest.raises(esair.DeviceFaultError):
            await user.sonar.read()


@pytest.mark.fault("D26")
@pytest.mark.parametrize("value", ["1.0", None, True, b"1", [1.0]])
async def test_a_value_of_another_type_is_a_fault(user_of: Any, value: object) -> None:
    """The reader gets the name of the sensor and what was expected."""

    class Sonar(esair.Sensor[float]):
        async def read(self) -> Any:
            return value

    user = user_of("user", sonar=esair.reads(float))
    async with esair.Robot(resources=[Sonar()], behaviors=[user]):
        with pytest.raises(esair.DeviceFaultError, match=r"'sonar'.*expected float"):
            await user.sonar.read()


async def test_a_whole_number_is_a_float_reading(user_of: Any) -> None:
    """Drivers may give 1 where a float is promised."""

    class Sonar(esair.Sensor[float]):
        async def read(self) -> float:
            return 1

    user = user_of("user", sonar=esair.reads(float))
    async with esair.Robot(resources=[Sonar()], behaviors=[user]):
        assert await user.sonar.read() == 1


@pytest.mark.fault("D20", "D21")
async def test_a_read_that_does_not_return_is_cancelled_at_its_deadline(
    fake_sensor: Any, user_of: Any
) -> None:
    """The reader learns that the driver is stuck; the next read is a new one."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]):
        sonar.stall()
        with pytest.raises(esair.DriverStuckError, match="read did not return in 1 s"):
            await user.sonar.read(timeout=5.0)
        sonar.resume()
        assert await user.sonar.read() == 1.0


@pytest.mark.fault("D20", "D21")
async def test_a_write_that_does_not_return_is_cancelled_at_its_deadline(
    fake_actuator: Any, user_of: Any
) -> None:
    """The writer learns that the driver is stuck; then the safe command is sent."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        wheels.stall()
        with pytest.raises(esair.DriverStuckError, match="write did not return in 1 s"):
            await user.wheels.write(1.0)
        wheels.resume()
        await asyncio.sleep(5.0)
        assert wheels.commands == [0.0, 0.0]


@pytest.mark.fault("D23")
async def test_a_stream_that_raises_is_asked_for_again(user_of: Any) -> None:
    """One fault of a stream does not silence the sensor for ever."""
    begun = 0

    class Radar(esair.Sensor[float]):
        async def stream(self) -> AsyncIterator[float]:
            nonlocal begun
            begun += 1
            yield float(begun)
            raise ValueError("garbage")

    user = user_of("user", radar=esair.reads(float))
    async with esair.Robot(resources=[Radar()], behaviors=[user]) as robot:
        await asyncio.sleep(1.05)
        assert 5 <= begun <= 11
        assert robot.resources.query("radar").state is esair.ResourceState.READY
        assert await user.radar.read() == float(begun)


@pytest.mark.fault("D23")
async def test_the_first_fault_of_a_device_is_told(caplog: Any) -> None:
    """One that goes on after each of them would hide a mistake in its code for ever."""

    class Radar(esair.Sensor[float]):
        async def stream(self) -> AsyncIterator[float]:
            yield 1.0
            yield {"left": 1.0}["right"]

    async with esair.Robot(resources=[Radar()]):
        await asyncio.sleep(1.0)
    (told,) = [each for each in caplog.records if "fault" in each.getMessage()]
    assert told.getMessage().startswith("radar: first fault: ")
    assert told.getMessage().endswith("KeyError: 'right'")
    assert told.exc_info[0] is KeyError


@pytest.mark.fault("D26")
async def test_a_stream_of_wrong_values_closes_the_device(user_of: Any) -> None:
    """Wrong values count as faults of the device, also when nobody reads."""

    class Radar(esair.Sensor[float]):
        async def stream(self) -> AsyncIterator[Any]:
            while True:
                yield "?"
                await asyncio.sleep(0.01)

    async with esair.Robot(resources=[Radar()]) as robot:
        await asyncio.sleep(0.05)
        assert robot.resources.query("radar").state is esair.ResourceState.LOST


@pytest.mark.promise("TURN-6")
async def test_a_stream_that_nobody_hears_any_more_is_closed_at_once() -> None:
    """What it has to put away is not left to the collector, whose moment is another one."""
    closed: list[bool] = []

    class Radar(esair.Sensor[float]):
        async def stream(self) -> AsyncIterator[Any]:
            mine = asyncio.current_task()
            try:
                while True:
                    yield "?"
                    await asyncio.sleep(0.01)
            finally:
                closed.append(asyncio.current_task() is mine)
                raise ValueError("its end fails too")

    async with esair.Robot(resources=[Radar()]):
        await asyncio.sleep(0.05)
        assert closed == [True]


@pytest.mark.promise("RES-1")
@pytest.mark.real_clock
async def test_blocking_drivers_run_on_a_thread(user_of: Any) -> None:
    """Plain methods never run in the loop; they are called one after the other."""
    threads: set[str] = set()
    running = 0

    class Both:
        def note(self) -> None:
            threads.add(threading.current_thread().name)

    class Sonar(esair.Sensor[float], Both):
        def open(self) -> None:
            self.note()

        def read(self) -> float:
            self.note()
            return 1.0

        def close(self) -> None:
            self.note()

    class Arm(esair.Actuator[float], Both):
        safe = 0.0
        gain = esair.setting(1)

        def apply(self, **changes: Any) -> None:
            self.note()

        def write(self, command: float) -> float:
            nonlocal running
            self.note()
            running += 1
            assert running == 1
            running -= 1
            return command / 2

    user = user_of(
        "user", sonar=esair.reads(float), arm=esair.writes(float, configure=True)
    )
    async with esair.Robot(resources=[Sonar(), Arm(gain=2)], behaviors=[user]):
        assert await user.sonar.read() == 1.0
        written = await asyncio.gather(*(user.arm.write(1.0) for _ in range(5)))
        assert {each.command for each in written} == {0.5}
        await user.arm.configure(gain=3)

    assert threads == {"esair-sonar", "esair-arm"}


@pytest.mark.fault("D25")
async def test_a_stream_that_cancels_itself_is_at_fault(user_of: Any) -> None:
    """It is asked for again, as after any other error; its loss ends it."""
    streams: list[int] = []

    class Radar(esair.Sensor[float]):
        async def stream(self) -> AsyncIterator[float]:
            streams.append(len(streams))
            yield float(len(streams))
            await asyncio.sleep(0.1)
            if len(streams) == 1:
                raise asyncio.CancelledError
            await asyncio.sleep(3600.0)

    radar, user = Radar(), user_of("user", radar=esair.reads(float))
    async with esair.Robot(resources=[radar], behaviors=[user]) as robot:
        assert await user.radar.read() == 1.0
        await asyncio.sleep(2.0)
        assert robot.resources.query("radar").faults == 1
        assert await user.radar.read(max_age=60.0) == 2.0
        radar.report_lost(esair.DeviceLostError("radar", "its plug is out"))
        await asyncio.sleep(2.0)
        assert await user.radar.read(max_age=60.0) == 3.0
        assert robot.resources.query("radar").faults == 1


@pytest.mark.promise("CALL-2")
@pytest.mark.real_clock
async def test_what_a_blocking_stream_gives_after_a_loss_is_not_heard(
    user_of: Any,
) -> None:
    """It belongs to an opening that is over; the next one has a stream of its own."""
    go, seen = threading.Event(), list[float]()

    class Radar(esair.Sensor[float]):
        streams = 0

        def stream(self) -> Iterator[float]:
            self.streams += 1
            number = self.streams
            yield float(number)
            go.wait(30.0)
            yield number + 0.5

    radar, user = Radar(), user_of("user", radar=esair.reads(float))
    async with esair.Robot(resources=[radar], behaviors=[user]):

        async def follow() -> None:
            while True:
                with contextlib.suppress(esair.EsairError):
                    async for value in user.radar:
                        seen.append(value)
                await asyncio.sleep(0.01)

        following = asyncio.create_task(follow())
        await asyncio.sleep(0.1)
        radar.report_lost(esair.DeviceLostError("radar", "its plug is out"))
        await asyncio.sleep(0.1)
        go.set()
        for _ in range(1000):
            if 2.5 in seen:
                break
            await asyncio.sleep(0.01)
        following.cancel()
    assert 2.5 in seen
    assert 1.5 not in seen


@pytest.mark.promise("RES-1")
@pytest.mark.real_clock
async def test_a_blocking_stream_has_a_thread_of_its_own(user_of: Any) -> None:
    """Waiting for the next value does not keep the driver's other calls from running."""
    go = threading.Event()

    class Radar(esair.Sensor[float]):
        def stream(self) -> Iterator[float]:
            yield 1.0
            go.wait(5.0)
            yield 2.0

        def close(self) -> None:
            go.set()

    user = user_of("user", radar=esair.reads(float))
    async with esair.Robot(resources=[Radar()], behaviors=[user]):
        assert await user.radar.read() == 1.0


@pytest.mark.fault("X09", "D21")
@pytest.mark.real_clock
async def test_the_result_of_an_abandoned_thread_call_is_dropped(user_of: Any) -> None:
    """A reading that comes after its deadline is nobody's reading."""
    go = threading.Event()

    class Sonar(esair.Sensor[float]):
        deadline = 0.05
        asked = 0

        def read(self) -> float:
            self.asked += 1
            if self.asked == 1:
                go.wait(5.0)
                return 99.0
            return 1.0

    user = user_of("user", sonar=esair.reads(float))
    async with esair.Robot(resources=[Sonar()], behaviors=[user]):
        with pytest.raises(esair.DriverStuckError):
            await user.sonar.read()
        go.set()
        await asyncio.sleep(0.02)
        assert await user.sonar.read() == 1.0


@pytest.mark.fault("D25")
@pytest.mark.real_clock
@pytest.mark.parametrize("error", [SystemExit(3), Odd("?")], ids=["exit", "odd"])
async def test_an_odd_error_in_a_thread_is_contained(
    user_of: Any, error: BaseException
) -> None:
    """SystemExit in a blocking driver ends neither the thread nor the program."""

    class Arm(esair.Actuator[float]):
        safe = 0.0

        def write(self, command: float) -> None:
            if command == 1.0:
                raise error

    user = user_of("user", arm=esair.writes(float))
    async with esair.Robot(resources=[Arm()], behaviors=[user]):
        with pytest.raises(esair.DeviceFaultError):
            await user.arm.write(1.0)
        assert await user.arm.write(0.5)


@pytest.mark.fault("D28")
@pytest.mark.real_clock
async def test_a_driver_may_report_from_its_own_thread() -> None:
    """A loss reported on any thread is heard; after the removal nobody listens."""

    class Sonar(esair.Sensor[float]):
        def read(self) -> float:
            return 1.0

    def in_thread(function: Any) -> None:
        thread = threading.Thread(target=function)
        thread.start()
        thread.join()

    sonar = Sonar()
    async with esair.Robot(resources=[sonar]) as robot:
        in_thread(sonar.report_lost)
        await until(
            lambda: robot.resources.query("sonar").state is esair.ResourceState.LOST
        )
        in_thread(sonar.report_arrived)
        await until(
            lambda: robot.resources.query("sonar").state is esair.ResourceState.READY
        )
        await robot.resources.remove("sonar")
        in_thread(sonar.report_lost)
        in_thread(sonar.report_arrived)


@pytest.mark.fault("D01", "O17")
@pytest.mark.parametrize(
    ("error", "lost"),
    [
        (ConnectionResetError("gone"), True),
        (EOFError(), True),
        (FileNotFoundError(), True),
        (OSError(errno.ENODEV, "no device"), True),
        (OSError(errno.EIO, "noise"), False),
        (PermissionError(), False),
        (ValueError("checksum"), False),
        (esair.DeviceLostError("other"), True),
    ],
)
def test_what_a_driver_raises_says_whether_its_device_is_gone(
    error: Exception, lost: bool
) -> None:
    """Gone is gone; anything else is a fault of a device that is there."""
    assert is_loss(error) is lost
    wanted = esair.DeviceLostError if lost else esair.DeviceFaultError
    translated = translate("sonar", error)
    assert type(translated) is wanted
    assert translated.resource == "sonar"  # type: ignore[union-attr]


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("D28")
async def test_late_readings_of_a_closed_device_are_dropped(user_of: Any) -> None:
    """A poll that ends after the loss gives no reading to anybody."""
    go = asyncio.Event()
    seen: list[float] = []

    class Slow(esair.Sensor[float]):
        rate = 10.0

        async def read(self) -> float:
            try:
                await go.wait()
            except asyncio.CancelledError:
                await asyncio.sleep(0.01)  # it takes its time to give up
            return 1.0

    class Look(esair.Reaction):
        slow = esair.reads(float)

        def react(self, slow: float) -> None:
            seen.append(slow)

    slow = Slow()
    async with esair.Robot(
        resources=[slow], behaviors=[Look()], start_patience=0.01
    ) as robot:
        await asyncio.sleep(0.25)
        assert robot.sensors.channels["slow"].asking.missed >= 1
        slow.report_lost()
        await asyncio.sleep(0.05)
        assert seen == []


async def until(condition: Callable[[], bool]) -> None:
    """Wait for a condition; generous, for a busy machine."""
    async with asyncio.timeout(20.0):
        while not condition():  # noqa: ASYNC110 - it is another thread's state
            await asyncio.sleep(0.005)


@pytest.mark.fault("D21")
@pytest.mark.real_clock
async def test_reopening_a_blocking_stream_adds_no_thread(user_of: Any) -> None:
    """While its thread still waits for the device from before, the driver is stuck."""
    go = threading.Event()

    class Pusher(esair.Sensor[float]):
        deadline = 0.05
        fault_limit = 1000
        stuck = True

        def stream(self) -> Any:
            yield 1.0
            while self.stuck:
                go.wait(0.01)
            yield 2.0
            go.wait(10.0)

    def threads() -> int:
        return sum("pusher_stream" in t.name for t in threading.enumerate())

    pusher = Pusher()
    user = user_of("user", pusher=esair.reads(float))
    async with esair.Robot(resources=[pusher], behaviors=[user]) as robot:
        channel = robot.sensors.channel("pusher")
        await until(lambda: channel.newest is not None)  # and waits for the next value
        for _ in range(3):
            await until(lambda: channel.state is esair.ResourceState.READY)
            pusher.report_lost(ConnectionError("cable"))
        await until(lambda: robot.resources.query("pusher").faults > 1)
        assert threads() == 1
        pusher.stuck = False  # the thread comes back from the device from before
        await until(lambda: channel.newest is not None)
        assert threads() == 1
        go.set()
    await until(lambda: threads() == 0)
