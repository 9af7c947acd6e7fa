"""The sensor connection (SC): the only way to read any sensor."""

from __future__ import annotations

from typing import Any

from esair.abc import Connection
from esair.connections._registrations import Registration
from esair.connections._sensor_channel import READ_TIMEOUT, SensorChannel
from esair.exceptions import NotRegisteredError, UnknownNameError
from esair.loop import Budget
from esair.messages import Reading
from esair.values import check_duration


class SensorConnection(Connection):
    """Reads sensors for whoever is registered, whatever bus is behind them."""

    def __init__(self) -> None:
        self.channels: dict[str, SensorChannel] = {}
        """The way to each sensor; the resource supervisor fills it."""

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
        await Budget.spend()
        channel = self.channels.get(getattr(registration, "resource", ""))
        if channel is None:
            raise self._gone(registration)
        channel.registrations.check(registration)
        for field, seconds in (("max_age", max_age), ("timeout", timeout)):
            if seconds is not None:
                check_duration(channel.name, field, seconds)
        max_age = channel.max_age if max_age is None else max_age
        limit = min(channel.good_for, max_age)
        if not fresh:
            reading = channel.cached(registration, limit)
            if reading is not None:
                return reading
        return await channel.ask(
            registration,
            fresh=fresh,
            max_age=max_age,
            timeout=READ_TIMEOUT if timeout is None else timeout,
        )

    def _gone(self, registration: Registration) -> Exception:
        if not isinstance(registration, Registration):
            return NotRegisteredError(
                "?", "?", f"{registration!r:.80} is no registration"
            )
        if registration.reason is not None:
            return registration.reason()
        return UnknownNameError("sensor", registration.resource, self.channels)
