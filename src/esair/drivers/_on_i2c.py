"""What the drivers of parts on an I²C bus have in common."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from esair.buses import I2CBus
from esair.buses.i2c import SILENT
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.resources import Resource


def i2c_bus(device: Resource) -> I2CBus:
    """Return the bus that a device is on.

    Raises:
        ConfigError: It is on none, or on one of another kind.
    """
    bus: object = device.bus
    if not isinstance(bus, I2CBus):
        raise ConfigError(device.name, "bus", f"expected an I2CBus, not {bus!r}")
    return bus


def check_address(device: Resource, address: object, allowed: range) -> int:
    """Return the address of a chip, if the chip can have it.

    Raises:
        ConfigError: It cannot.
    """
    if type(address) is int and address in allowed:
        return address
    shown = f"{address:#04x}" if type(address) is int else f"{address!r:.80}"
    raise ConfigError(
        device.name,
        "address",
        f"expected {allowed[0]:#04x} to {allowed[-1]:#04x}, not {shown}",
    )


@contextlib.contextmanager
def expected_at(device: Resource, address: int) -> Iterator[None]:
    """Take a chip that does not answer at its opening for one that is not there.

    So it is waited for, for as long as it takes; one that answers wrongly is not.

    Raises:
        DeviceLostError: Nobody answers.
    """
    try:
        yield
    except DeviceFaultError as error:
        if error.errno not in SILENT:
            raise
        raise DeviceLostError(
            device.name, f"no chip answers at {address:#04x}"
        ) from error
