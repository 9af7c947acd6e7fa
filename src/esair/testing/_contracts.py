"""Contract suites: what every driver, and every bus, must do; to be run on yours.

Subclass a suite in a test module, and say how the device is made::

    class TestSonar(SensorContract):
        def make(self):
            return Sonar(bus=FakeSerial(...))

The tests run on the virtual clock; mark the class ``real_clock`` for a device that
is real, and ``placements`` for a sensor that may live in a process of its own: each test
runs once in the robot's process, and once there.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
import functools
import inspect
import itertools
from collections.abc import AsyncIterator, Awaitable
from typing import Any, ClassVar

import pytest

from esair.buses import Bus
from esair.connections import CommandCheck, Driver, translate
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    StaleReadingError,
)
from esair.messages import Access, Policy, ResourceState, is_placed
from esair.plan import Plan, errors_in, examine_resource
from esair.resources import Actuator, Resource, Sensor, settings_of
from esair.standard import Robot
from esair.values import checked_class

LONGEST_PAUSE = 8.0
"""How long a device may take to be found once it has power, in seconds."""

_ME = "contract"

_ABSENT = DeviceLostError, DeviceFaultError, DriverStuckError, StaleReadingError


class ResourceContract(abc.ABC):
    """What sensors and actuators have in common."""

    pytestmark: ClassVar[list[Any]] = [pytest.mark.asyncio, pytest.mark.virtual_clock]

    silent_for: ClassVar[float] = 12.0
    """How long its power is away at first, in seconds; less on the real clock."""

    is_heard: ClassVar[bool] = True
    """Whether the robot hears anything of the part: an answer, a value, an acknowledge.

    A part that is only talked to is never missed: it is READY without power too.
    """

    _nothing_went_out: ClassVar[str] = (
        "it was used without its cable and raised nothing: ask the device each time, and "
        "let the error of its bus pass"
    )
    """What is said of a device whose use is well while its cable is away."""

    keeps_nothing: ClassVar[str] = ""
    """Why a restart of the part takes nothing away, if the driver has no `is_set_up`."""

    @pytest.fixture(autouse=True)
    def _placed(self, request: pytest.FixtureRequest) -> None:
        if "place" in request.fixturenames:
            place, make = request.getfixturevalue("place"), self.make
            self.make = lambda: place(make())  # type: ignore[method-assign]

    @abc.abstractmethod
    def make(self) -> Resource:
        """Make a device that is there, closed; a new one for each test."""

    async def unplug(self, device: Any) -> None:
        """Take the device away, as a cable that is pulled.

        This and the next three call what the device, or its bus, has of that name, as
        those of the fakes do; override them for others, or their tests are skipped.
        """
        await tell(_told_by(device, "unplug"), "unplug")

    async def silence(self, device: Any) -> None:
        """Take the device's power away, not its cable."""
        await tell(_told_by(device, "silence"), "silence")

    async def speak(self, device: Any) -> None:
        """Give the device its power back."""
        await tell(_told_by(device, "speak"), "speak")

    async def power_cycle(self, device: Any) -> None:
        """Take its power away for a moment, unnoticed."""
        await tell(_told_by(device, "power_cycle"), "power_cycle")

    async def use(self, driver: Driver) -> Any:
        """Use the open device once."""
        raise NotImplementedError

    async def test_it_opens_and_closes_again_and_again(self) -> None:
        """A device is opened after each loss, by the same object."""
        async with _Session(self.make()) as session:
            for _ in range(3):
                await session.open()
                await self.use(session.driver)
                await session.close()

    async def test_it_can_be_closed_twice(self) -> None:
        """A close that follows another one, or no opening at all, does no harm."""
        async with _Session(self.make()) as session:
            await session.close()
            await session.open()
            await session.close()
            await session.close()

    async def test_its_settings_go_there_and_back(self) -> None:
        """Each setting is accepted with its default, and with its limits."""
        device = self.make()
        async with _Session(device) as session:
            await session.open()
            before = dict(device.settings)
            for name, described in settings_of(type(device)).items():
                values = [described.min, described.max, *(described.choices or ())]
                for value in [*values, described.default]:
                    if value is not None:
                        checked = described.check(device.name, described.type(value))
                        await session.call("apply", **{name: checked})
                        now = dict(device.settings)
                        assert now == before, (
                            f"apply() has set {name!r}: only send it to the device, "
                            "the attribute changes after apply() has returned"
                        )
            await session.call("apply", **before)
            await self.use(session.driver)

    async def test_it_says_when_it_is_gone(self) -> None:
        """Using a device that was unplugged raises a kind of ConnectionError."""
        device = self.make()
        async with _Session(device) as session:
            await session.open()
            await self.unplug(device)
            raised: Exception | None = None
            try:
                await self.use(session.driver)
            except Exception as error:
                raised = error
            assert raised is not None, self._nothing_went_out
            assert isinstance(translate(device.name, raised), DeviceLostError), (
                f"raise esair.DeviceLostError, or another ConnectionError, when the "
                f"device is gone; it raised {raised!r}: name the errors of a package "
                "once in the class, errors = {package.Error: esair.DeviceLostError}"
            )

    async def test_silent_first_then_there(self) -> None:
        """A part whose power comes later comes up by itself, however late."""
        device = self.make()
        await self.silence(device)
        await self._comes_late(device)

    async def _comes_late(self, device: Any) -> None:
        absent = {ResourceState.LOST, ResourceState.OPENING}
        async with _robot_with(device) as robot:
            status = functools.partial(robot.resources.query, device.name)
            if not self.is_heard:
                await _in_time(_until_ready(robot, device), LONGEST_PAUSE, NOT_READY)
            for _ in range(12):
                await asyncio.sleep(self.silent_for / 12)
                state = status().state
                if self.is_heard:
                    assert state in absent, (
                        f"it is {state.name} without power: ask the part something in "
                        "open(), and raise what says that it is absent as esair."
                        "DeviceLostError; if nothing is ever heard of it, write "
                        "is_heard = False in the suite"
                    )
                else:
                    assert state not in absent, (
                        f"it is {state.name} though nothing is heard of it: open() must "
                        "not wait for an answer, or leave out is_heard = False"
                    )
            await self.speak(device)
            await _in_time(_until_used(robot, device), LONGEST_PAUSE, NOT_BACK)
            assert self.is_heard or not status().losses, (
                "it was lost though nothing is heard of it: leave out is_heard = False"
            )

    async def test_power_cycle(self) -> None:
        """A part that has restarted is set up again, if there is something to lose."""
        device = self.make()
        can_tell = device.can_tell_set_up
        default = type(self).power_cycle is ResourceContract.power_cycle
        if default and _told_by(device, "power_cycle") is None:
            pytest.skip("override power_cycle() to test this")
        async with _robot_with(device) as robot:
            await _in_time(_until_used(robot, device), PATIENCE, NOT_READY)
            before = robot.resources.query(device.name).losses
            await self.power_cycle(device)
            assert can_tell or self.keeps_nothing, (
                "write is_set_up() in the driver, or say in the suite why a restart of "
                "the part takes nothing away: keeps_nothing = '...'"
            )
            await asyncio.sleep(device.set_up_period + device.deadline)
            await _in_time(_until_used(robot, device), LONGEST_PAUSE, NOT_BACK)
            losses = robot.resources.query(device.name).losses - before
            assert losses <= 1, f"one restart was told as {losses} losses"
            assert losses or not can_tell, (
                "the part has restarted and is_set_up() did not notice: read something "
                "back there that is another one after a restart"
            )

    async def test_its_calls_end_within_its_deadline(self) -> None:
        """A use of the device takes no longer than the device itself says."""
        device = self.make()
        async with _Session(device) as session:
            await session.open()
            told = (
                f"a use took longer than deadline = {device.deadline:g} s: end it before "
                "with a time-out of your own, or give the class a longer deadline"
            )
            await _in_time(self.use(session.driver), device.deadline, told)


