"""An MPU-6050, as its registers look from the bus."""

from __future__ import annotations

import random

from esair.drivers.mpu6050 import (
    ACCEL_CONFIG,
    ACCEL_XOUT_H,
    GRAVITY,
    GYRO_CONFIG,
    IDENTITY,
    PWR_MGMT_1,
    SLEEP,
    WHO_AM_I,
    Motion,
    encode_motion,
)
from esair.sim._world import World

_READ_ONLY = {WHO_AM_I, *range(ACCEL_XOUT_H, ACCEL_XOUT_H + 14)}


class SimMpu6050:
    """The register map: asleep after power-up, 16-bit values, the high byte first.

    Its low-pass filter takes the mean of the last two steps of the world.
    """

    def __init__(self, world: World, *, seed: int = 0) -> None:
        self._world = world
        self._noise = random.Random(f"imu {seed}")
        self._bias = self._noise.gauss(0.0, 0.01)
        self._turn_rate = 0.0
        self._registers = bytearray(128)
        self._reset()

    def read(self, register: int, length: int) -> bytes:
        """Return registers that follow one another; they wrap around at the end."""
        registers = bytes(self._registers)  # one moment, whatever `step` does meanwhile
        return bytes(registers[(register + index) % 128] for index in range(length))

    def write(self, register: int, data: bytes) -> None:
        """Set registers; those that only the chip sets stay as they are."""
        for index, value in enumerate(data):
            number = (register + index) % 128
            if number == PWR_MGMT_1 and value & 0x80:
                self._reset()
            elif number not in _READ_ONLY:
                self._registers[number] = value

    def step(self) -> None:
        """Measure, unless asleep."""
        if self._registers[PWR_MGMT_1] & SLEEP:
            return
        ahead, left = self._world.acceleration
        before, self._turn_rate = self._turn_rate, self._world.turn_rate
        noise = self._noise.gauss
        motion = Motion(
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
        block = encode_motion(
            motion,
            self._registers[ACCEL_CONFIG] >> 3 & 3,
            self._registers[GYRO_CONFIG] >> 3 & 3,
        )
        self._registers[ACCEL_XOUT_H : ACCEL_XOUT_H + 14] = block

    def _reset(self) -> None:
        self._registers[:] = bytes(128)
        self._registers[WHO_AM_I] = IDENTITY
        self._registers[PWR_MGMT_1] = SLEEP
