"""A window that opens when the air is bad, with parts on one I²C bus.

A BME280 measures the air, an ADS1115 the battery, a servo on a PCA9685 moves the window.
Run it with the number or the name of the bus (`i2cdetect -l` shows both)::

    python examples/i2c_weather.py 1
    python examples/i2c_weather.py name:i2c-tiny-usb
"""

import math
import sys

import esair
from esair.buses import I2CBus
from esair.drivers.ads1115 import Ads1115
from esair.drivers.bme280 import Bme280, Climate
from esair.drivers.pca9685.servo import PwmServo, ServoPosition

HUMID = 0.6
WARM = 26.0  # °C
LOW = 3.3  # V, at the battery

SHUT = ServoPosition(0.0)
OPEN = ServoPosition(math.pi / 3)


class Air(esair.Reaction):
    """Open the window while it is humid or warm."""

    air = esair.reads(Climate, max_age=5.0)
    window = esair.writes(ServoPosition)
    rate = 10.0

    def react(self, air: Climate) -> ServoPosition:
        return OPEN if air.humidity > HUMID or air.temperature > WARM else SHUT


class Guard(esair.Reaction):
    """Shut the window, whatever the air is like, while there is power left for it."""

    battery = esair.reads(float, max_age=5.0)
    window = esair.writes(ServoPosition, priority=10)
    rate = 10.0

    def react(self, battery: float) -> ServoPosition | None:
        return SHUT if 2.0 * battery < LOW else None  # two equal resistors halve it


def make_robot(bus: I2CBus) -> esair.Robot:
    """Return the robot; all its parts share the bus."""
    return esair.Robot(
        resources=[
            Bme280(name="air", bus=bus, rate=1.0),
            Ads1115(name="battery", bus=bus, channel=0, rate=2.0),
            PwmServo(name="window", bus=bus, channel=0, min_angle=0.0, max_angle=2.0),
        ],
        behaviors=[Air(), Guard()],
    )


robot = make_robot(I2CBus(name="chips", bus=1))

if __name__ == "__main__":
    place = sys.argv[1] if len(sys.argv) > 1 else "1"
    bus = I2CBus(name="chips", bus=int(place) if place.isdecimal() else place)
    esair.run(make_robot(bus))
