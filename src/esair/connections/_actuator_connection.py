"""The actuator connection (AC): the only way to write any actuator."""

from __future__ import annotations

from typing import Any

from esair.abc import Connection
from esair.connections._actuator_channel import ActuatorChannel
from esair.connections._port import Control
from esair.connections._ports import ActuatorPort, way_of
from esair.connections._protection import Protections
from esair.connections._registrations import Registration
from esair.exceptions import UnknownNameError
from esair.messages import Refused, Written


class ActuatorConnection(Connection):
    """Writes actuators for whoever is registered; priority decides who moves one."""

    def __init__(self) -> None:
        self.channels: dict[str, ActuatorChannel] = {}
        """The way to each actuator; the resource supervisor fills it."""
        self.control: Control | None = None
        """The control path of the ports; the resource supervisor's."""
        self.protections = Protections(self.channels)
        """Who keeps an actuator still, by component and name of the actuator."""

    def names(self) -> list[str]:
        """Return the names of the actuators."""
        return list(self.channels)

    def channel(self, name: str) -> ActuatorChannel:
        """Return the way to one actuator.

        Raises:
            UnknownNameError: No actuator has the name.
        """
        try:
            return self.channels[name]
        except KeyError:
            raise UnknownNameError("actuator", name, self.channels) from None

    def port(self, registration: Registration) -> ActuatorPort[Any]:
        """Hand out a port to whoever is registered.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
        """
        channel = way_of(registration, self.channels, "actuator")
        assert self.control is not None
        return ActuatorPort(channel, registration, self.control)

    async def write(
        self, registration: Registration, command: Any, *, hold: float | None = None
    ) -> Written[Any] | Refused:
        """Send a command, or say who holds the actuator.

        Args:
            registration: The right to write.
            command: A command of the actuator's type, finite and within limits.
            hold: For how long it holds the actuator, in seconds; the actuator's
                command timeout unless given.

        Returns:
            What was really sent, or a refusal, which is false in a condition.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
            BadValueError: The command must not be sent.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device did not take it.
        """
        return await self.port(registration).write(command, hold=hold)
