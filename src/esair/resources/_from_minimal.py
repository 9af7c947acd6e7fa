"""Sensors and actuators of ESAIR MIN in a robot of ESAIR STD."""

from __future__ import annotations

from typing import Any, TypeVar, cast

from esair import minimal
from esair.messages import snake_case
from esair.resources._actuator import Actuator
from esair.resources._resource import Resource
from esair.resources._sensor import Sensor

T = TypeVar("T")

_BOUNDS = (
    "deadline",
    "fault_limit",
    "required",
    "restart",
    "max_repeat",
    "own_timeout",
)
"""What a class may say about itself that only STD asks for."""


class MinimalSensor(Sensor[Any]):
    """Reads a sensor that was written for `esair.minimal`, on a worker thread.

    Attributes:
        device: What is read.
    """

    def __init__(self, device: minimal.Sensor) -> None:
        super().__init__(name=_name_of(device))
        if device.rate is not None:
            self.rate = float(device.rate)
        self.device = device
        _take_over(self, device)

    def open(self) -> None:
        """Make the device ready."""
        self.device.open()

    def close(self) -> None:
        """Let the device go."""
        self.device.close()

    def read(self) -> Any:
        """Ask the device for one value."""
        return self.device.read()


class MinimalActuator(Actuator[Any]):
    """Writes an actuator that was written for `esair.minimal`, on a worker thread.

    Attributes:
        device: What is written.
    """

    def __init__(self, device: minimal.Actuator) -> None:
        super().__init__(name=_name_of(device))
        self.device = device
        _take_over(
            self, device, "safe", "command_timeout", "limits", "clamp", "slew", *_BOUNDS
        )

    def open(self) -> None:
        """Make the device ready."""
        self.device.open()

    def close(self) -> None:
        """Let the device go."""
        self.device.close()

    def write(self, command: Any) -> Any:
        """Send a command to the device."""
        return self.device.write(command)

    @property
    def value_type(self) -> Any:
        """The type of its safe command, as in MIN."""
        return type(self.safe) if hasattr(self, "safe") else Any


def adapt_resource(resource: T) -> T:
    """Return what runs in STD: a device of MIN in its adapter, all else as it is."""
    adapted: Any = resource
    if isinstance(resource, minimal.Sensor):
        adapted = MinimalSensor(resource)
    elif isinstance(resource, minimal.Actuator):
        adapted = MinimalActuator(resource)
    return cast("T", adapted)


def _name_of(device: minimal.Sensor | minimal.Actuator) -> str:
    return device.name or snake_case(type(device).__name__)


def _take_over(to: Resource, device: object, *names: str) -> None:
    for name in names or _BOUNDS:
        if hasattr(device, name):
            setattr(to, name, getattr(device, name))
