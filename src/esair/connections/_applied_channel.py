"""The last command that an actuator has taken, as a reading."""

from __future__ import annotations

from typing import Any

from esair.connections._device import OfRobot
from esair.connections._registrations import Registrations
from esair.connections._sensor_channel import SensorChannel
from esair.messages import ResourceState
from esair.resources import APPLIED, HOLD, Actuator, Sensor


class Applied(Sensor[Any]):
    """What an actuator has applied last: ``valve.applied``."""

    def __init__(self, actuator: Actuator[Any]) -> None:
        super().__init__()
        self._name = actuator.name + APPLIED
        self._type = actuator.value_type

    @property
    def value_type(self) -> Any:
        return self._type


class AppliedChannel(SensorChannel):
    """Reads what an actuator has applied last; the actuator's own channel fills it."""

    def __init__(self, actuator: Actuator[Any], registrations: Registrations) -> None:
        robot = OfRobot(registrations, lambda _error: None, set())
        super().__init__(Applied(actuator), robot)

    def took(self, command: Any) -> None:
        """Give a command that was applied; nobody knows where it is if that is HOLD."""
        if self.state is not ResourceState.READY:
            return
        if command is None or command is HOLD:
            self.forget_age()
        else:
            self.publish(command, float("inf"))
