"""A PCA9685, as its registers look from the bus."""

from __future__ import annotations

from types import MappingProxyType

from esair.buses.i2c import Registers
from esair.drivers.pca9685 import (
    AUTO_INCREMENT,
    FULL,
    LED0_ON_L,
    MODE1,
    MODE2,
    OUTDRV,
    PRE_SCALE,
    SLEEP,
    STEPS,
    decode_steps,
    frequency_of,
)

_ALL_LED = 0xFA
_RESTART = 0x80
_POWER_UP = {MODE1: 0x11, MODE2: OUTDRV, PRE_SCALE: 0x1E}
_OFF = {LED0_ON_L + 4 * channel + 3: FULL for channel in range(16)}


class FakePca9685(Registers):
    """The register map: asleep and all channels off after power-up.

    Attributes:
        stops: How often all channels were stopped, for a frequency can be set only
            while the chip sleeps.
    """

    keeps_pointer = True
    power_up: MappingProxyType[int, int | bytes] = MappingProxyType(_POWER_UP | _OFF)

    def __init__(self) -> None:
        self.stops: int = 0
        super().__init__()

    @property
    def asleep(self) -> bool:
        """Whether the oscillator is off, and every channel with it."""
        return bool(self.content[MODE1] & SLEEP)

    @property
    def frequency(self) -> float:
        """How many periods a second, in Hz."""
        return frequency_of(self.content[PRE_SCALE])

    def duty(self, channel: int) -> float:
        """Return how much of the time a channel is on, 0 to 1."""
        first = LED0_ON_L + 4 * channel
        steps = decode_steps(bytes(self.content[first : first + 4]))
        return 0.0 if self.asleep else steps / STEPS

    def pulse(self, channel: int) -> float:
        """Return how long a channel is on in each period, in seconds."""
        return self.duty(channel) / self.frequency

    def places(self, register: int, length: int) -> list[int]:
        """Return registers that follow one another, or one again and again."""
        if self.content[MODE1] & AUTO_INCREMENT:
            return super().places(register, length)
        return [register] * length

    def set(self, register: int, value: int) -> None:
        """Set one register, as far as the chip lets it be set."""
        if register == PRE_SCALE and not self.asleep:
            return  # it is locked while the chip runs
        if register == MODE1:
            self.stops += not self.asleep and bool(value & SLEEP)
            value &= ~_RESTART
        self.content[register] = value
        if _ALL_LED <= register < _ALL_LED + 4:
            for channel in range(16):
                self.content[LED0_ON_L + 4 * channel + register - _ALL_LED] = value
