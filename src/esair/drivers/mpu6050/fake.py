"""An MPU-6050, as its registers look from the bus."""

from __future__ import annotations

from types import MappingProxyType

from esair.buses.i2c import Registers
from esair.drivers import mpu6050
from esair.drivers.mpu6050 import Motion

AT_REST = Motion((0.0, 0.0, mpu6050.GRAVITY), (0.0, 0.0, 0.0), 25.0)
"""What the chip feels on a table."""

_RESET = 0x80
_READ_ONLY = {mpu6050.WHO_AM_I, *range(mpu6050.ACCEL_XOUT_H, mpu6050.ACCEL_XOUT_H + 14)}


class FakeMpu6050(Registers):
    """The register map: asleep after power-up, 16-bit values, the high byte first.

    Args:
        motion: What it feels from the beginning.
    """

    size = 128
    power_up: MappingProxyType[int, int | bytes] = MappingProxyType(
        {mpu6050.WHO_AM_I: mpu6050.IDENTITY, mpu6050.PWR_MGMT_1: mpu6050.SLEEP}
    )

    def __init__(self, motion: Motion = AT_REST) -> None:
        self._motion = motion
        super().__init__()

    @property
    def asleep(self) -> bool:
        """Whether it measures nothing."""
        return bool(self.content[mpu6050.PWR_MGMT_1] & mpu6050.SLEEP)

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
        if register == mpu6050.PWR_MGMT_1 and value & _RESET:
            self.power_cycle()
        elif register not in _READ_ONLY:
            self.content[register] = value
        self._measure()

    def _measure(self) -> None:
        if not self.asleep:
            steps = (
                self.content[mpu6050.ACCEL_CONFIG] >> 3 & 3,
                self.content[mpu6050.GYRO_CONFIG] >> 3 & 3,
            )
            self.fill(
                {mpu6050.ACCEL_XOUT_H: mpu6050.encode_motion(self._motion, *steps)}
            )
