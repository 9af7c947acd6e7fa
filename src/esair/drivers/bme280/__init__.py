"""Bosch BME280: temperature, humidity and air pressure, over I²C.

Source: BME280 Combined humidity and pressure sensor, data sheet BST-BME280-DS002; the
compensation is that of its section 4.2.3, in whole numbers, pressure in 64 bits.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping
from typing import Any, ClassVar, Unpack

import attrs

from esair.drivers._on_chip import OnChip
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.resources import Sensor, SensorSettings, setting

__all__ = ["Bme280", "Calibration", "Climate", "compensate"]

ADDRESS = 0x76
CALIBRATION_00 = 0x88
ID = 0xD0
CALIBRATION_26 = 0xE1
CTRL_HUM = 0xF2
STATUS = 0xF3
CTRL_MEAS = 0xF4
CONFIG = 0xF5
DATA = 0xF7

IDENTITY = 0x60
"""What ``ID`` holds."""

MEASURING = 0x08
UPDATING = 0x01
"""``STATUS``: the calibration is being copied out of the memory, after power-up."""

FORCED = 0x01
"""The mode of ``CTRL_MEAS``: measure once, then sleep."""

SKIPPED = 0x80000
"""A raw temperature or pressure that was not measured, or happens to be this."""

SKIPPED_HUMIDITY = 0x8000

_OVERSAMPLING = (1, 2, 4, 8, 16)
_FILTER = (1, 2, 4, 8, 16)
_PATIENCE = 10


@attrs.frozen
class Climate:
    """The air around the sensor.

    Attributes:
        temperature: In °C.
        humidity: Relative, 0 to 1.
        pressure: In Pa.
    """

    temperature: float
    humidity: float
    pressure: float


@attrs.frozen
class Calibration:
    """What the maker has measured of one chip: ``dig_T1`` to ``dig_H6``."""

    t: tuple[int, int, int]
    p: tuple[int, int, int, int, int, int, int, int, int]
    h: tuple[int, int, int, int, int, int]

    @classmethod
    def decode(cls, first: bytes, second: bytes) -> Calibration:
        """Read it from the 26 registers from 0x88 and the 7 from 0xE1 on."""
        words = struct.unpack("<HhhHhhhhhhhh", first[:24])
        h2, h3, high4, shared, high5, h6 = struct.unpack("<hBbBbb", second)
        h4, h5 = high4 << 4 | shared & 0x0F, high5 << 4 | shared >> 4
        return cls(words[:3], words[3:], (first[25], h2, h3, h4, h5, h6))

    def encode(self) -> tuple[bytes, bytes]:
        """Return the 26 registers from 0x88 and the 7 from 0xE1 on."""
        h1, h2, h3, h4, h5, h6 = self.h
        shared = (h5 & 0x0F) << 4 | h4 & 0x0F
        return (
            struct.pack("<HhhHhhhhhhhhxB", *self.t, *self.p, h1),
            struct.pack("<hBbBbb", h2, h3, h4 >> 4, shared, h5 >> 4, h6),
        )


def fine_temperature(raw: int, calibration: Calibration) -> int:
    """Return ``t_fine``: the temperature in 1/5120 °C."""
    t1, t2, t3 = calibration.t
    var1 = (((raw >> 3) - (t1 << 1)) * t2) >> 11
    delta = (raw >> 4) - t1
    return var1 + ((((delta * delta) >> 12) * t3) >> 14)


def pressure_of(raw: int, fine: int, calibration: Calibration) -> float:
    """Return the pressure in Pa.

    Raises:
        ZeroDivisionError: The calibration is that of no chip.
    """
    p1, p2, p3, p4, p5, p6, p7, p8, p9 = calibration.p
    var1 = fine - 128000
    var2 = var1 * var1 * p6 + ((var1 * p5) << 17) + (p4 << 35)
    var1 = ((var1 * var1 * p3) >> 8) + ((var1 * p2) << 12)
    var1 = (((1 << 47) + var1) * p1) >> 33
    pressure = 1048576 - raw
    pressure = (((pressure << 31) - var2) * 3125) // var1
    var1 = (p9 * (pressure >> 13) * (pressure >> 13)) >> 25
    var2 = (p8 * pressure) >> 19
    return (((pressure + var1 + var2) >> 8) + (p7 << 4)) / 256.0


def humidity_of(raw: int, fine: int, calibration: Calibration) -> float:
    """Return the relative humidity, 0 to 1."""
    h1, h2, h3, h4, h5, h6 = calibration.h
    v = fine - 76800
    left = (((raw << 14) - (h4 << 20) - h5 * v) + 16384) >> 15
    right = (v * h6) >> 10
    right = (right * (((v * h3) >> 11) + 32768)) >> 10
    v = left * (((right + 2097152) * h2 + 8192) >> 14)
    v -= ((((v >> 15) * (v >> 15)) >> 7) * h1) >> 4
    v = max(0, min(v, 419430400))
    return (v >> 12) / 1024.0 / 100.0


def compensate(block: bytes, calibration: Calibration) -> Climate:
    """Turn the eight registers from ``DATA`` on into SI units.

    Raises:
        ValueError: Nothing was measured.
        ZeroDivisionError: The calibration is that of no chip.
    """
    pressure = int.from_bytes(block[0:3], "big") >> 4
    temperature = int.from_bytes(block[3:6], "big") >> 4
    humidity = int.from_bytes(block[6:8], "big")
    # One of them alone is a value: at some 26 °C the temperature is that very number.
    if pressure == temperature == SKIPPED and humidity == SKIPPED_HUMIDITY:
        raise ValueError("the chip has not measured")
    fine = fine_temperature(temperature, calibration)
    return Climate(
        ((fine * 5 + 128) >> 8) / 100.0,
        humidity_of(humidity, fine, calibration),
        pressure_of(pressure, fine, calibration),
    )


class _Settings(SensorSettings, total=False):
    oversampling: int
    smoothing: int


class Bme280(OnChip, Sensor[Climate]):
    """A BME280 on an I²C bus, which measures when it is asked and sleeps else.

    Args:
        address: 0x76, or 0x77 if the chip's pin SDO is high.
    """

    addresses: ClassVar[range] = range(0x76, 0x78)
    identity_register: ClassVar[tuple[str, int, int]] = "ID", ID, IDENTITY
    others: ClassVar[Mapping[int, str]] = dict.fromkeys(
        (0x56, 0x57, 0x58), "a BMP280, without humidity"
    )
    rate: float = setting(
        1.0, unit="Hz", min=0.001, max=50.0, doc="how often it is asked"
    )
    oversampling: int = setting(
        1,
        choices=_OVERSAMPLING,
        doc="how many samples a value is the mean of; 16 take 0.12 s",
    )
    smoothing: int = setting(
        1,
        choices=_FILTER,
        doc="how slowly temperature and pressure follow (IIR filter)",
    )
    deadline: float = 0.5

    def __init__(
        self, *, address: int = ADDRESS, **settings: Unpack[_Settings]
    ) -> None:
        super().__init__(address=address, **settings)
        self.claim: str = f"the chip {address:#04x}"
        self._calibration: Calibration | None = None
        self._told = 1, 0
        """What it was told: how many samples, and how smoothly, as its codes."""

    async def open(self) -> None:
        """Check that it is the chip, read its calibration and set it up."""
        await self._identify()
        await self._until_not(UPDATING, "does not come up")
        self._calibration = Calibration.decode(
            await self.bus.read(self.address, CALIBRATION_00, 26),
            await self.bus.read(self.address, CALIBRATION_26, 7),
        )
        await self._set_up(**self.settings)

    async def read(self) -> Climate:
        """Measure once and wait for it."""
        if self._calibration is None:
            raise DeviceFaultError(self.name, "it is not open")
        code, _ = self._told
        await self._put(CTRL_MEAS, code << 5 | code << 2 | FORCED)
        await asyncio.sleep(measuring_time(_OVERSAMPLING[code - 1]))
        await self._until_not(MEASURING, "does not end its measurement")
        # The settings too, which a chip forgets that was without power.
        block = await self.bus.read(self.address, CTRL_HUM, DATA + 8 - CTRL_HUM)
        if self._told != (block[0] & 0x07, block[CONFIG - CTRL_HUM] >> 2 & 0x07):
            raise DeviceLostError(
                self.name, "its settings are gone: it has lost its power"
            )
        try:
            return compensate(block[DATA - CTRL_HUM :], self._calibration)
        except (ValueError, ZeroDivisionError) as error:
            raise DeviceFaultError(
                self.name, f"{error}: it has lost its power, or its memory"
            ) from error

    async def is_set_up(self) -> bool:
        """Tell whether it has its settings, which a restart forgets."""
        humidity, smoothing = await self._get(CTRL_HUM), await self._get(CONFIG)
        return self._told == (humidity & 0x07, smoothing >> 2 & 0x07)

    async def _set_up(self, *, oversampling: int, smoothing: int, **_: Any) -> None:
        told = _OVERSAMPLING.index(oversampling) + 1, _FILTER.index(smoothing)
        # Both count from the next measurement on; asleep, the chip takes all.
        await self._put(CTRL_MEAS, 0)
        await self._put(CTRL_HUM, told[0])
        await self._put(CONFIG, told[1] << 2)
        self._told = told

    async def _until_not(self, bit: int, what: str) -> None:
        for _ in range(_PATIENCE):
            if not await self._get(STATUS) & bit:
                return
            await asyncio.sleep(0.002)
        raise DeviceFaultError(self.name, what)


def measuring_time(samples: int) -> float:
    """Return how long a measurement may take, in seconds (appendix B)."""
    return 0.00125 + 3 * 0.0023 * samples + 2 * 0.000575
