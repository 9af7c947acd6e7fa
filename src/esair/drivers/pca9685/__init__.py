"""NXP PCA9685: sixteen outputs with a pulse width each, over I²C.

Source: PCA9685, 16-channel, 12-bit PWM Fm+ I2C-bus LED controller, NXP, revision 4.
Servos are in `esair.drivers.pca9685.servo`.
"""

from __future__ import annotations

from typing import Any

from esair.buses import I2CBus
from esair.drivers.pca9685._chip import STEPS, Channel
from esair.resources import Actuator
from esair.watchdog import SafeFrames

__all__ = ["PwmChannel"]


class PwmChannel(Actuator[float]):
    """One output of a PCA9685; its command is how much of the time it is on, 0 to 1.

    Several actuators may be on the channels of one chip; all have its frequency. The
    chip goes on with the last command when this computer dies: have the power of a
    motor cut by something else.

    Args:
        channel: 0 to 15.
        address: 0x40 to 0x77, by the chip's pins.
        frequency: How many periods a second, 24 to 1526 Hz.
    """

    bus: I2CBus
    safe = 0.0
    limits = (0.0, 1.0)

    def __init__(
        self,
        *,
        channel: int,
        address: int = 0x40,
        frequency: float = 50.0,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.channel = Channel(self, address, channel, frequency)
        self.claim = self.channel.place

    def safe_frames(self) -> SafeFrames | None:
        """No pulses; None if the safe command is another one."""
        return self.channel.off() if self.safe == 0.0 else None

    async def open(self) -> None:
        """Set the chip up unless it is, and turn the output off."""
        await self.channel.open()

    async def is_set_up(self) -> bool:
        """Tell whether the chip is awake, with its frequency: asleep it takes commands."""
        return await self.channel.is_set_up()

    async def close(self) -> None:
        """Leave the output to others, as it is."""
        self.channel.close()

    async def write(self, command: float) -> float:
        """Be on for a part of each period; returns the part, in steps of 1/4096."""
        steps = round(command * STEPS)
        await self.channel.write(steps)
        return steps / STEPS
