"""The actuator connection (AC): the only way to write any actuator."""

from __future__ import annotations

from typing import Any

from esair.connections._actuator_channel import ActuatorChannel
from esair.connections._ports import ActuatorPort, Ways
from esair.connections._protection import Protections
from esair.connections._registrations import Registration
from esair.messages import Refused, Written


class ActuatorConnection(Ways[ActuatorChannel]):
    """Writes actuators for whoever is registered; priority decides who moves one."""

    kind = "actuator"

    def __init__(self) -> None:
        super().__init__()
        self.protections = Protections(self.channels)
        """Who keeps an actuator still, by component and name of the actuator."""

    def port(self, registration: Registration) -> ActuatorPort[Any]:
        """Hand out a port to whoever is registered.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
        """
        return ActuatorPort(self.way_of(registration), registration, self.control)

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
