"""The sensor connection (SC): the only way to read any sensor."""

from __future__ import annotations

from typing import Any

from esair.abc import Connection
from esair.connections._port import Control
from esair.connections._ports import SensorPort, way_of
from esair.connections._registrations import Registration
from esair.connections._sensor_channel import SensorChannel
from esair.exceptions import UnknownNameError
from esair.messages import Reading
from esair.values import check_duration


class SensorConnection(Connection):
    """Reads sensors for whoever is registered, whatever bus is behind them."""

    def __init__(self) -> None:
        self.channels: dict[str, SensorChannel] = {}
        """The way to each sensor; the resource supervisor fills it."""
        self.control: Control | None = None
        """The control path of the ports; the resource supervisor's."""

    def names(self) -> list[str]:
        """Return the names of the sensors."""
        return list(self.channels)

    def channel(self, name: str) -> SensorChannel:
        """Return the way to one sensor.

        Raises:
            UnknownNameError: No sensor has the name.
        """
        try:
            return self.channels[name]
        except KeyError:
            raise UnknownNameError("sensor", name, self.channels) from None

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
        channel = way_of(registration, self.channels, "sensor")
        if max_age is not None:
            check_duration(channel.name, "max_age", max_age)
        assert self.control is not None
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
