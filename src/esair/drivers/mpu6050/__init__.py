"""InvenSense MPU-6050: acceleration and turn rate, over I²C.

Source: MPU-6000 and MPU-6050 Register Map and Descriptions, revision 4.2; the names
of the registers are those of that document.
"""

from __future__ import annotations

import asyncio
import math
import struct
from typing import Any, ClassVar, Unpack

import attrs

from esair.drivers._on_chip import OnChip
from esair.exceptions import DeviceLostError
from esair.resources import Sensor, SensorSettings, setting

__all__ = ["Motion", "Mpu6050", "decode_motion", "encode_motion"]

ADDRESS = 0x68
SMPLRT_DIV = 0x19
GYRO_CONFIG = 0x1B
ACCEL_CONFIG = 0x1C
ACCEL_XOUT_H = 0x3B
PWR_MGMT_1 = 0x6B
WHO_AM_I = 0x75

IDENTITY = 0x68
"""What ``WHO_AM_I`` holds."""

SLEEP = 0x40
"""The bit of ``PWR_MGMT_1`` that is set after power-up."""

AWAKE = b"\x01\0"
"""``PWR_MGMT_1``, with the clock of the gyroscope, as the maker recommends; and that no axis
rests."""

ACCEL_SCALE = 16384.0
"""Counts for each g, at ``AFS_SEL`` 0; half with each step."""

GYRO_SCALE = 131.0
"""Counts for each degree per second, at ``FS_SEL`` 0; half with each step."""

GRAVITY = 9.80665
"""Standard gravity in m/s²."""

STARTING = 0.035
"""How long the gyroscope takes to start (30 ms), and a sample is there, in seconds."""

SAMPLE = 0.002
"""After how long what was measured in another range is replaced, in seconds."""

_BLOCK = struct.Struct(">hhhhhhh")


@attrs.frozen
class Motion:
    """What the chip feels, in its own axes (x forward, y left, z up).

    Attributes:
        acceleration: In m/s², gravity included.
        turn_rate: In rad/s, counter-clockwise positive.
        temperature: In °C.
    """

    acceleration: tuple[float, float, float]
    turn_rate: tuple[float, float, float]
    temperature: float


def decode_motion(block: bytes, accel_step: int = 0, gyro_step: int = 0) -> Motion:
    """Turn the 14 registers from ``ACCEL_XOUT_H`` on into SI units."""
    ax, ay, az, temperature, gx, gy, gz = _BLOCK.unpack(block)
    accel = GRAVITY * (1 << accel_step) / ACCEL_SCALE
    gyro = math.radians(1.0) * (1 << gyro_step) / GYRO_SCALE
    return Motion(
        (ax * accel, ay * accel, az * accel),
        (gx * gyro, gy * gyro, gz * gyro),
        temperature / 340.0 + 36.53,
    )


def encode_motion(motion: Motion, accel_step: int = 0, gyro_step: int = 0) -> bytes:
    """Turn a motion into the 14 registers, as the chip does; too much is cut off."""
    accel = ACCEL_SCALE / (1 << accel_step) / GRAVITY
    gyro = GYRO_SCALE / (1 << gyro_step) / math.radians(1.0)
    values = [value * accel for value in motion.acceleration]
    values.append((motion.temperature - 36.53) * 340.0)
    values += [value * gyro for value in motion.turn_rate]
    return _BLOCK.pack(*(max(-32768, min(32767, round(value))) for value in values))


class _Settings(SensorSettings, total=False):
    gyro_range: int
    accel_range: int


class Mpu6050(OnChip, Sensor[Motion]):
    """An MPU-6050 on an I²C bus.

    At each opening its identity is checked and it is woken and scaled.

    Args:
        address: 0x68, or 0x69 if the chip's pin AD0 is high.
    """

    addresses: ClassVar[range] = range(0x68, 0x6A)
    identity_register: ClassVar[tuple[str, int, int]] = "WHO_AM_I", WHO_AM_I, IDENTITY
    rate: float = setting(
        50.0, unit="Hz", min=1.0, max=200.0, doc="how often it is asked"
    )
    gyro_range: int = setting(
        250,
        unit="°/s",
        choices=(250, 500, 1000, 2000),
        doc="the fastest turn it measures",
    )
    accel_range: int = setting(
        2, unit="g", choices=(2, 4, 8, 16), doc="the hardest push it measures"
    )
    deadline: float = 0.5
    traffic: int = 1 + _BLOCK.size

    def __init__(
        self, *, address: int = ADDRESS, **settings: Unpack[_Settings]
    ) -> None:
        super().__init__(address=address, **settings)
        self.claim: str = f"the chip {address:#04x}"
        self._gyro_step = self._accel_step = 0
        self._quiet = asyncio.Lock()  # while its ranges change

    async def open(self) -> None:
        """Check that it is the chip, wake it and set its ranges."""
        await self._identify()
        self._quiet = asyncio.Lock()
        if await self.bus.read(self.address, PWR_MGMT_1, 2) != AWAKE:
            await self._put(PWR_MGMT_1, *AWAKE)
            await asyncio.sleep(STARTING)
        await self._set_up(**self.settings)

    async def read(self) -> Motion:
        """Read all axes at one moment, in one transfer."""
        async with self._quiet:
            block = await self.bus.read(self.address, ACCEL_XOUT_H, _BLOCK.size)
            steps = self._accel_step, self._gyro_step
        if block in {bytes(_BLOCK.size), b"\xff" * _BLOCK.size}:
            told = (
                f"every byte is {block[0]:#x}: the chip sleeps, it has lost its power"
            )
            raise DeviceLostError(self.name, told)
        return decode_motion(block, *steps)

    async def is_set_up(self) -> bool:
        """Tell whether it is awake and has its ranges, which a restart forgets."""
        power = await self.bus.read(self.address, PWR_MGMT_1, 2)
        ranges = await self.bus.read(self.address, GYRO_CONFIG, 2)
        told = bytes([self._gyro_step << 3, self._accel_step << 3])
        return power == AWAKE and ranges == told

    async def _set_up(self, *, gyro_range: int, accel_range: int, **_: Any) -> None:
        gyro_step = (250, 500, 1000, 2000).index(gyro_range)
        accel_step = (2, 4, 8, 16).index(accel_range)
        async with self._quiet:
            # Every sample, unfiltered: another program may have left it slow.
            await self._put(SMPLRT_DIV, 0, 0, gyro_step << 3, accel_step << 3)
            self._gyro_step, self._accel_step = gyro_step, accel_step
            await asyncio.sleep(SAMPLE)
