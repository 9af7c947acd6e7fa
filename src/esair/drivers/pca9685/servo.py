"""Hobby servos on an NXP PCA9685, over I²C.

Source: PCA9685, 16-channel, 12-bit PWM Fm+ I2C-bus LED controller, NXP, revision 4;
the pulses of a servo are those of its own data sheet.
"""

from __future__ import annotations

import math
from typing import Unpack

import attrs

from esair.drivers._on_bus import applied, in_units
from esair.drivers.pca9685 import (
    STEPS,
    ChannelSettings,
    OnChannel,
    frequency_of,
    prescale,
)
from esair.exceptions import ConfigError
from esair.watchdog import SafeFrames

__all__ = ["PwmServo", "ServoPosition"]

WIDEST = 20 * math.pi
"""How far a servo may turn, in rad; whatever says more is in degrees."""


@attrs.frozen
class ServoPosition:
    """Where a servo is to be.

    Attributes:
        angle: In radians, counter-clockwise positive.
        on: Whether it gets pulses. Without them most servos let go.
    """

    angle: float
    on: bool = True


class PwmServo(OnChannel[ServoPosition]):
    """A hobby servo on one channel of a PCA9685.

    Its safe command is no pulses: it lets go, where it is. The servo goes on holding
    the last position when this computer dies.

    Args:
        min_angle: The angle of the shortest pulse, in radians.
        max_angle: The angle of the longest pulse, in radians; may be the smaller one
            for a servo that is mounted the other way.
        min_pulse: The shortest pulse, in seconds.
        max_pulse: The longest pulse, in seconds.
        **settings: ``channel`` and more, as of a `PwmChannel`; a ``frequency`` of 50 Hz is
            for analog servos.
    """

    def __init__(
        self,
        *,
        min_angle: float = -math.pi / 4,
        max_angle: float = math.pi / 4,
        min_pulse: float = 0.001,
        max_pulse: float = 0.002,
        **settings: Unpack[ChannelSettings],
    ) -> None:
        super().__init__(**settings)
        period = 1.0 / self.frequency
        if not 0.0 < min_pulse < max_pulse < period:
            raise ConfigError(
                self.name,
                "max_pulse",
                f"expected pulses of 0 s < min_pulse < max_pulse < {period:g} s, "
                f"not {min_pulse!r:.80} and {max_pulse!r:.80}",
            )
        if not 0.0 < abs(max_angle - min_angle) <= WIDEST:
            raise ConfigError(
                self.name,
                "max_angle",
                f"expected two different angles in rad, {WIDEST:.3g} apart at most, "
                f"not {min_angle!r:.80} and {max_angle!r:.80}",
            )
        self.min_angle = min_angle
        self.max_angle = max_angle
        self.min_pulse = min_pulse
        self.max_pulse = max_pulse
        self.safe: ServoPosition = ServoPosition((min_angle + max_angle) / 2, on=False)
        self.limits: dict[str, tuple[float, float]] = {
            "angle": (min(min_angle, max_angle), max(min_angle, max_angle))
        }

    def pulse(self, angle: float) -> float:
        """Return the length of the pulse for an angle, in seconds."""
        part = (angle - self.min_angle) / (self.max_angle - self.min_angle)
        return self.min_pulse + part * (self.max_pulse - self.min_pulse)

    def safe_frames(self) -> SafeFrames | None:
        """No pulses; None if the safe command is another one."""
        return self._off() if not self.safe.on else None

    async def write(self, command: ServoPosition) -> ServoPosition | None:
        """Send pulses for an angle, or none; returns the angle if no pulse is just it."""
        if not command.on:
            await self._be_on(0)
            return None
        step = 1.0 / frequency_of(prescale(self.frequency)) / STEPS
        ends = self.min_pulse, self.max_pulse
        steps = in_units(self.pulse(command.angle), step, ends)
        await self._be_on(steps)
        turn = (self.max_angle - self.min_angle) / (self.max_pulse - self.min_pulse)
        angle = self.min_angle + (steps * step - self.min_pulse) * turn
        sent = applied(command.angle, angle)
        return None if sent is None else ServoPosition(sent)
