"""A hobby servo, or a motor controller that listens to servo pulses, on a PWM pin."""

from esair.minimal import Actuator


class PwmServo(Actuator):
    """A servo that is told a position from -1.0 to 1.0.

    Args:
        pin: Its number, or whatever the board calls it.
        safe: The position when nobody says anything else.
        pulse_us: The pulses for -1.0 and 1.0, in microseconds.
        frequency: Pulses per second.
        name: The name of the actuator.
    """

    safe: float = 0.0
    limits = (-1.0, 1.0)

    def __init__(
        self,
        pin: "int | str",
        safe: float = 0.0,
        pulse_us: "tuple[float, float]" = (1000, 2000),
        frequency: int = 50,
        name: "str | None" = None,
    ) -> None:
        Actuator.__init__(self, name)
        if min(pulse_us) <= 0 or not 0 < max(pulse_us) * frequency < 1000000:
            raise ValueError("pulse_us: expected > 0, shorter than 1/frequency")
        self.pin = pin
        self.safe = float(safe)
        self.middle: float = (pulse_us[0] + pulse_us[1]) * 500
        self.reach: float = (pulse_us[1] - pulse_us[0]) * 500
        self.frequency = frequency

    def open(self) -> None:
        """Make the pulses, at the safe position from the first moment."""
        from machine import PWM, Pin

        # In one call: some boards begin with other pulses of their own.
        self._pwm = PWM(
            Pin(self.pin), freq=self.frequency, duty_ns=self._width(self.safe)
        )

    def close(self) -> None:
        """Make no more pulses."""
        self._pwm.deinit()

    def write(self, command: float) -> None:
        """Go to a position."""
        self._pwm.duty_ns(self._width(command))

    def _width(self, position: float) -> int:
        """Return the length of the pulses, in nanoseconds."""
        return int(self.middle + position * self.reach)
