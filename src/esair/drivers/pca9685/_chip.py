"""The PCA9685 itself: its registers, and what its sixteen channels share.

Source: PCA9685, 16-channel, 12-bit PWM Fm+ I2C-bus LED controller, NXP, revision 4.
"""

from __future__ import annotations

import asyncio
import weakref
from typing import Any

import attrs

from esair.buses import I2CBus, RegisterLink
from esair.drivers._on_i2c import check_address, expected_at, i2c_bus
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.resources import Actuator
from esair.watchdog import SafeFrames

ADDRESSES = range(0x40, 0x78)
"""What the pins A0 to A5 give, without what no chip may have."""

MODE1 = 0x00
MODE2 = 0x01
LED0_ON_L = 0x06
PRE_SCALE = 0xFE

SLEEP = 0x10
AUTO_INCREMENT = 0x20
OUTDRV = 0x04
"""``MODE2``: outputs are driven high and low, as after power-up."""

FULL = 0x10
"""In ``ON_H`` always on, in ``OFF_H`` always off; off wins."""

STEPS = 4096
"""Into how many steps a period is divided."""

OSCILLATOR = 25e6
"""The chip's own clock, in Hz; it may be wrong by a few percent."""

SETTLING = 0.0005
"""How long the oscillator takes to start, in seconds."""


def prescale(frequency: float) -> int:
    """Return the value of ``PRE_SCALE`` for a frequency in Hz."""
    return round(OSCILLATOR / (STEPS * frequency)) - 1


def frequency_of(value: int) -> float:
    """Return the frequency of a value of ``PRE_SCALE``, in Hz."""
    return OSCILLATOR / (STEPS * (value + 1))


def encode_steps(steps: int) -> bytes:
    """Return the four registers of a channel for so many steps of a period on."""
    if steps <= 0:
        return bytes([0, 0, 0, FULL])
    if steps >= STEPS:
        return bytes([0, FULL, 0, 0])
    return bytes([0, 0, steps & 0xFF, steps >> 8])


def decode_steps(registers: bytes) -> int:
    """Return how many steps of a period the four registers of a channel are on."""
    on_low, on_high, off_low, off_high = registers
    if off_high & FULL:
        return 0
    if on_high & FULL:
        return STEPS
    begin = (on_high & 0x0F) << 8 | on_low
    end = (off_high & 0x0F) << 8 | off_low
    return (end - begin) % STEPS


@attrs.define
class Chip:
    """What is known of a chip that several actuators use.

    Attributes:
        frequency: The one frequency of all its channels, in Hz.
        channels: Who uses which.
    """

    frequency: float
    channels: weakref.WeakValueDictionary[int, Actuator[Any]] = attrs.field(
        factory=weakref.WeakValueDictionary
    )


_chips: weakref.WeakKeyDictionary[I2CBus, dict[int, Chip]] = weakref.WeakKeyDictionary()


