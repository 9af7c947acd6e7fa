"""Any Adafruit CircuitPython driver of an I²C part, as a sensor or an actuator.

Adafruit's drivers expect a ``busio.I2C``; `AdafruitBus` looks like one, and is an
`esair.buses.I2CBus`. They block, so they run on the thread of that bus, and nobody else
uses the bus during one call of theirs: a driver that sleeps makes the others wait::

    [sensor.air]
    driver = "adafruit"
    bus = "chips"
    library = "adafruit_bme280.basic:Adafruit_BME280_I2C"
    address = 0x76
    value = ["temperature", "pressure"]

    [actuator.lamp]
    driver = "adafruit"
    bus = "chips"
    library = "adafruit_pca9685:PCA9685"
    attribute = "channels[0].duty_cycle"
    safe = 0

Source: the API of ``busio.I2C`` of CircuitPython, and of adafruit_bus_device 5.2.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Required, TypedDict, Unpack

from esair.buses import I2CBus
from esair.buses.i2c import SILENT, probe, transfer
from esair.drivers.object import Made
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.loop import now
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)

__all__ = ["AdafruitActuator", "AdafruitBus", "AdafruitSensor"]

_SHORTEST = 20e-6  # What a transfer takes: an address at 1 MHz, in seconds

# adafruit_register has one buffer for all drivers of a process: with two buses, and
# so two threads, one driver would send what another has just put there.
_one_at_a_time = threading.Lock()


class AdafruitBus:
    """What a CircuitPython driver takes for a ``busio.I2C``.

    It is for the thread of the bus, where plain methods of drivers run: nobody else can
    come in between there, so the bus is always free to be locked.

    Args:
        bus: The bus.
    """

    def __init__(self, bus: I2CBus) -> None:
        self._bus = bus
        self.transfers: int = 0
        """How many have been made."""
        self._until = self._most = math.inf

    def allow(self, seconds: float) -> None:
        """Make transfers for so long, in the robot's time, and no more than fit into it.

        So a driver that waits for its part without end comes to one, on a virtual clock
        too, where they take no time.
        """
        self._until = now() + seconds
        self._most = self.transfers + seconds / _SHORTEST

    def __enter__(self) -> AdafruitBus:
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
        self.transfers += 1
        if now() > self._until or self.transfers > self._most:
            raise TimeoutError(
                f"{self._bus.name}: the call of the driver took too long"
            )
        return self._bus.direct(
            lambda link: transfer(link, address, write, read), address=address
        )

    def _answers(self, address: int) -> bool:
        try:
            self._bus.direct(lambda link: probe(link, address), address=address)
        except DeviceFaultError:
            return False
        return True


class _OnPart(Resource):
    """What the sensor and the actuator have in common: a driver's object on a bus."""

    bus: I2CBus
    deadline: float = 2.0

    def __init__(
        self,
        *,
        library: str | Callable[..., Any],
        address: int | None = None,
        arguments: Mapping[str, Any] | None = None,
        set_up: Mapping[str, Any] | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self._object = Made(
            self,
            library,
            {**(arguments or {}), **({} if address is None else {"address": address})},
            set_up,
            hint="Adafruit's packages are named adafruit-circuitpython-...",
            around=self._alone,
        )
        self._wire: AdafruitBus | None = None
        self._kept: dict[str, Any] = {}

    @property
    def can_tell_set_up(self) -> bool:
        """Whether it has a ``set_up``."""
        return bool(self._object.set_up)

    def open(self) -> None:
        """Have the driver set the part up; on the thread of the bus."""
        wire = self._wire = AdafruitBus(self.bus)
        try:
            self._object.open(wire)
            for text, (path, _) in self._object.set_up.items():
                before = wire.transfers
                self._kept[text] = self._object.get(path)
                if wire.transfers == before:
                    raise ConfigError(
                        self.name,
                        f"set_up.{text}",
                        "expected an attribute that is read from the part; the "
                        "driver remembers this one, and a restart would not show",
                    )
        except Exception as error:
            self._object.it = None
            if _is_silence(error) or not self.bus.is_open:
                raise DeviceLostError(self.name, describe(error)) from error
            raise

    def close(self) -> None:
        """Forget the driver's object; the wire is the robot's, and stays open."""
        self._object.it = None

    def is_set_up(self) -> bool:
        """Tell whether all of ``set_up`` is as it was after the opening."""
        return all(
            self._object.get(path) == self._kept[text]
            for text, (path, _) in self._object.set_up.items()
        )

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
    arguments: Mapping[str, Any] | None
    set_up: Mapping[str, Any] | None


class _SensorSettings(_PartSettings, SensorSettings): ...


class _ActuatorSettings(_PartSettings, ActuatorSettings): ...


class AdafruitSensor(_OnPart, Sensor[Any]):
    """A part that is read through its CircuitPython driver.

    Args:
        library: The driver's class as ``module:Class``, or anything that is called with
            a ``busio.I2C`` and makes an object.
        value: What is read, such as ``"temperature"``, ``"channels[0].voltage"`` or
            ``"read(0)"``. If there are several, a reading is a dictionary of them.
        address: The address of the part; the driver's own default if None.
        arguments: Further keywords for the driver's class.
        set_up: Attributes that are assigned at each opening, by their paths. A part that
            has restarted is known by them, because they are others then.
    """

    def __init__(
        self, *, value: str | Sequence[str], **settings: Unpack[_SensorSettings]
    ) -> None:
        super().__init__(**settings)
        self._read = self._object.reading(value)

    def read(self) -> Any:
        """Read it; on the thread of the bus, nobody else in between."""
        return self._read()


class AdafruitActuator(_OnPart, Actuator[Any]):
    """A part that is written to through its CircuitPython driver.

    Args:
        library: The driver's class as ``module:Class``, or anything that is called with
            a ``busio.I2C`` and makes an object.
        attribute: What a command is assigned to, such as ``"channels[0].duty_cycle"``;
            with ``()`` at the end it is called with the command.
        safe: The safe command; commands are of its type.
        limits: Least and greatest command.
        address: The address of the part; the driver's own default if None.
        arguments: Further keywords for the driver's class.
        set_up: Attributes that are assigned at each opening, by their paths. A part that
            has restarted is known by them, because they are others then.
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
        self._tell = self._object.telling(attribute)
        address = settings.get("address")
        where = "" if address is None else f" at {address:#04x}"
        self.claim: str = f"{attribute} of {settings['library']}{where}"

    def write(self, command: Any) -> None:
        """Assign the command, or call with it; on the thread of the bus."""
        self._tell(command)


def _is_silence(error: Exception) -> bool:
    """Tell whether nobody answered; adafruit_bus_device makes a ValueError of it."""
    if isinstance(error, ValueError):
        return isinstance(error.__context__, OSError)
    return isinstance(error, DeviceFaultError) and error.errno in SILENT
