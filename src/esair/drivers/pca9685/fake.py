"""A PCA9685, as its registers look from the bus."""

from __future__ import annotations

from types import MappingProxyType

from esair.buses.i2c import Registers
from esair.drivers import pca9685

_ALL_LED = 0xFA
_RESTART = 0x80
_POWER_UP = {
    pca9685.MODE1: 0x11,
    pca9685.MODE2: pca9685.OUTDRV,
    pca9685.PRE_SCALE: 0x1E,
}
_OFF = {pca9685.LED0_ON_L + 4 * channel + 3: pca9685.FULL for channel in range(16)}


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
        return bool(self.content[pca9685.MODE1] & pca9685.SLEEP)

    @property
    def frequency(self) -> float:
        """How many periods a second, in Hz."""
        return pca9685.frequency_of(self.content[pca9685.PRE_SCALE])

    def duty(self, channel: int) -> float:
        """Return how much of the time a channel is on, 0 to 1."""
        first = pca9685.LED0_ON_L + 4 * channel
        steps = pca9685.decode_steps(bytes(self.content[first : first + 4]))
        return 0.0 if self.asleep else steps / pca9685.STEPS

    def pulse(self, channel: int) -> float:
        """Return how long a channel is on in each period, in seconds."""
        return self.duty(channel) / self.frequency

    def places(self, register: int, length: int) -> list[int]:
        """Return registers that follow one another, or one again and again."""
        if self.content[pca9685.MODE1] & pca9685.AUTO_INCREMENT:
            return super().places(register, length)
        return [register] * length

    def set(self, register: int, value: int) -> None:
        """Set one register, as far as the chip lets it be set."""
        if register == pca9685.PRE_SCALE and not self.asleep:
            return  # it is locked while the chip runs
        if register == pca9685.MODE1:
            self.stops += not self.asleep and bool(value & pca9685.SLEEP)
            value &= ~_RESTART
        self.content[register] = value
        if _ALL_LED <= register < _ALL_LED + 4:
            for channel in range(16):
                self.content[pca9685.LED0_ON_L + 4 * channel + register - _ALL_LED] = (
                    value
                )
