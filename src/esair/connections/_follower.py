"""Who is fed with each new reading of a sensor."""

from __future__ import annotations

from typing import Any, Protocol

from esair.connections._registrations import Registration
from esair.exceptions import EsairError
from esair.messages import Reading


class Follower(Protocol):
    """Gets every new reading of a sensor, at once, in the loop."""

    @property
    def registration(self) -> Registration:
        """The right by which it follows."""

    def feed(self, reading: Reading[Any]) -> None:
        """Take a new reading; must not wait."""

    def changed(self, error: EsairError | None) -> None:
        """Learn that the sensor is gone for now (why), or back (None)."""

    def limited(self) -> None:
        """Learn that the sensor's own greatest age of a reading has changed."""

    def doubt(self, error: EsairError) -> None:
        """Learn that it has given a bad value, or an error instead of one."""
