"""A fan that turns while the air is humid; its parts have CircuitPython drivers."""

from typing import Any

from adafruit_ads1x15 import ADS1115, AnalogIn
from adafruit_bus_device.i2c_device import I2CDevice  # type: ignore[import-untyped]
from adafruit_register.i2c_struct import UnaryStruct  # type: ignore[import-untyped]

import esair


class Ventilate(esair.Reaction):
    """Turn the fan while it is humid and the battery is not low."""

    air = esair.reads(dict, max_age=5.0)
    battery = esair.reads(float, max_age=5.0)
    fan = esair.writes(int)
    rate = 10.0

    def react(self, air: dict[str, float], battery: float) -> int:
        return 200 if air["relative_humidity"] > 60.0 and battery > 3.0 else 0


def battery_input(i2c: Any, *, address: int) -> AnalogIn:
    """Make the analog input at which the battery is: an object of two classes."""
    return AnalogIn(ADS1115(i2c, address=address), 0)


class Fan:
    """A motor board of our own, in the style of Adafruit's drivers."""

    speed = UnaryStruct(0x00, "<B")

    def __init__(self, i2c: Any, address: int = 0x60) -> None:
        self.i2c_device = I2CDevice(i2c, address)
