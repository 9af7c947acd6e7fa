"""The contract suites hold for the fakes and for drivers that block, and find mistakes."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from typing import Any

import pytest

import esair
from esair.buses import SerialBus
from esair.testing import (
    ActuatorContract,
    FakeActuator,
    FakeSensor,
    FakeSerial,
    SensorContract,
)


class PackageError(Exception):
    """What a package raises."""


class Foreign(esair.Sensor[float]):
    """Its package says everything in one kind of error."""

    errors = {PackageError: esair.DeviceLostError, KeyError: esair.DeviceFaultError}  # noqa: RUF012

    def open(self) -> None:
        raise PackageError("no route")

    async def read(self) -> float:
        raise KeyError("x")

    async def stream(self) -> AsyncIterator[float]:
        yield 1.0
        raise PackageError("gone")


@pytest.mark.virtual_clock
async def test_errors_of_a_package_are_named_once() -> None:
    """In plain methods, coroutines and streams; others stay what they are."""
    device = Foreign(name="far")
    with pytest.raises(esair.DeviceLostError, match=r"far.*PackageError: no route"):
        device.open()
    with pytest.raises(esair.DeviceFaultError, match=r"far.*KeyError"):
        await device.read()
    with pytest.raises(esair.DeviceLostError, match="gone"):
        assert [value async for value in device.stream()] == []

    class Nearer(Foreign):
        def open(self) -> None:
            raise ValueError("its own")

    with pytest.raises(ValueError, match="its own"):
        Nearer().open()


class TestFakeSensor(SensorContract):
    def make(self) -> FakeSensor[float]:
        return FakeSensor("sonar", 1.0, type=float)


class TestFakeActuator(ActuatorContract):
    def make(self) -> FakeActuator[float]:
        return FakeActuator("wheels", safe=0.0, limits=(-1.0, 1.0))

    def commands(self) -> list[float]:
        return [-1.0, 0.5, 1.0]


class Blocking(esair.Sensor[float]):
    """A driver with plain methods."""

    gain = esair.setting(1, min=1, max=3)
    is_open = plugged = powered = set_up = True
    set_up_period = 0.1

    def open(self) -> None:
        self.check()
        self.is_open = self.set_up = True

    def is_set_up(self) -> bool:
        self.check()
        return self.set_up

    def check(self) -> None:
        if not self.plugged:
            raise ConnectionError("gone")
        if not self.powered:
            raise TimeoutError("silent")

    def close(self) -> None:
        self.is_open = False

    def apply(self, **changes: Any) -> None:
        assert self.is_open

    def read(self) -> float:
        self.check()
        return 1.5

    def unplug(self) -> None:
        self.plugged = False

    def silence(self) -> None:
        self.powered = False

    def speak(self) -> None:
        self.powered = True

    def power_cycle(self) -> None:
        self.set_up = False


@pytest.mark.real_clock
class TestBlockingSensor(SensorContract):
    silent_for = 1.0

    def make(self) -> Blocking:
        return Blocking()


class BlockingArm(esair.Actuator[float]):
    safe = 0.0
    plugged = True

    def write(self, command: float) -> float:
        if not self.plugged:
            raise ConnectionError("gone")
        return command / 2

    async def unplug(self) -> None:
        self.plugged = False

    def silence(self) -> None:
        """Be as ever: nobody hears it."""

    speak = power_cycle = silence


@pytest.mark.real_clock
class TestBlockingActuator(ActuatorContract):
    silent_for = 0.2
    is_heard = False
    keeps_nothing = "each command says all that it needs"

    def make(self) -> BlockingArm:
        return BlockingArm(name="arm")


class Pushing(esair.Sensor[int]):
    plugged = True

    async def stream(self) -> AsyncIterator[int]:
        for value in itertools.count():
            if not self.plugged:
                raise ConnectionError("it is gone")
            yield value
            await asyncio.sleep(0.1)


class Pulled(Pushing):
    """It can be taken away, and be without power."""

    async def open(self) -> None:
        if not self.plugged:
            raise ConnectionError("it is not there")

    def unplug(self) -> None:
        self.plugged = False

    def speak(self) -> None:
        self.plugged = True

    def power_cycle(self) -> None:
        """Be as ever."""

    silence = unplug


class TestPushingSensor(SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> Pulled:
        return Pulled()


class Deaf(FakeSensor[Any]):
    """A driver with a mistake in each of its methods."""

    async def close(self) -> None:
        assert self.is_open, "closed twice"
        await super().close()

    async def apply(self, **changes: Any) -> None:
        for name, value in changes.items():
            setattr(self, name, value)

    async def read(self) -> Any:
        if not self._faults.plugged:
            raise ValueError("no answer")
        return "far"


class Unsafe(FakeActuator[float]):
    async def write(self, command: float) -> Any:
        if self.commands and command == 0.0:
            raise ValueError("twice")
        await super().write(command)
        return "done"


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("suite", "device", "test"),
    [
        (SensorContract, Deaf, "test_it_can_be_closed_twice"),
        (SensorContract, Deaf, "test_its_settings_go_there_and_back"),
        (SensorContract, Deaf, "test_it_says_when_it_is_gone"),
        (SensorContract, Deaf, "test_it_gives_values_of_its_type"),
        (ActuatorContract, Unsafe, "test_it_takes_its_safe_command_at_any_time"),
        (ActuatorContract, Unsafe, "test_write_answers_nothing_or_what_was_applied"),
    ],
)
async def test_a_driver_with_a_mistake_does_not_pass(
    suite: Any, device: Any, test: str
) -> None:
    """Each suite finds what it is there for."""

    class Suite(suite):  # type: ignore[misc]
        def make(self) -> Any:
            if device is Deaf:
                return Deaf("deaf", 1.0, type=float)
            return device("unsafe", 0.0)

    with pytest.raises((AssertionError, ValueError)):
        await getattr(Suite(), test)()


class Careless(Blocking):
    """A driver that asks nothing, notices nothing and takes its time."""

    blocking = False
    deadline = 0.5

    def open(self) -> None:
        """Ask nothing."""

    async def is_set_up(self) -> bool:  # type: ignore[override]
        return True

    async def read(self) -> float:  # type: ignore[override]
        await asyncio.sleep(0.7)
        return True


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("test", "told"),
    [
        ("test_silent_first_then_there", r"ask the part something in open\(\)"),
        ("test_power_cycle", r"was not READY|is_set_up\(\) did not notice"),
        ("test_its_calls_end_within_its_deadline", "longer than deadline = 0.5 s"),
        ("test_it_gives_values_of_its_type", "it gave True: its class says float"),
    ],
)
async def test_a_failure_says_what_to_write(test: str, told: str) -> None:
    """In a sentence, for an author who has not read the suite."""

    class Suite(SensorContract):
        silent_for = 1.0

        def make(self) -> Careless:
            return Careless()

    with pytest.raises(AssertionError, match=told):
        await getattr(Suite(), test)()


class Forgetful(esair.Actuator[float]):
    """It sends what is new, and takes its safe command for what was there before."""

    bus: SerialBus
    safe = 0.0

    async def write(self, command: float) -> None:
        if command != self.safe:
            await self.bus.send(b"%g" % command)


class Remembering(esair.Sensor[float]):
    """It gives what it has heard at its opening."""

    bus: SerialBus

    async def read(self) -> float:
        return 1.0


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("suite", "device", "told"),
    [
        (ActuatorContract, Forgetful, "the safe command has to be sent to the device"),
        (SensorContract, Remembering, "ask the device each time"),
    ],
)
async def test_who_reaches_no_far_end_is_told_so(
    suite: Any, device: Any, told: str
) -> None:
    """Without its cable nothing fails: what to write is in the failure."""

    class Suite(suite):  # type: ignore[misc]
        def make(self) -> Any:
            return device(bus=FakeSerial())

    with pytest.raises(AssertionError, match=told):
        await Suite().test_it_says_when_it_is_gone()


@pytest.mark.virtual_clock
async def test_a_device_that_cannot_be_unplugged_skips_that_test() -> None:
    """Nobody is forced to pull a real cable."""

    class Suite(SensorContract):
        def make(self) -> Pushing:
            return Pushing()

    with pytest.raises(pytest.skip.Exception, match=r"override unplug\(\) to test"):
        await Suite().test_it_says_when_it_is_gone()
