"""An ADS1115, as its registers look from the bus."""

from __future__ import annotations

from esair.drivers.ads1115 import (
    CHANNELS,
    CONFIG,
    CONVERSION,
    FULL_SCALES,
    SINGLE,
    START,
)

_POWER_UP = 0x8583
_NAMES = {code: name for name, code in CHANNELS.items()}


class FakeAds1115:
    """Four registers of 16 bits, and four inputs.

    Args:
        *inputs: The voltages at the inputs 0 to 3, in V; 0 unless given.

    Attributes:
        inputs: The voltages at the inputs, in V.
        busy: How often it says that a conversion is still under way.
        conversions: What was converted, in order, as ``"0"`` or ``"0-1"``.
    """

    keeps_pointer = True

    def __init__(self, *inputs: float) -> None:
        self.inputs: list[float] = [*inputs, 0.0, 0.0, 0.0, 0.0][:4]
        self.busy = 1
        self.conversions: list[str] = []
        self.power_cycle()

    def power_cycle(self) -> None:
        """Lose the power for a moment: its registers are as they come."""
        self._busy = 0
        self._under_way = _POWER_UP
        self._registers = [0, _POWER_UP, 0x8000, 0x7FFF]

    def read(self, register: int, length: int) -> bytes:
        """Return a register of 16 bits, the high byte first, again and again."""
        number = register & 3
        value = self._registers[number]
        if number == CONFIG:
            value = value & ~START if self._busy > 0 else value | START
            if self._busy == 1:
                self._convert(self._under_way)
            self._busy -= 1
        elif number == CONVERSION and not self._registers[CONFIG] & SINGLE:
            self._convert(self._registers[CONFIG])
            value = self._registers[CONVERSION]
        return (value.to_bytes(2, "big") * (length // 2 + 1))[:length]

    def write(self, register: int, data: bytes) -> None:
        """Set a register of 16 bits, the high byte first."""
        if len(data) < 2 or register & 3 == CONVERSION:
            return
        self._registers[register & 3] = int.from_bytes(data[:2], "big")
        config = self._registers[CONFIG]
        # While a conversion is under way no other is begun, and it stays what it is.
        if register & 3 == CONFIG and config & START and self._busy <= 0:
            self._busy = self.busy
            self._under_way = config
            if not self.busy:
                self._convert(config)

    def _convert(self, config: int) -> None:
        name = _NAMES[config >> 12 & 7]
        plus, _, minus = name.partition("-")
        volts = self.inputs[int(plus)] - (self.inputs[int(minus)] if minus else 0.0)
        full_scale = FULL_SCALES[min(config >> 9 & 7, 5)]
        code = max(-32768, min(32767, round(volts / full_scale * 32768)))
        self._registers[CONVERSION] = code & 0xFFFF
        self.conversions.append(name)
