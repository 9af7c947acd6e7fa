"""Any object of any package, as a sensor or an actuator.

What reads or sets something by an attribute or a method needs no driver of its own. The
object is made at each opening and closed at each loss, and used on one worker thread::

    [sensor.water]
    driver = "object"
    library = "w1thermsensor:W1ThermSensor"
    value = "get_temperature()"
    limits = [-55.0, 125.0]

    [actuator.fan]
    driver = "object"
    library = "gpiozero:PWMOutputDevice"
    arguments = { pin = 17, frequency = 25000 }
    attribute = "value"
    safe = 0.0
    limits = [0.0, 1.0]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Unpack

from esair.drivers._made import Arguments, Lost, Made, MadeActuator, MadeSensor
from esair.resources import (
    HOLD,
    ActuatorSettings,
    SensorSettings,
)

__all__ = ["Made", "ObjectActuator", "ObjectSensor"]


class ObjectSensor(MadeSensor):
    """What an attribute or a method of an object gives.

    Args:
        library: The class of the object as ``module:Class``, or anything that is called
            and makes it.
        value: What is read: an attribute such as ``"temperature"``, a way to one such as
            ``"channels[0].voltage"``, a call such as ``"read(0)"``. If there are
            several, a reading is a dictionary of them.
        arguments: What the class is called with: keywords, or a list of values.
        set_up: Attributes that are assigned at each opening, by their ways.
        lost: Errors of the package, as ``module:Error`` or classes, that say that the
            device is gone rather than at fault. Those of the system (`OSError`) and of
            time (`TimeoutError`) are known.
        limits: Least and greatest value; what is outside is a fault of the device.
    """

    def __init__(
        self,
        *,
        library: str | Callable[..., Any],
        value: str | Sequence[str],
        arguments: Arguments = None,
        set_up: Mapping[str, Any] | None = None,
        lost: Lost = (),
        limits: tuple[float, float] | None = None,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        self._reads(Made(self, library, arguments, set_up, lost), value, limits)


class ObjectActuator(MadeActuator):
    """What an attribute of an object is set to, or a method of it is called with.

    Args:
        library: The class of the object, as of an `ObjectSensor`.
        attribute: What a command is assigned to, such as ``"value"``; with arguments
            behind it, such as ``"move()"`` or ``"move(speed=0.5)"``, it is called, the
            command first.
        safe: The safe command; commands are of its type. `esair.HOLD`, in a file
            ``"hold"``, if commands are places to go (numbers then): the object stays
            where it is.
        arguments: What the class is called with: keywords, or a list of values.
        set_up: Attributes that are assigned at each opening, by their ways.
        lost: Errors of the package that say that the device is gone; as of
            `ObjectSensor`.
        limits: Least and greatest command, or of each of its fields.
    """

    def __init__(
        self,
        *,
        library: str | Callable[..., Any],
        attribute: str,
        safe: Any,
        arguments: Arguments = None,
        set_up: Mapping[str, Any] | None = None,
        lost: Lost = (),
        limits: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
        **settings: Unpack[ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        self.object = Made(self, library, arguments, set_up, lost)
        self._tell = self.object.telling(attribute)
        self.safe: Any = HOLD if safe == "hold" else safe
        self.limits = limits
        self.claim: str = f"{attribute} of {library} {arguments or ''}"