class GatewayContract(ResourceContract):
    """What a part keeps, besides its suite, if something else can answer for it.

    Its class comes first: ``class TestUnit(GatewayContract, SensorContract)``.
    """

    @abc.abstractmethod
    async def silence_by_proxy(self, device: Any) -> None:
        """Take its power away; what stands between says that it is absent or busy."""

    async def test_silence_that_another_tells_of_is_silence(self) -> None:
        """It is waited for, for ever, and comes up by itself once `speak` was called."""
        device = self.make()
        await self.silence_by_proxy(device)
        await self._comes_late(device)


def _told_by(device: Any, what: str) -> Any:
    """Return what does it: a method of the device, or of the bus that it is on."""
    return getattr(device, what, None) or getattr(device.bus, what, None)


def _robot_with(device: Resource) -> Robot:
    right = Access.READ if isinstance(device, Sensor) else Access.WRITE
    policy = Policy(device.name, allow={_ME: right})
    return Robot(resources=[device], policies=[policy])


NOT_READY = "it was not READY in time: what open() raises says why"
NOT_BACK = (
    "its power is back, and it is not: open() must work again on the same object after a "
    "loss, so forget in close() what belongs to the connection that is over"
)


async def _in_time(waiting: Awaitable[Any], seconds: float, told: str) -> None:
    """Wait; say in a sentence what is wrong if it takes too long."""
    try:
        async with asyncio.timeout(seconds) as limit:
            await waiting
    except TimeoutError as error:
        if not limit.expired():
            raise
        raise AssertionError(told) from error


