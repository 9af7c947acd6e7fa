"""An MPU-6050, as its registers look from the bus."""

from __future__ import annotations

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


class FakeMpu6050:
    """The register map: asleep after power-up, 16-bit values, the high byte first.

    Args:
        motion: What it feels from the beginning.
    """

    def __init__(self, motion: Motion = AT_REST) -> None:
        self._motion = motion
        self._registers = bytearray(128)
        self.power_cycle()

    @property
    def asleep(self) -> bool:
        """Whether it measures nothing."""
        return bool(self._registers[PWR_MGMT_1] & SLEEP)

    @property
    def motion(self) -> Motion:
        """What it feels; it measures that at once, unless it is asleep."""
        return self._motion

    @motion.setter
    def motion(self, motion: Motion) -> None:
        self._motion = motion
        self._measure()

    def power_cycle(self) -> None:
        """Lose the power for a moment: it is as after power-up."""
        self._registers[:] = bytes(128)
        self._registers[WHO_AM_I] = IDENTITY
        self._registers[PWR_MGMT_1] = SLEEP

    def read(self, register: int, length: int) -> bytes:
        """Return registers that follow one another; they wrap around at the end."""
        registers = bytes(self._registers)  # one moment, whoever measures meanwhile
        return bytes(registers[(register + index) % 128] for index in range(length))

    def write(self, register: int, data: bytes) -> None:
        """Set registers; those that only the chip sets stay as they are."""
        for index, value in enumerate(data):
            number = (register + index) % 128
            if number == PWR_MGMT_1 and value & _RESET:
                self.power_cycle()
            elif number not in _READ_ONLY:
                self._registers[number] = value
        self._measure()

    def _measure(self) -> None:
        if not self.asleep:
            self._registers[ACCEL_XOUT_H : ACCEL_XOUT_H + 14] = encode_motion(
                self._motion,
                self._registers[ACCEL_CONFIG] >> 3 & 3,
                self._registers[GYRO_CONFIG] >> 3 & 3,
            )
