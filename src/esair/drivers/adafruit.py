"""Any Adafruit CircuitPython driver of an I²C or SPI part, as a sensor or an actuator.

Adafruit's drivers expect a ``busio.I2C`` or a ``busio.SPI``; `AdafruitBus` and `AdafruitSpi`
look like them, and are an `esair.buses.I2CBus` and an `esair.buses.spi.SpiBus`. They
block, so they run on the thread of that bus, and nobody else uses the bus during one call of
theirs: a driver that sleeps makes the others wait::

    [sensor.air]
    driver = "adafruit"
    bus = "chips"
    library = "adafruit_bme280.basic:Adafruit_BME280_I2C"
    address = 0x76
    value = ["temperature", "pressure"]

    [sensor.oven]
    driver = "adafruit"
    bus = "fast"
    library = "adafruit_max31855:MAX31855"
    chip = 0
    value = "temperature"

    [actuator.lamp]
    driver = "adafruit"
    bus = "chips"
    library = "adafruit_pca9685:PCA9685"
    attribute = "channels[0].duty_cycle"
    safe = 0

Source: the API of ``busio`` of CircuitPython, and of adafruit_bus_device 5.2.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Required, Self, TypedDict, Unpack

from esair.buses import I2CBus
from esair.buses.i2c import SILENT, probe, transfer
from esair.buses.spi import SpiBus
from esair.drivers._on_bus import shared
from esair.drivers.object import Made, MadeActuator, MadeSensor, OnObject
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.loop import now
from esair.resources import ActuatorSettings, Resource, SensorSettings

__all__ = ["AdafruitActuator", "AdafruitBus", "AdafruitSensor", "AdafruitSpi"]

_SHORTEST = 20e-6  # What a transfer takes: an address at 1 MHz, in seconds

# adafruit_register has one buffer for all drivers of a process: with two buses, and
# so two threads, one driver would send what another has just put there.
_one_at_a_time = threading.Lock()


class _Wire:
    """What a bus of CircuitPython is on the thread of a bus of the robot.

    Plain methods of drivers run there and nobody else can come in between, so the bus is
    always free to be locked.
    """

    def __init__(self) -> None:
        self.transfers: int = 0
        """How many have been made."""
        self.is_silent: bool = False
        """Whether all that came since the opening may be an idle wire."""
        self._until = self._most = math.inf

    def allow(self, seconds: float) -> None:
        """Make transfers for so long, in the robot's time, and no more than fit into it.

        So a driver that waits for its part without end comes to one, on a virtual clock
        too, where they take no time.
        """
        self._until = now() + seconds
        self._most = self.transfers + seconds / _SHORTEST

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.deinit()

    def deinit(self) -> None:
        """Do nothing: the bus belongs to the robot."""

    def try_lock(self) -> bool:
        """Return that the bus is free."""
        return True

    def unlock(self) -> None:
        """Do nothing: the bus is free for others after the call of the driver."""

    def _count(self, bus: I2CBus | SpiBus) -> None:
        self.transfers += 1
        if now() > self._until or self.transfers > self._most:
            raise TimeoutError(f"{bus.name}: the call of the driver took too long")


class AdafruitBus(_Wire):
    """What a CircuitPython driver takes for a ``busio.I2C``.

    Args:
        bus: The bus.
    """

    def __init__(self, bus: I2CBus) -> None:
        super().__init__()
        self._bus = bus

    def scan(self) -> list[int]:
        """Return the addresses that answer."""
        return [address for address in range(0x08, 0x78) if self._answers(address)]

    def readfrom_into(
        self,
        address: int,
        buffer: Any,
        *,
        start: int = 0,
        end: int | None = None,
        stop: bool = True,
    ) -> None:
        """Fill a buffer, or a part of it, from a chip."""
        with memoryview(buffer)[start:end] as part:
            part[:] = self._transfer(address, b"", len(part))

    def writeto(
        self,
        address: int,
        buffer: Any,
        *,
        start: int = 0,
        end: int | None = None,
        stop: bool = True,
    ) -> None:
        """Write a buffer, or a part of it, to a chip."""
        if isinstance(buffer, str):
            buffer = buffer.encode("latin-1")
        self._transfer(address, bytes(memoryview(buffer)[start:end]), 0)

    def writeto_then_readfrom(
        self,
        address: int,
        buffer_out: Any,
        buffer_in: Any,
        *,
        out_start: int = 0,
        out_end: int | None = None,
        in_start: int = 0,
        in_end: int | None = None,
        stop: bool = False,
    ) -> None:
        """Write a buffer, then fill one after a repeated start."""
        out = bytes(memoryview(buffer_out)[out_start:out_end])
        with memoryview(buffer_in)[in_start:in_end] as part:
            part[:] = self._transfer(address, out, len(part))

    def _transfer(self, address: int, write: bytes, read: int) -> bytes:
        self._count(self._bus)
        return self._bus.direct(
            lambda link: transfer(link, address, write, read), address=address
        )

    def _answers(self, address: int) -> bool:
        try:
            self._bus.direct(lambda link: probe(link, address), address=address)
        except DeviceFaultError:
            return False
        return True


class AdafruitSpi(_Wire):
    """What a CircuitPython driver takes for a ``busio.SPI``, and for its chip select.

    What is written while the chip is selected leaves together with the next read, or when
    the chip is left: the kernel holds a chip select for one transfer only.

    Args:
        bus: The bus.
        chip: The number of the chip select.
    """

    def __init__(self, bus: SpiBus, chip: int) -> None:
        super().__init__()
        self._bus = bus
        self._chip = chip
        self._has_heard = False
        self.configure()
        self._selected = self._has_read = False
        self._written = b""

    def configure(
        self,
        *,
        baudrate: int = 100_000,
        polarity: int = 0,
        phase: int = 0,
        bits: int = 8,
    ) -> None:
        """Set the clock of the transfers that follow."""
        self.frequency: int = baudrate
        self._mode = polarity << 1 | phase

    def switch_to_output(self, value: bool = True, drive_mode: object = None) -> None:
        """Be a chip select that is high, unless said otherwise."""
        self.value = value

    @property
    def value(self) -> bool:
        """Whether the chip select is high: the chip is not selected."""
        return not self._selected

    @value.setter
    def value(self, value: bool) -> None:
        if self._selected and value and self._written:
            self._exchange(b"")
        self._selected, self._has_read = not value, False

    def write(self, buffer: Any, *, start: int = 0, end: int | None = None) -> None:
        """Write a buffer, or a part of it."""
        self._written += bytes(memoryview(buffer)[start:end])
        if not self._selected:
            self._exchange(b"")

    def readinto(
        self,
        buffer: Any,
        *,
        start: int = 0,
        end: int | None = None,
        write_value: int = 0,
    ) -> None:
        """Fill a buffer, or a part of it, while one value is sent."""
        with memoryview(buffer)[start:end] as part:
            part[:] = self._exchange(bytes([write_value]) * len(part))

    def write_readinto(
        self,
        buffer_out: Any,
        buffer_in: Any,
        *,
        out_start: int = 0,
        out_end: int | None = None,
        in_start: int = 0,
        in_end: int | None = None,
    ) -> None:
        """Write a buffer, and fill one with what comes at the same time."""
        out = bytes(memoryview(buffer_out)[out_start:out_end])
        with memoryview(buffer_in)[in_start:in_end] as part:
            part[:] = self._exchange(out)

    def _exchange(self, data: bytes) -> bytes:
        if self._has_read:
            told = (
                "the driver reads twice under one chip select, which the kernel cannot"
            )
            raise DeviceFaultError(self._bus.name, told)
        sent, self._written = self._written + data, b""  # whether it leaves or not
        self._count(self._bus)
        self._has_read = self._selected and bool(data)
        back = self._bus.direct(
            lambda link: link.exchange(self._chip, sent, self.frequency, self._mode),
            address=self._chip,
        )[len(sent) - len(data) :]
        if data:
            is_idle = not set(back) - {0x00, 0xFF}
            self.is_silent = is_idle and (self.is_silent or not self._has_heard)
            self._has_heard = True
        return back


class _OnPart(OnObject):
    """What the sensor and the actuator have in common: a driver's object on a bus."""

    bus: I2CBus | SpiBus

    def __init__(
        self,
        *,
        library: str | Callable[..., Any],
        address: int | None = None,
        chip: int | None = None,
        arguments: Mapping[str, Any] | None = None,
        set_up: Mapping[str, Any] | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        is_spi = isinstance(self.bus, SpiBus)
        if is_spi != (chip is not None) or (is_spi and address is not None):
            told = "on an SPI bus chip= is needed, and only there; address= is of I²C"
            raise ConfigError(self.name, "chip", told)
        self._chip = chip
        self.told: dict[str, Any] = dict(set_up or {})
        """What the part is told at each opening."""
        named = {
            **(arguments or {}),
            **({} if address is None else {"address": address}),
        }
        self.object = Made(
            self,
            library,
            named,
            set_up,
            hint="Adafruit's packages are named adafruit-circuitpython-...",
            around=self._alone,
        )
        self._place = library, chip if is_spi else _address(self.object.make, named)
        self._wire: AdafruitBus | AdafruitSpi | None = None
        self._kept: dict[str, Any] = {}

    @property
    def can_tell_set_up(self) -> bool:
        """Whether it has a ``set_up``."""
        return bool(self.object.set_up)

    def open(self) -> None:
        """Have the driver set the part up; on the thread of the bus."""
        bus = self.bus
        wires: tuple[AdafruitBus | AdafruitSpi, ...]
        if isinstance(bus, SpiBus):
            assert self._chip is not None
            wires = (AdafruitSpi(bus, self._chip),) * 2  # it is its chip select, too
        else:
            wires = (AdafruitBus(bus),)
        self._wire = wire = wires[0]
        for other in self._others():
            if other.told and self.told not in ({}, other.told):
                told = f"expected that of {other.name!r}, {other.told!r:.80}: a part has one"
                raise ConfigError(self.name, "set_up", told)
        self._look_at_others()  # what follows hides a restart from them
        try:
            self.object.open(*wires)
            for text, (path, _) in self.object.set_up.items():
                before = wire.transfers
                self._kept[text] = self.object.get(path)
                if wire.transfers == before:
                    raise ConfigError(
                        self.name,
                        f"set_up.{text}",
                        "expected an attribute that is read from the part; the "
                        "driver remembers this one, and a restart would not show",
                    )
        except Exception as error:
            self.object.it = None
            silent = wire.is_silent and not isinstance(error, ConfigError)
            if silent or _is_silence(error) or not self.bus.is_open:
                raise DeviceLostError(self.name, describe(error)) from error
            raise
        self._look_at_others()  # some drivers reset their part
        self._on_part().append(self)

    def close(self) -> None:
        """Forget the driver's object; the wire is the robot's, and stays open."""
        self.object.it = None
        if self in self._on_part():
            self._on_part().remove(self)

    def is_set_up(self) -> bool:
        """Tell whether all of ``set_up`` is as it was after the opening.

        If not, all that is on the part hears of it: who is opened first sets it up again.
        """
        is_so = all(
            self.object.get(path) == self._kept[text]
            for text, (path, _) in self.object.set_up.items()
        )
        for other in () if is_so else self._others():
            other.report_lost(_restarted(other))
        return is_so

    def _look_at_others(self) -> None:
        for other in self._others():
            with contextlib.suppress(Exception):
                if not other.is_set_up():
                    other.report_lost(_restarted(other))

    def _on_part(self) -> _Part:
        return shared(self.bus, _Part).setdefault(self._place, _Part())

    def _others(self) -> list[_OnPart]:
        return [each for each in self._on_part() if each is not self]

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Keep other Adafruit drivers of the process out, on other buses' threads."""
        patience = self.deadline / 2
        if not _one_at_a_time.acquire(timeout=patience):
            raise DriverStuckError(
                self.name, "an Adafruit driver on another bus", patience
            )
        try:
            if self._wire is not None:
                self._wire.allow(self.deadline)
            yield
        finally:
            _one_at_a_time.release()


class _PartSettings(TypedDict, total=False):
    library: Required[str | Callable[..., Any]]
    address: int | None
    chip: int | None
    arguments: Mapping[str, Any] | None
    set_up: Mapping[str, Any] | None


class _SensorSettings(_PartSettings, SensorSettings): ...


class _ActuatorSettings(_PartSettings, ActuatorSettings): ...


class AdafruitSensor(_OnPart, MadeSensor):
    """A part that is read through its CircuitPython driver.

    Args:
        library: The driver's class as ``module:Class``, or anything that is called with
            a ``busio.I2C``, or a ``busio.SPI`` and a chip select, and makes an object.
        value: What is read, such as ``"temperature"``, ``"channels[0].voltage"`` or
            ``"read(0)"``. If there are several, a reading is a dictionary of them.
        address: The address of the part on I²C; the driver's own default if None.
        chip: The number of its chip select on SPI.
        arguments: Further keywords for the driver's class.
        set_up: Attributes that are assigned at each opening, by their paths. A part that
            has restarted is known by them, because they are others then. All that is on
            a part has the same ones, or none.
    """

    def __init__(
        self, *, value: str | Sequence[str], **settings: Unpack[_SensorSettings]
    ) -> None:
        super().__init__(**settings)
        self._read = self.object.reading(value)


class AdafruitActuator(_OnPart, MadeActuator):
    """A part that is written to through its CircuitPython driver.

    Args:
        attribute: What a command is assigned to, such as ``"channels[0].duty_cycle"``;
            with ``()`` at the end it is called with the command.
        safe: The safe command; commands are of its type.
        limits: Least and greatest command.
        **settings: ``library``, ``address`` and more, as of an `AdafruitSensor`.
    """

    def __init__(
        self,
        *,
        attribute: str,
        safe: Any,
        limits: tuple[float, float] | None = None,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        self.safe = safe
        self.limits: tuple[float, float] | None = limits
        self._tell = self.object.telling(attribute)
        library, place = self._place
        where = "" if place is None else f" at {place:#04x}"
        self.claim: str = f"{attribute} of {library}{where}"


class _Part(list[_OnPart]):
    """All that is on one part, and open."""


def _address(make: Callable[..., Any], named: Mapping[str, Any]) -> int | None:
    """Return the address of a part, which its class may have unless told another."""
    with contextlib.suppress(TypeError, ValueError):  # some cannot tell
        takes = inspect.signature(make).parameters.items()
        named = {**{name: each.default for name, each in takes}, **named}
    found = named.get("address", named.get("addr"))
    return found if type(found) is int else None


def _restarted(part: Resource) -> DeviceLostError:
    return DeviceLostError(part.name, "its part has restarted")


def _is_silence(error: Exception) -> bool:
    """Tell whether nobody answered; adafruit_bus_device makes a ValueError of it."""
    if isinstance(error, ValueError):
        return isinstance(error.__context__, OSError)
    return isinstance(error, DeviceFaultError) and error.errno in SILENT