async def _until_ready(robot: Robot, device: Resource) -> None:
    query = robot.resources.query
    while query(device.name).state is not ResourceState.READY:  # noqa: ASYNC110
        await asyncio.sleep(0.01)


async def _until_used(robot: Robot, device: Resource) -> None:
    """Use a device through the robot, as soon as it is there."""
    while True:
        await _until_ready(robot, device)
        try:
            if isinstance(device, Actuator):
                right = await robot.resources.register(_ME, device.name, Access.WRITE)
                assert await robot.actuators.write(right, device.safe)
            else:
                right = await robot.resources.register(_ME, device.name, Access.READ)
                await robot.sensors.read(right, fresh=True, timeout=PATIENCE)
        except _ABSENT:
            await asyncio.sleep(0.01)  # its loss is just being noticed
        else:
            return


class SensorContract(ResourceContract):
    """What every sensor must do."""

    @abc.abstractmethod
    def make(self) -> Sensor[Any]:
        """Make a sensor that is there, closed; a new one for each test."""

    async def use(self, driver: Driver) -> Any:
        """Take one value from the open sensor."""
        sensor = driver.resource
        assert isinstance(sensor, Sensor)
        if sensor.can_be_asked:
            return await driver.call("read")
        stream: Any = sensor.stream()
        async with asyncio.timeout(PATIENCE):
            if hasattr(stream, "__anext__"):
                try:
                    return await anext(stream)
                finally:
                    await stream.aclose()
            return await driver.executor.call(next, iter(stream), timeout=PATIENCE)

    async def test_it_gives_values_of_its_type(self) -> None:
        """Three values in a row are what the class says that they are."""
        sensor = self.make()
        async with _Session(sensor) as session:
            await session.open()
            wanted = checked_class(sensor.value_type)
            for _ in range(3):
                value = await self.use(session.driver)
                if wanted is None:
                    continue
                is_number = wanted is float and type(value) in {float, int}
                assert is_number or (
                    wanted is not float and isinstance(value, wanted)
                ), f"it gave {value!r:.80}: its class says {wanted.__name__}"

    async def test_it_can_be_read_or_pushes(self) -> None:
        """A sensor has a ``read``, a ``stream``, or both."""
        sensor = self.make()
        assert sensor.can_be_asked or sensor.pushes, "write a read() or a stream()"


class ActuatorContract(ResourceContract):
    """What every actuator must do."""

    _nothing_went_out: ClassVar[str] = (
        "write() took the safe command without a cable and raised nothing: the safe "
        "command has to be sent to the device, each time, whatever was sent before"
    )

    @abc.abstractmethod
    def make(self) -> Actuator[Any]:
        """Make an actuator that is there, closed; a new one for each test."""

    def commands(self) -> list[Any]:
        """Return commands that the device must take; its safe one unless overridden."""
        return []

    async def use(self, driver: Driver) -> Any:
        """Tell the open actuator its safe command."""
        actuator = driver.resource
        assert isinstance(actuator, Actuator)
        return await driver.call("write", actuator.safe)

    async def test_it_declares_what_is_safe(self) -> None:
        """It has a safe command, within its limits, and a command time-out above 0."""
        mistakes = errors_in(examine_resource(Plan(), self.make()))
        assert mistakes == [], "; ".join(map(str, mistakes))

    async def test_it_takes_its_safe_command_at_any_time(self) -> None:
        """Right after the opening, twice in a row, and after each other command."""
        actuator = self.make()
        async with _Session(actuator) as session:
            await session.open()
            await session.call("write", actuator.safe)
            await session.call("write", actuator.safe)
            for command in self.commands():
                await session.call("write", command)
                await session.call("write", actuator.safe)

    async def test_write_answers_nothing_or_what_was_applied(self) -> None:
        """What it returns is None or a command of its own type, within its limits."""
        actuator = self.make()
        check = CommandCheck(actuator)
        async with _Session(actuator) as session:
            await session.open()
            for command in [actuator.safe, *self.commands()]:
                applied = await session.call("write", check.checked(command))
                if applied is not None:
                    check.checked(applied)
            await session.call("write", actuator.safe)


