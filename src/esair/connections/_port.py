"""What the ports of sensors and actuators have in common: a right, and a control path."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, Generic, Protocol, TypeVar

from esair.connections._actuator_channel import ActuatorChannel
from esair.connections._registrations import Registration
from esair.connections._sensor_channel import SensorChannel
from esair.exceptions import NotRegisteredError
from esair.loop import Budget, speaks_for_nobody
from esair.messages import ResourceState
from esair.resources import Operation

T = TypeVar("T")


class Control(Protocol):
    """The resource supervisor: the control path of a port."""

    async def configure(self, registration: Registration, /, **settings: Any) -> None:
        """Change settings of a resource."""

    async def operate(
        self, registration: Registration, name: str, /, **parameters: Any
    ) -> Any:
        """Call an operation of a resource."""


class Port(Generic[T]):
    """The way of one action to one device.

    Attributes:
        registration: The right to use it.
    """

    __slots__ = ("_budget", "_channel", "_control", "registration")

    _channel: SensorChannel | ActuatorChannel

    def __init__(
        self,
        channel: SensorChannel | ActuatorChannel,
        registration: Registration,
        control: Control,
    ) -> None:
        self._channel = channel
        self.registration = registration
        self._control = control
        self._budget = Budget.of(asyncio.get_running_loop())

    def revive(self, channel: Any, registration: Registration) -> None:
        """Live again, with a device that has come back under the same name."""
        self._channel = channel
        self.registration = registration

    @property
    def resource(self) -> str:
        """The name of the device."""
        return self.registration.resource

    async def configure(self, **settings: Any) -> None:
        """Change settings of the device: all of them, or none.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``.
            BadValueError: A setting is unknown, or a value is not allowed.
        """
        if speaks_for_nobody():
            raise run_ended(self.registration)
        await self._control.configure(self.registration, **settings)

    async def operate(self, name: str, /, **parameters: Any) -> Any:
        """Call an operation of the device, such as ``home``, and wait for its outcome.

        Args:
            name: The name of the operation.
            **parameters: What it takes, by name; checked before anything is done.

        Returns:
            What the operation returns.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``, or
                somebody else holds the actuator.
            UnknownNameError: There is no such operation.
            BadValueError: A parameter is unknown, missing, or not allowed.
            HaltedError: The robot is halted.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
            DriverStuckError: It did not end within its deadline.
        """
        if speaks_for_nobody():
            raise run_ended(self.registration)
        return await self._control.operate(self.registration, name, **parameters)

    @property
    def operations(self) -> Mapping[str, Operation]:
        """What can be called by `operate`, by name, with its parameters."""
        return self._channel.driver.resource.operations

    @property
    def settings(self) -> Mapping[str, Any]:
        """The current settings of the device."""
        return self._channel.driver.resource.settings

    @property
    def state(self) -> ResourceState:
        """What the device is doing."""
        return self._channel.state

    def __repr__(self) -> str:
        return f"<port of {self.registration!r}>"


def run_ended(registration: Registration) -> NotRegisteredError:
    """Make the error for a task that outlived its run and finds the port of the next."""
    return NotRegisteredError(
        registration.behavior, registration.resource, "this run of it has ended"
    )
