"""A PCA9685, as its registers look from the bus."""

from __future__ import annotations

from esair.drivers.pca9685._chip import (
    AUTO_INCREMENT,
    FULL,
    LED0_ON_L,
    MODE1,
    PRE_SCALE,
    SLEEP,
    STEPS,
    decode_steps,
    frequency_of,
)

_ALL_LED = 0xFA
_RESTART = 0x80
_POWER_UP = {MODE1: 0x11, 0x01: 0x04, PRE_SCALE: 0x1E}


class FakePca9685:
    """The register map: asleep and all channels off after power-up.

    Attributes:
        stops: How often all channels were stopped, for a frequency can be set only
            while the chip sleeps.
    """

    keeps_pointer = True

    def __init__(self) -> None:
        self._registers = bytearray(256)
        self.stops = 0
        self.power_cycle()

    def power_cycle(self) -> None:
        """Lose the power for a moment: everything is forgotten."""
        self._registers[:] = bytes(256)
        for register, value in _POWER_UP.items():
            self._registers[register] = value
        for channel in range(16):
            self._registers[LED0_ON_L + 4 * channel + 3] = FULL

    @property
    def asleep(self) -> bool:
        """Whether the oscillator is off, and every channel with it."""
        return bool(self._registers[MODE1] & SLEEP)

    @property
    def frequency(self) -> float:
        """How many periods a second, in Hz."""
        return frequency_of(self._registers[PRE_SCALE])

    def duty(self, channel: int) -> float:
        """Return how much of the time a channel is on, 0 to 1."""
        first = LED0_ON_L + 4 * channel
        steps = decode_steps(bytes(self._registers[first : first + 4]))
        return 0.0 if self.asleep else steps / STEPS

    def pulse(self, channel: int) -> float:
        """Return how long a channel is on in each period, in seconds."""
        return self.duty(channel) / self.frequency

    def read(self, register: int, length: int) -> bytes:
        """Return registers."""
        return bytes(self._registers[each] for each in self._walk(register, length))

    def write(self, register: int, data: bytes) -> None:
        """Set registers."""
        for number, value in zip(self._walk(register, len(data)), data, strict=True):
            self._set(number, value)

    def _set(self, number: int, value: int) -> None:
        if number == PRE_SCALE and not self.asleep:
            return  # it is locked while the chip runs
        if number == MODE1:
            self.stops += not self.asleep and bool(value & SLEEP)
            value &= ~_RESTART
        self._registers[number] = value
        if _ALL_LED <= number < _ALL_LED + 4:
            for channel in range(16):
                self._registers[LED0_ON_L + 4 * channel + number - _ALL_LED] = value

    def _walk(self, register: int, length: int) -> list[int]:
        step = 1 if self._registers[MODE1] & AUTO_INCREMENT else 0
        return [(register + step * index) % 256 for index in range(length)]