class Channel:
    """One channel of a chip, for one actuator.

    Args:
        owner: The actuator.
        address: 0x40 to 0x77.
        channel: 0 to 15.
        frequency: How many periods a second, 24 to 1526 Hz; of all channels.
    """

    def __init__(
        self, owner: Actuator[Any], address: int, channel: int, frequency: float
    ) -> None:
        self.owner = owner
        self.address = check_address(owner, address, ADDRESSES)
        if type(channel) is not int or not 0 <= channel <= 15:
            raise ConfigError(
                owner.name, "channel", f"expected 0 to 15, not {channel!r:.80}"
            )
        if not 24.0 <= frequency <= 1526.0:
            raise ConfigError(
                owner.name,
                "frequency",
                f"expected 24 to 1526 Hz, not {frequency!r:.80}",
            )
        self.number = channel
        self.frequency = float(frequency)
        self._chip: Chip | None = None

    @property
    def place(self) -> str:
        """The channel and its chip, in words."""
        return f"channel {self.number} of the chip {self.address:#04x}"

    @property
    def register(self) -> int:
        """The first of its four registers."""
        return LED0_ON_L + 4 * self.number

    async def open(self) -> None:
        """Set the chip up unless it is, and turn the channel off.

        Raises:
            ConfigError: Another actuator uses the channel, or another frequency.
        """
        bus = i2c_bus(self.owner)
        self._claim(bus)
        with expected_at(self.owner, self.address):
            found = await bus.transaction(
                self._set_up, address=self.address, idempotent=True
            )
        if found != prescale(self.frequency):
            raise DeviceFaultError(
                self.owner.name,
                f"PRE_SCALE is {found} instead of {prescale(self.frequency)}: "
                f"no PCA9685 at {self.address:#04x}",
            )
        await asyncio.sleep(SETTLING)

    def off(self) -> SafeFrames:
        """Return what turns the channel off, for the watchdog."""
        data = bytes([self.register]) + encode_steps(0)
        return SafeFrames([data], address=self.address)

    async def write(self, steps: int) -> None:
        """Be on for so many of the 4096 steps of a period, from its beginning.

        Raises:
            DeviceLostError: The chip has restarted: it sleeps, and nothing was written.
        """

        def put(link: RegisterLink) -> bool:
            is_set_up = self._is_awake(link)
            if is_set_up:
                link.write_i2c_block_data(
                    self.address, self.register, encode_steps(steps)
                )
            return is_set_up

        bus = i2c_bus(self.owner)
        if not await bus.transaction(put, address=self.address, idempotent=True):
            raise DeviceLostError(
                self.owner.name, "it has restarted: its set-up is gone"
            )

    async def is_set_up(self) -> bool:
        """Tell whether the chip is awake, with the frequency that it was given."""

        def look(link: RegisterLink) -> bool:
            found = link.read_byte_data(self.address, PRE_SCALE)
            return self._is_awake(link) and found == prescale(self.frequency)

        return await i2c_bus(self.owner).transaction(
            look, address=self.address, idempotent=True
        )

    def _is_awake(self, link: RegisterLink) -> bool:
        mode = link.read_byte_data(self.address, MODE1)
        return bool(mode & AUTO_INCREMENT) and not mode & SLEEP

    def close(self) -> None:
        """Leave the channel to others."""
        chip, self._chip = self._chip, None
        if chip is not None and chip.channels.get(self.number) is self.owner:
            del chip.channels[self.number]

    def _claim(self, bus: I2CBus) -> None:
        chips = _chips.setdefault(bus, {})
        chip = chips.get(self.address)
        others = {} if chip is None else dict(chip.channels)
        user = others.pop(self.number, None)
        if user is not None and user is not self.owner:
            raise ConfigError(
                self.owner.name,
                "channel",
                f"{self.place} is {user.name!r} already",
            )
        if chip is None or (not others and chip.frequency != self.frequency):
            chip = chips[self.address] = Chip(self.frequency)
        if chip.frequency != self.frequency:
            other = next(iter(others.values())).name
            raise ConfigError(
                self.owner.name,
                "frequency",
                f"expected {chip.frequency:g} Hz as for {other!r}: "
                "a chip has one frequency for all its channels",
            )
        chip.channels[self.number] = self.owner
        self._chip = chip

    def _set_up(self, link: RegisterLink) -> int:
        """Wake the chip and set its frequency, if nobody has; then be off.

        It can change its frequency only while it sleeps, which stops all channels.
        """
        address, wanted = self.address, prescale(self.frequency)
        found = link.read_byte_data(address, PRE_SCALE)
        if not self._is_awake(link) or found != wanted:
            link.write_byte_data(address, MODE1, AUTO_INCREMENT | SLEEP)
            link.write_byte_data(address, PRE_SCALE, wanted)
            link.write_byte_data(address, MODE2, OUTDRV)
            link.write_byte_data(address, MODE1, AUTO_INCREMENT)
            found = link.read_byte_data(address, PRE_SCALE)
        link.write_i2c_block_data(address, self.register, encode_steps(0))
        return found
