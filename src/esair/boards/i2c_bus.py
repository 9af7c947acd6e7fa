"""An I2C bus that several parts share: one set of pins, one object."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_buses: "dict[Any, Any]" = {}


def shared_i2c(
    number: int, scl: "int | str | None", sda: "int | str | None", frequency: int
) -> "Any":
    """Return the bus of these pins; the same one for every part on it.

    Raises:
        ValueError: A part on it was opened with another frequency.
    """
    from machine import I2C, Pin

    key = (number, scl, sda)
    if key not in _buses:
        if scl is None:
            bus = I2C(number, freq=frequency)
        else:
            bus = I2C(number, scl=Pin(scl), sda=Pin(sda), freq=frequency)
        _buses[key] = (frequency, bus)
    known, bus = _buses[key]
    if known != frequency:
        raise ValueError("frequency: the bus runs with " + str(known) + " Hz already")
    return bus
