"""Texas Instruments ADS1115: four analog inputs of 16 bits, over I²C.

Source: ADS111x Ultra-Small, Low-Power, I2C-Compatible, 860-SPS, 16-Bit ADCs, SBAS444.
"""

from __future__ import annotations

import asyncio
from typing import Any, ClassVar, Unpack

import attrs

from esair.drivers._on_bus import shared
from esair.drivers._on_chip import OnChip
from esair.exceptions import DeviceFaultError
from esair.resources import Sensor, SensorSettings, setting
from esair.values import check_choice

__all__ = ["Ads1115", "config_for", "decode_volts"]

ADDRESS = 0x48
CONVERSION = 0x00
CONFIG = 0x01

CHANNELS = {
    "0-1": 0, "0-3": 1, "1-3": 2, "2-3": 3, "0": 4, "1": 5, "2": 6, "3": 7,
}  # fmt: skip
"""The field ``MUX`` by what is measured: an input, or the difference of two."""

FULL_SCALES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)
"""The field ``PGA``: the greatest voltage, in V."""

DATA_RATES = (8, 16, 32, 64, 128, 250, 475, 860)
"""The field ``DR``: conversions in a second."""

START = 0x8000
"""``OS``: start a conversion; read, it means that none is under way."""

SINGLE = 0x0100
"""``MODE``: convert once, then sleep."""

NO_COMPARATOR = 0x0007
"""``COMP_QUE``, and ``COMP_LAT``, which means nothing then: a chip that has lost its power
has no configuration of ours."""

TOLERANCE = 1.1
"""How much longer a conversion may take: the chip's clock is good to 10 percent."""

_PATIENCE = 10


@attrs.define
class Chip:
    """What is known of a chip that several sensors use."""

    loop: asyncio.AbstractEventLoop
    turn: asyncio.Lock = attrs.field(factory=asyncio.Lock)
    under_way: int | None = None
    """The data rate in Hz of a conversion whose end nobody has seen yet."""


def config_for(channel: str, full_scale: float, data_rate: int) -> int:
    """Return what to write to ``CONFIG`` for one conversion."""
    return (
        START
        | CHANNELS[channel] << 12
        | FULL_SCALES.index(full_scale) << 9
        | SINGLE
        | DATA_RATES.index(data_rate) << 5
        | NO_COMPARATOR
    )


def decode_volts(block: bytes, full_scale: float) -> float:
    """Turn the two bytes of ``CONVERSION`` into volts."""
    return int.from_bytes(block, "big", signed=True) * full_scale / 32768


class _Settings(SensorSettings, total=False):
    full_scale: float
    data_rate: int


class Ads1115(OnChip, Sensor[float]):
    """One input of an ADS1115, or the difference of two, in V.

    Several sensors may be on one chip; each converts in its turn. A voltage beyond the
    full scale reads as the full scale.

    Args:
        channel: 0 to 3, or ``"0-1"``, ``"0-3"``, ``"1-3"``, ``"2-3"``.
        address: 0x48 to 0x4b, by the chip's pin ADDR.
    """

    addresses: ClassVar[range] = range(0x48, 0x4C)
    full_scale: float = setting(
        4.096,
        unit="V",
        choices=FULL_SCALES,
        doc="the greatest voltage (the gain); no input may be beyond the supply",
    )
    data_rate: int = setting(
        128,
        unit="Hz",
        choices=DATA_RATES,
        doc="how fast it converts; slower is less noise",
    )

    def __init__(
        self,
        *,
        channel: int | str = 0,
        address: int = ADDRESS,
        **settings: Unpack[_Settings],
    ) -> None:
        super().__init__(address=address, **settings)
        self.channel: str = str(channel)
        check_choice(self.name, "channel", self.channel, sorted(CHANNELS))
        self._full_scale: float = self.full_scale
        self._data_rate: int = self.data_rate

    async def open(self) -> None:
        """Find out whether the chip answers; it needs nothing else."""
        await self._set_up(**self.settings)
        with self._expected():
            await self.bus.read(self.address, CONFIG, 2)

    def _chip(self) -> Chip:
        chips, loop = shared(self.bus, Chip), asyncio.get_running_loop()
        chip = chips.get(self.address)
        if chip is None or chip.loop is not loop:  # a lock is of one loop
            before = None if chip is None else chip.under_way
            chip = chips[self.address] = Chip(loop, under_way=before)
        return chip

    async def _set_up(self, *, full_scale: float, data_rate: int, **_: Any) -> None:
        """Use these settings from the next conversion on."""
        self._full_scale, self._data_rate = full_scale, data_rate

    async def read(self) -> float:
        """Convert once and wait for it."""
        chip = self._chip()
        async with chip.turn:  # or another sensor would change what is converted
            if chip.under_way is not None:
                # Whoever began it was cancelled. Until its end the chip begins no other,
                # and what it gives is the voltage at that one's input.
                await self._end_of_conversion(chip, chip.under_way)
            full_scale = self._full_scale
            config = config_for(self.channel, full_scale, self._data_rate)
            chip.under_way = self._data_rate
            await self._put(CONFIG, *config.to_bytes(2, "big"))
            now = await self._end_of_conversion(chip, chip.under_way)
            if now & ~START != config & ~START:
                raise DeviceFaultError(
                    self.name,
                    f"CONFIG is {now:#06x} instead of {config:#06x}: the chip has "
                    "lost its power, or somebody else uses it",
                )
            block = await self.bus.read(self.address, CONVERSION, 2)
            return decode_volts(block, full_scale)

    async def _end_of_conversion(self, chip: Chip, data_rate: int) -> int:
        """Wait until no conversion is under way; return what is in ``CONFIG`` then."""
        await asyncio.sleep(TOLERANCE / data_rate)
        for _ in range(_PATIENCE):
            state = await self.bus.read(self.address, CONFIG, 2)
            now = int.from_bytes(state, "big")
            if now & START:
                chip.under_way = None
                return now
            await asyncio.sleep(0.001)
        raise DeviceFaultError(self.name, "the conversion does not end")
