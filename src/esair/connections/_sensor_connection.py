"""The sensor connection (SC): the only way to read any sensor."""

from __future__ import annotations

from typing import Any

from esair.connections._ports import SensorPort, Ways
from esair.connections._registrations import Registration
from esair.connections._sensor_channel import SensorChannel
from esair.messages import Reading
from esair.values import check_duration


class SensorConnection(Ways[SensorChannel]):
    """Reads sensors for whoever is registered, whatever bus is behind them."""

    kind = "sensor"

    def port(
        self, registration: Registration, *, max_age: float | None = None
    ) -> SensorPort[Any]:
        """Hand out a port to whoever is registered.

        Args:
            registration: The right to read.
            max_age: The greatest age of its readings, in seconds; the sensor's own
                limit unless given.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
        """
        channel = self.way_of(registration)
        if max_age is not None:
            check_duration(channel.name, "max_age", max_age)
        return SensorPort(channel, registration, max_age, self.control)

    async def read(
        self,
        registration: Registration,
        *,
        fresh: bool = False,
        max_age: float | None = None,
        timeout: float | None = None,
    ) -> Reading[Any]:
        """Return a reading: the newest one, or one that is newer than now.

        The device is asked when the newest reading is older than its period; one
        transaction serves all who ask at the same moment.

        Args:
            registration: The right to read.
            fresh: Only a value that was measured after this call.
            max_age: The greatest age of the reading, in seconds; the sensor's own limit
                unless given.
            timeout: How long to wait for the device, in seconds.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
            StaleReadingError: There is no reading that is fresh enough.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
        """
        port = self.port(registration)
        return await port.reading(fresh=fresh, max_age=max_age, timeout=timeout)
