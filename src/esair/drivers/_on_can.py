"""What the drivers of parts on a CAN bus have in common."""

from __future__ import annotations

from esair.buses import CanBus
from esair.exceptions import ConfigError
from esair.resources import Resource


def can_bus(device: Resource) -> CanBus:
    """Return the bus that a device is on.

    Raises:
        ConfigError: It is on none, or on one of another kind.
    """
    bus: object = device.bus
    if not isinstance(bus, CanBus):
        raise ConfigError(device.name, "bus", f"expected a CanBus, not {bus!r}")
    return bus
