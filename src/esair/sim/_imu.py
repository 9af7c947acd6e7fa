"""The inertial unit of the rover: an MPU-6050 that feels the world."""

from __future__ import annotations

import random

from esair.drivers.mpu6050 import GRAVITY, Motion
from esair.drivers.mpu6050.fake import FakeMpu6050
from esair.sim._world import World


class SimMpu6050(FakeMpu6050):
    """An MPU-6050 whose values have noise, and whose gyroscope has a bias.

    Its low-pass filter takes the mean of the last two steps of the world.
    """

    def __init__(self, world: World, *, seed: int = 0) -> None:
        super().__init__()
        self._world = world
        self._noise = random.Random(f"imu {seed}")
        self._bias = self._noise.gauss(0.0, 0.01)
        self._turn_rate = 0.0

    def step(self) -> None:
        """Measure, unless asleep."""
        if self.asleep:
            return
        ahead, left = self._world.acceleration
        before, self._turn_rate = self._turn_rate, self._world.turn_rate
        noise = self._noise.gauss
        self.motion = Motion(
            (
                ahead + noise(0.0, 0.05),
                left + noise(0.0, 0.05),
                GRAVITY + noise(0.0, 0.05),
            ),
            (
                noise(0.0, 0.004),
                noise(0.0, 0.004),
                (before + self._turn_rate) / 2 + self._bias + noise(0.0, 0.004),
            ),
            27.0,
        )
