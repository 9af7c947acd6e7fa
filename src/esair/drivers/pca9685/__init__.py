"""NXP PCA9685: sixteen outputs with a pulse width each, over I²C.

Source: PCA9685, 16-channel, 12-bit PWM Fm+ I2C-bus LED controller, NXP, revision 4.
Servos are in `esair.drivers.pca9685.servo`.
"""

from __future__ import annotations

from esair.drivers.pca9685._chip import STEPS, OnChannel
from esair.watchdog import SafeFrames

__all__ = ["PwmChannel"]


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
        steps = round(command * STEPS)
        await self._be_on(steps)
        return steps / STEPS
