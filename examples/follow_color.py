"""A head that turns to what is red: a camera, a reaction, a servo.

The servo, a Dynamixel, carries the camera; `esair devices` lists both::

    python examples/follow_color.py usb:046d:0825 usb:0403:6014
"""

import sys
from typing import Any

import numpy as np

import esair
from esair.drivers.camera import Camera
from esair.drivers.servo import ServoBus
from esair.drivers.servo.turning import ServoVelocity

GAIN = 2.0  # rad/s for what is at the edge
ENOUGH = 0.002  # of all pixels


def place_of_red(frame: Any) -> float | None:
    """Return where what is red is, from -1 at the left to 1; None if nothing is."""
    blue, green, red = (frame[:, :, n].astype(np.int16) for n in range(3))
    is_red = (red > 100) & (red - blue > 50) & (red - green > 50)
    if is_red.mean() < ENOUGH:
        return None
    columns = np.nonzero(is_red)[1]
    return float(2 * columns.mean() / (frame.shape[1] - 1) - 1)


class Follow(esair.Reaction):
    """Turn so that it is in the middle; stand while nothing is red."""

    eye = esair.reads(np.ndarray, max_age=0.5)
    neck = esair.writes(float)
    rate = 20.0

    def react(self, eye: Any) -> float:
        place = place_of_red(eye)
        return 0.0 if place is None else -GAIN * place


def make_robot(camera: Camera, bus: ServoBus) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(
        resources=[camera, ServoVelocity(name="neck", id=1, bus=bus)],
        behaviors=[Follow()],
    )


are_named = __name__ == "__main__" and len(sys.argv) == 3
device, port = sys.argv[1:] if are_named else ("usb:046d:0825", "usb:0403:6014")
camera = Camera(name="eye", device=device, width=320, height=240)
robot = make_robot(camera, ServoBus(name="line", port=port))

if __name__ == "__main__":
    esair.run(robot)
