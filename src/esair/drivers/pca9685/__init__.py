"""NXP PCA9685: sixteen outputs with a pulse width each, over I²C.

Source: PCA9685, 16-channel, 12-bit PWM Fm+ I2C-bus LED controller, NXP, revision 4.
Servos are in `esair.drivers.pca9685.servo`.
"""

from __future__ import annotations

import asyncio
import weakref
from typing import Any, ClassVar, Required, TypeVar, Unpack

import attrs

from esair.buses import RegisterLink
from esair.drivers._on_bus import in_units, shared
from esair.drivers._on_chip import OnChip
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.resources import Actuator, ActuatorSettings
from esair.values import check_whole
from esair.watchdog import SafeFrames

__all__ = ["PwmChannel"]

T = TypeVar("T")

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
    """What is known of a chip: the one frequency of its channels, and who uses which."""

    frequency: float
    channels: weakref.WeakValueDictionary[int, Actuator[Any]] = attrs.field(
        factory=weakref.WeakValueDictionary
    )


class ChannelSettings(ActuatorSettings, total=False):
    channel: Required[int]
    address: int
    frequency: float


class OnChannel(OnChip, Actuator[T]):
    """What all that is on a channel has in common."""

    addresses: ClassVar[range] = range(0x40, 0x78)  # what the pins A0 to A5 give

    def __init__(
        self,
        *,
        channel: int,
        address: int = 0x40,
        frequency: float = 50.0,
        **settings: Unpack[ActuatorSettings],
    ) -> None:
        super().__init__(address=address, **settings)
        self.channel: int = check_whole(self.name, "channel", channel, 0, 15)
        if not 24.0 <= frequency <= 1526.0:
            raise ConfigError(
                self.name, "frequency", f"expected 24 to 1526 Hz, not {frequency!r:.80}"
            )
        self.frequency: float = float(frequency)
        self.register: int = LED0_ON_L + 4 * channel
        self.claim: str = f"channel {channel} of the chip {address:#04x}"
        self._chip: Chip | None = None
        self._told = b""
        """What its registers were told last."""

    async def open(self) -> None:
        """Set the chip up unless it is, and turn the output off."""
        self._take_channel()
        with self._expected():
            found = await self.bus.transaction(
                self._wake, address=self.address, idempotent=True
            )
        if found != prescale(self.frequency):
            raise DeviceFaultError(
                self.name,
                f"PRE_SCALE is {found} instead of {prescale(self.frequency)}: "
                f"no PCA9685 at {self.address:#04x}",
            )
        await asyncio.sleep(SETTLING)

    async def close(self) -> None:
        """Leave the channel to others, as it is."""
        chip, self._chip = self._chip, None
        if chip is not None and chip.channels.get(self.channel) is self:
            del chip.channels[self.channel]

    async def is_set_up(self) -> bool:
        """Tell whether the chip has not restarted: asleep it takes commands.

        It may have been woken for another channel since; then this one is off.
        """

        def look(link: RegisterLink) -> bool:
            has = link.read_i2c_block_data(self.address, self.register, 4)
            return self._is_awake(link) and bytes(has) == self._told

        return await self.bus.transaction(look, address=self.address, idempotent=True)

    def _off(self) -> SafeFrames:
        data = bytes([self.register]) + encode_steps(0)
        return SafeFrames([data], address=self.address)

    async def _be_on(self, steps: int) -> None:
        """Be on for so many steps of a period, unless the chip has restarted: it sleeps."""

        def put(link: RegisterLink) -> bool:
            is_set_up = self._is_awake(link)
            if is_set_up:
                self._put_steps(link, steps)
            return is_set_up

        if not await self.bus.transaction(put, address=self.address, idempotent=True):
            raise DeviceLostError(self.name, "it has restarted: its set-up is gone")

    def _put_steps(self, link: RegisterLink, steps: int) -> None:
        self._told = encode_steps(steps)
        link.write_i2c_block_data(self.address, self.register, self._told)

    def _is_awake(self, link: RegisterLink) -> bool:
        mode = link.read_byte_data(self.address, MODE1)
        return bool(mode & AUTO_INCREMENT) and not mode & SLEEP

    def _take_channel(self) -> None:
        chips = shared(self.bus, Chip)
        chip = chips.get(self.address)
        others = {} if chip is None else dict(chip.channels)
        user = others.pop(self.channel, None)
        if user is not None and user is not self:
            raise ConfigError(
                self.name, "channel", f"{self.claim} is {user.name!r} already"
            )
        if chip is None or (not others and chip.frequency != self.frequency):
            chip = chips[self.address] = Chip(self.frequency)
        if chip.frequency != self.frequency:
            other = next(iter(others.values())).name
            raise ConfigError(
                self.name,
                "frequency",
                f"expected {chip.frequency:g} Hz as for {other!r}: "
                "a chip has one frequency for all its channels",
            )
        chip.channels[self.channel] = self
        self._chip = chip

    def _wake(self, link: RegisterLink) -> int:
        """Wake the chip and set its frequency, if nobody has; that stops all channels."""
        address, wanted = self.address, prescale(self.frequency)
        found = link.read_byte_data(address, PRE_SCALE)
        mode = link.read_byte_data(address, MODE2)  # inverted, what is off is on
        if not self._is_awake(link) or (found, mode) != (wanted, OUTDRV):
            link.write_byte_data(address, MODE1, AUTO_INCREMENT | SLEEP)
            link.write_byte_data(address, PRE_SCALE, wanted)
            link.write_byte_data(address, MODE2, OUTDRV)
            link.write_byte_data(address, MODE1, AUTO_INCREMENT)
            found = link.read_byte_data(address, PRE_SCALE)
        self._put_steps(link, 0)
        return found


class PwmChannel(OnChannel[float]):
    """One output of a PCA9685; its command is how much of the time it is on, 0 to 1.

    Several actuators may be on the channels of one chip; all have its frequency. The
    chip goes on with the last command when this computer dies: have the power of a
    motor cut by something else.

    Args:
        channel: 0 to 15.
        address: 0x40 to 0x77, by the chip's pins.
        frequency: How many periods a second, 24 to 1526 Hz.
    """

    safe: float = 0.0
    limits: tuple[float, float] = (0.0, 1.0)

    def safe_frames(self) -> SafeFrames | None:
        """No pulses; None if the safe command is another one."""
        return self._off() if self.safe == 0.0 else None

    async def write(self, command: float) -> float:
        """Be on for a part of each period; returns the part, in steps of 1/4096."""
        steps = in_units(command, 1 / STEPS, self.limits)
        await self._be_on(steps)
        return steps / STEPS