class _Session:
    """One device in a test: whatever happens it is closed, and its thread ended."""

    def __init__(self, device: Resource) -> None:
        self.device = device
        self.driver = Driver(device)
        self.seats: Any = None
        if is_placed(device):
            from esair.placement import Seats

            self.seats = Seats(lambda: [device], lambda _: None)

    async def __aenter__(self) -> _Session:
        if self.seats is not None:
            await self.seats.ready()
            self.seats.seat(self.device).sit()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()
        if self.seats is not None:
            self.seats.close()
        assert await self.driver.end_executors(timeout=1.0), "a driver call is stuck"
        if self.device.bus is not None:
            await self.device.bus.close()

    async def open(self) -> None:
        if self.device.bus is not None:
            await self.device.bus.open()
        await self.call("open")

    async def close(self) -> None:
        await self.call("close")

    async def call(self, method: str, *args: Any, **options: Any) -> Any:
        return await self.driver.call(method, *args, **options)


PATIENCE = 5.0  # How long a suite waits for what has to happen, in seconds


class BusContract(abc.ABC):
    """What all buses have in common, whatever their medium."""

    pytestmark: ClassVar[list[Any]] = [pytest.mark.asyncio, pytest.mark.virtual_clock]

    longest_stall: ClassVar[float] = 0.5
    """How long the event loop may be kept, in seconds; far more than a bus needs."""

    @abc.abstractmethod
    def make(self) -> Bus:
        """Make a bus that is there, closed; a new one for each test."""

    @abc.abstractmethod
    async def use(self, bus: Any) -> None:
        """Use the open bus once, in both directions if it has two."""

    async def unplug(self, bus: Any) -> None:
        """Take the wire away, as a cable that is pulled; skips unless overridden."""
        await tell(getattr(bus, "unplug", None), "unplug")

    async def plug(self, bus: Any) -> None:
        """Bring the wire back; skips unless overridden."""
        await tell(getattr(bus, "plug", None), "plug")

    async def stall(self, bus: Any) -> None:
        """Let the other end take and give nothing; skips unless overridden."""
        await tell(getattr(bus, "stall", None), "stall")

    async def resume(self, bus: Any) -> None:
        """Let the other end go on; skips unless overridden."""
        await tell(getattr(bus, "resume", None), "resume")

    async def ask(self, bus: Any, number: int) -> int:
        """Ask for a number and return the one that was answered; skips unless overridden.

        The other end answers with the number that it was asked for.
        """
        pytest.skip("override ask() and delay() to test whose an answer is")

    async def delay(self, bus: Any, seconds: float) -> None:
        """Let the other end answer so much later from now on; skips unless overridden."""
        pytest.skip("override ask() and delay() to test whose an answer is")

    async def test_cancel_then_ask(self) -> None:
        """An answer to a request that was given up is never that to another."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.delay(bus, 0.05)
            for number, given_up in enumerate((0.0, 0.02, 0.04) * 2, 1):
                asking = asyncio.ensure_future(self.ask(bus, number))
                await asyncio.sleep(given_up)
                asking.cancel()
                await asyncio.wait({asking})
                for other in (10 * number, 10 * number + 1):
                    assert await self.ask(bus, other) == other

    async def test_it_opens_and_closes_again_and_again(self) -> None:
        """A bus is opened after each loss, by the same object."""
        async with _closing(self.make()) as bus:
            for n in range(1, 4):
                await bus.open()
                assert bus.is_open
                await self.use(bus)
                await bus.close()
                assert not bus.is_open
                assert bus.stats.opened == n

    async def test_it_can_be_closed_twice(self) -> None:
        """A close that follows another one, or no opening at all, does no harm."""
        async with _closing(self.make()) as bus:
            await bus.close()
            await bus.open()
            await bus.close()
            await bus.close()

    async def test_all_who_open_it_share_one_opening(self) -> None:
        """A bus has one owner, however many devices are on it."""
        async with _closing(self.make()) as bus:
            await asyncio.gather(*(bus.open() for _ in range(5)))
            assert bus.stats.opened == 1
            await self.use(bus)

    async def test_it_counts_what_it_does(self) -> None:
        """What is sent or received shows in its statistics, and no error does."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.use(bus)
            assert bus.stats.sent + bus.stats.received > 0
            assert bus.stats.errors == 0

    async def test_it_cannot_be_used_closed(self) -> None:
        """The error names the bus, at once."""
        async with _closing(self.make()) as bus:
            with pytest.raises(DeviceLostError, match=bus.name):
                await self.use(bus)

    async def test_its_loss_is_told_once(self) -> None:
        """Whoever listens hears it, whoever uses it gets the error."""
        async with _closing(self.make()) as bus:
            told: list[BaseException] = []
            bus.on_lost(told.append)
            await bus.open()
            await self.use(bus)
            await self.unplug(bus)
            for _ in range(3):
                with pytest.raises(DeviceLostError):
                    await _until_lost(self, bus)
            assert len(told) == 1
            assert bus.stats.lost == 1
            assert bus.stats.last_error

    async def test_it_comes_back(self) -> None:
        """After a loss the same object is opened again and works as before."""
        async with _closing(self.make()) as bus:
            await bus.open()
            for _ in range(3):
                await self.unplug(bus)
                with pytest.raises(DeviceLostError):
                    await _until_lost(self, bus)
                with pytest.raises(EsairError):
                    await bus.open()
                await self.plug(bus)
                await bus.open()
                await self.use(bus)

    async def test_a_stalled_wire_costs_only_its_user(self) -> None:
        """The use ends with an error in time; the loop turns, the close is quick."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.stall(bus)
            async with _heart() as beats, asyncio.timeout(PATIENCE):
                with pytest.raises(EsairError):
                    await _until_error(self, bus)
            assert max(beats) < self.longest_stall
            async with _heart() as beats, asyncio.timeout(PATIENCE):
                await bus.close()
            assert max(beats) < self.longest_stall
            await self.resume(bus)

    async def test_it_works_after_a_stall(self) -> None:
        """A bus that was stuck, closed and opened again is as good as new."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.stall(bus)
            async with asyncio.timeout(PATIENCE):
                with pytest.raises(EsairError):
                    await _until_error(self, bus)
            await bus.close()
            await self.resume(bus)
            await bus.open()
            await self.use(bus)


