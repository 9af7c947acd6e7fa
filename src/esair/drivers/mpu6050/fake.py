"""An MPU-6050, as its registers look from the bus."""

from __future__ import annotations

from types import MappingProxyType

from esair.buses.i2c import Registers
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

AT_REST = Motion((0.0, 0.0, GRAVITY), (0.0, 0.0, 0.0), 25.0)
"""What the chip feels on a table."""

_RESET = 0x80
_READ_ONLY = {WHO_AM_I, *range(ACCEL_XOUT_H, ACCEL_XOUT_H + 14)}


class FakeMpu6050(Registers):
    """The register map: asleep after power-up, 16-bit values, the high byte first.

    Args:
        motion: What it feels from the beginning.
    """

    size = 128
    power_up: MappingProxyType[int, int | bytes] = MappingProxyType(
        {WHO_AM_I: IDENTITY, PWR_MGMT_1: SLEEP}
    )

    def __init__(self, motion: Motion = AT_REST) -> None:
        self._motion = motion
        super().__init__()

    @property
    def asleep(self) -> bool:
        """Whether it measures nothing."""
        return bool(self.content[PWR_MGMT_1] & SLEEP)

    @property
    def motion(self) -> Motion:
        """What it feels; it measures that at once, unless it is asleep."""
        return self._motion

    @motion.setter
    def motion(self, motion: Motion) -> None:
        self._motion = motion
        self._measure()

    def set(self, register: int, value: int) -> None:
        """Set one register; those that only the chip sets stay as they are."""
        if register == PWR_MGMT_1 and value & _RESET:
            self.power_cycle()
        elif register not in _READ_ONLY:
            self.content[register] = value
        self._measure()

    def _measure(self) -> None:
        if not self.asleep:
            steps = (
                self.content[ACCEL_CONFIG] >> 3 & 3,
                self.content[GYRO_CONFIG] >> 3 & 3,
            )
            self.fill({ACCEL_XOUT_H: encode_motion(self._motion, *steps)})
