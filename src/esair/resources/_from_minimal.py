"""Sensors and actuators of ESAIR MIN in a robot of ESAIR STD."""

from __future__ import annotations

from typing import Any, TypeVar, overload

from esair import minimal
from esair.resources._actuator import Actuator
from esair.resources._resource import Resource
from esair.resources._sensor import Sensor
from esair.values import snake_case

T = TypeVar("T")

_OF_STD = ("deadline", "fault_limit", "required", "placement")
"""What a class of MIN may say about itself for STD alone, beside its own words."""


class MinimalSensor(Sensor[Any]):
    """Reads a sensor that was written for `esair.minimal`, on a worker thread.

    Attributes:
        device: What is read.
    """

    def __init__(self, device: minimal.Sensor) -> None:
        rate: dict[str, Any] = {} if device.rate is None else {"rate": device.rate}
        super().__init__(name=_name_of(device), **rate)
        self.device = device
        _take_over(self, device, "max_repeat", *_OF_STD)
        _hand_on(self, device, minimal.Sensor, "open", "close", "read")


class MinimalActuator(Actuator[Any]):
    """Writes an actuator that was written for `esair.minimal`, on a worker thread.

    Attributes:
        device: What is written.
    """

    def __init__(self, device: minimal.Actuator) -> None:
        super().__init__(name=_name_of(device))
        self.device = device
        _take_over(self, device, "safe", "command_timeout", "limits", "clamp")
        _take_over(self, device, "slew", "own_timeout", *_OF_STD)
        _hand_on(self, device, minimal.Actuator, "open", "close", "write")


@overload
def adapt_resource(resource: minimal.Sensor) -> MinimalSensor: ...
@overload
def adapt_resource(resource: minimal.Actuator) -> MinimalActuator: ...
@overload
def adapt_resource(resource: T) -> T: ...
def adapt_resource(resource: Any) -> Any:
    """Return what runs in STD: a device of MIN in its adapter, all else as it is."""
    if isinstance(resource, minimal.Sensor):
        return MinimalSensor(resource)
    if isinstance(resource, minimal.Actuator):
        return MinimalActuator(resource)
    return resource


def _name_of(device: minimal.Sensor | minimal.Actuator) -> str:
    device.name = device.name or snake_case(type(device).__name__)
    return device.name


def _take_over(to: Resource, device: object, *names: str) -> None:
    for name in names:
        if hasattr(device, name):
            setattr(to, name, getattr(device, name))


def _hand_on(to: Resource, device: object, base: type, *methods: str) -> None:
    """Let the methods of an adapter be those of the device, if its class has them."""
    for name in methods:
        if getattr(type(device), name) is not getattr(base, name):
            setattr(to, name, getattr(device, name))
