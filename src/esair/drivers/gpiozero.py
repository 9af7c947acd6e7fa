"""What gpiozero can do on the pins of a Raspberry Pi, class by class.

A part is named by its class; its arguments are those of the class::

    [actuator.left]
    driver = "gpiozero"
    device = "Motor"
    arguments = { forward = 4, backward = 14 }

    [sensor.ahead]
    driver = "gpiozero"
    device = "DistanceSensor"
    arguments = { echo = 17, trigger = 18 }
    rate = 20

What it reads, or is told, is in `READS` and `TELLS`. Events and sources of gpiozero are not
used: a robot asks its sensors, and writes to its actuators.

Source: gpiozero 2.0, API of input, output, SPI, internal devices and boards.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import math
import subprocess
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeVar, Unpack

import gpiozero

from esair.drivers.object import Arguments, Made, MadeActuator, MadeSensor
from esair.exceptions import ConfigError, DeviceLostError
from esair.resources import (
    HOLD,
    ActuatorSettings,
    Resource,
    SensorSettings,
)

__all__ = ["READS", "TELLS", "Colour", "GpiozeroActuator", "GpiozeroSensor", "Told"]

T = TypeVar("T")

Limits = tuple[float, float] | Mapping[str, tuple[float, float]] | None

_ADC = "3001 3002 3004 3008 3201 3202 3204 3208 3301 3302 3304"

READS: Final[Mapping[str, str]] = {
    "Button": "is_pressed",
    "ButtonBoard": "value",
    "CPUTemperature": "temperature",
    "DigitalInputDevice": "is_active",
    "DiskUsage": "usage",
    "DistanceSensor": "distance",
    "LightSensor": "value",
    "LineSensor": "value",
    "LoadAverage": "load_average",
    **{f"MCP{number}": "value" for number in _ADC.split()},
    "MotionSensor": "motion_detected",
    "PingServer": "is_active",
    "RotaryEncoder": "steps",
    "TimeOfDay": "is_active",
}
"""What is read of each class. Distances are metres, temperatures degrees Celsius."""


class Colour(NamedTuple):
    """What an ``RGBLED`` is told: three parts, each from 0 to 1."""

    red: float
    green: float
    blue: float


class Told(NamedTuple):
    """What an actuator of gpiozero is told.

    Attributes:
        attribute: What a command is assigned to.
        safe: The safe command, whose type is that of the commands.
        limits: Least and greatest command.
        arguments: What the class is made with unless said otherwise: a servo that is
            made must not turn.
    """

    attribute: str
    safe: Any
    limits: Limits = None
    arguments: Mapping[str, Any] = {}


_SWITCH: Final = Told("value", safe=False)
_DIMMER: Final = Told("value", safe=0.0, limits=(0.0, 1.0))
_MOTOR: Final = Told("value", safe=0.0, limits=(-1.0, 1.0))

TELLS: Final[Mapping[str, Told]] = {
    "AngularServo": Told("angle", HOLD, (-90.0, 90.0), {"initial_angle": None}),
    "Buzzer": _SWITCH,
    "DigitalOutputDevice": _SWITCH,
    "Energenie": _SWITCH,
    "LED": _SWITCH,
    "LEDBarGraph": _MOTOR,
    "Motor": _MOTOR,
    "OutputDevice": _SWITCH,
    "PWMLED": _DIMMER,
    "PWMOutputDevice": _DIMMER,
    "PhaseEnableMotor": _MOTOR,
    "RGBLED": Told(
        "value", Colour(0.0, 0.0, 0.0), dict.fromkeys(Colour._fields, (0.0, 1.0))
    ),
    "Servo": Told("value", HOLD, (-1.0, 1.0), {"initial_value": None}),
}
"""What each class is told. Angles are degrees, all else parts of the whole."""


SILENCE: Final = 0.5
"""After how many seconds without an echo there is no distance."""

FIRST: Final = 1.5
"""How long the first echoes may take, in seconds."""


class EchoSensor(gpiozero.DistanceSensor):  # type: ignore[misc]  # it is not typed
    """A `gpiozero.DistanceSensor` that tells when no echo comes.

    The package's own keeps its last echoes, and their distance is that of a wall that was
    there when its cable was.
    """

    _heard = -math.inf

    def _read(self) -> Any:
        found = super()._read()
        if found is not None:
            self._heard = time.monotonic()
        return found

    def close(self) -> None:
        """End its thread before its trigger, which that may be using."""
        with contextlib.suppress(AttributeError, RuntimeError):  # it may not have begun
            self._queue.stop()
        super().close()

    @property
    def distance(self) -> Any:
        """The distance in m.

        Raises:
            OSError: No echo comes.
        """
        is_full = self._queue.full.wait(FIRST) or self._queue.partial
        if is_full and time.monotonic() - self._heard <= SILENCE:
            return super().distance
        raise OSError(errno.EIO, "no echo comes: is it connected?")


class PingedServer(gpiozero.PingServer):  # type: ignore[misc]  # it is not typed
    """A `gpiozero.PingServer` whose server is away after a second, not after ten."""

    @property
    def value(self) -> int:
        """1 if the server answers a ping, else 0."""
        told = ["ping", "-c1", "-W1", self.host]
        quiet = subprocess.DEVNULL
        return int(subprocess.call(told, stdout=quiet, stderr=quiet) == 0)


def encoder(*pins: Any, wrap: bool = False, **named: Any) -> Any:
    """Return a `gpiozero.RotaryEncoder`, whose count would stay at 16 as it comes."""
    named = {"max_steps": 16 if wrap else 0, **named}
    return gpiozero.RotaryEncoder(*pins, wrap=wrap, **named)


_MADE: Final[Mapping[str, Any]] = {
    # Its median of nine tells what is new 0.4 s after it came.
    "DistanceSensor": functools.partial(EchoSensor, queue_len=3),
    "PingServer": PingedServer,
    "RotaryEncoder": encoder,
}


class GpiozeroSensor(MadeSensor):
    """A sensor of gpiozero.

    A ``DistanceSensor`` without an echo for 0.5 s is at fault; it tells the median of three
    echoes unless it is given ``queue_len``. A ``RotaryEncoder`` counts without an end unless
    it is given ``max_steps``, or ``wrap``. A ``PingServer`` is asked for a second.

    Args:
        device: Its class, one of `READS`.
        arguments: The keywords of the class, or a list of its pins.
        limits: Least and greatest value; what is outside is a fault of the device.
    """

    def __init__(
        self,
        *,
        device: str,
        arguments: Arguments = None,
        limits: tuple[float, float] | None = None,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        value = _known(self, device, READS)
        made = _MADE.get(device) or getattr(gpiozero, device)
        self._reads(Made(self, made, arguments), value, limits)

    def read(self) -> Any:
        """Read it; on the thread of the object.

        Raises:
            DeviceLostError: The thread has ended by which gpiozero looks at the pin: it
                would tell what that has seen last.
        """
        queue = getattr(self.object.it, "_queue", None)
        if queue is not None and not queue.is_alive():
            raise DeviceLostError(self.name, "gpiozero does not look at it any more")
        return super().read()


class GpiozeroActuator(MadeActuator):
    """An actuator of gpiozero.

    Args:
        device: Its class, one of `TELLS`.
        arguments: The keywords of the class, or a list of its pins.
        limits: Narrower limits than those of `TELLS`; for an ``AngularServo`` they are
            those of its angles.
    """

    def __init__(
        self,
        *,
        device: str,
        arguments: Arguments = None,
        limits: Limits = None,
        **settings: Unpack[ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        told = _known(self, device, TELLS)
        self.safe: Any = told.safe
        self.limits = told.limits if limits is None else limits
        if device == "AngularServo" and limits is None:  # it may be mounted upside down
            named = {} if isinstance(arguments, Sequence) else dict(arguments or {})
            ends = named.get("min_angle", -90), named.get("max_angle", 90)
            self.limits = float(min(ends)), float(max(ends))
        # Beside the pins, whichever way those are given.
        make = functools.partial(getattr(gpiozero, device), **told.arguments)
        self.object: Made = Made(self, make, arguments)
        self._tell = self.object.telling(told.attribute)
        self.claim: str = f"{device} {arguments or ''}"


def _known(owner: Resource, device: str, known: Mapping[str, T]) -> T:
    if device not in known:
        told = f"expected one of {', '.join(known)}, not {device!r:.40}"
        raise ConfigError(owner.name, "device", told)
    return known[device]