async def tell(method: Any, what: str) -> None:
    """Call what a test needs of a device or bus; skip where there is none."""
    if method is None:
        pytest.skip(f"override {what}() to test this")
    result = method()
    if inspect.isawaitable(result):
        await result


async def _until_lost(suite: BusContract, bus: Bus) -> None:
    """Use a bus until its loss is noticed, which a reader does on its own."""
    async with asyncio.timeout(PATIENCE):
        while True:
            await suite.use(bus)
            await asyncio.sleep(0.001)


async def _until_error(suite: BusContract, bus: Bus) -> None:
    """Use a bus that is stalled; buffers on the way take something first.

    Now and then time passes, or a use that never waits would go on for ever.
    """
    for n in itertools.count(1):
        await suite.use(bus)
        await asyncio.sleep(0.0 if n % 16 else 0.001)


@contextlib.asynccontextmanager
async def _closing(bus: Bus) -> AsyncIterator[Bus]:
    try:
        yield bus
    finally:
        await bus.close()


@contextlib.asynccontextmanager
async def _heart() -> AsyncIterator[list[float]]:
    """Measure how long the event loop was kept at most, in seconds."""
    loop = asyncio.get_running_loop()
    beats = [0.0]

    async def beat() -> None:
        before = loop.time()
        try:
            while True:
                await asyncio.sleep(0.005)
                now = loop.time()
                beats.append(now - before - 0.005)
                before = now
        finally:  # what kept the loop may be just over
            beats.append(loop.time() - before - 0.005)

    beating = loop.create_task(beat())
    await asyncio.sleep(0)  # it begins before what may keep the loop
    try:
        yield beats
    finally:
        beating.cancel()
        await asyncio.wait({beating})
