"""DC motors behind an H-bridge: one, or the two of a robot with two wheels."""

from esair.minimal import Actuator

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


class _Bridge:
    """Two PWM pins: the one drives forwards, the other backwards."""

    def __init__(self, pins: "tuple[int | str, int | str]", frequency: int) -> None:
        from machine import PWM, Pin

        # At rest from the first moment.
        self._both: Any = [PWM(Pin(each), freq=frequency, duty_u16=0) for each in pins]

    def drive(self, speed: float) -> None:
        duty = int(min(1.0, abs(speed)) * 65535)
        forward, backward = self._both
        if speed < 0:
            forward, backward = backward, forward
        backward.duty_u16(0)  # first: never both at once
        forward.duty_u16(duty)

    def close(self) -> None:
        for each in self._both:
            each.duty_u16(0)
            each.deinit()


class HBridge(Actuator):
    """A motor that is told a share of its full speed, from -1.0 to 1.0.

    Args:
        forward: The pin that drives it forwards, such as IN1 of a DRV8833.
        backward: The pin that drives it backwards, such as IN2.
        frequency: Pulses per second.
        name: The name of the actuator.
    """

    safe: float = 0.0
    limits = (-1.0, 1.0)

    def __init__(
        self,
        forward: "int | str",
        backward: "int | str",
        frequency: int = 20000,
        name: "str | None" = None,
    ) -> None:
        Actuator.__init__(self, name)
        self.pins: tuple[int | str, int | str] = (forward, backward)
        self.frequency = frequency

    def open(self) -> None:
        """Take the pins; the motor rests."""
        self._bridge = _Bridge(self.pins, self.frequency)

    def close(self) -> None:
        """Let the motor rest, and make no more pulses."""
        self._bridge.close()

    def write(self, command: float) -> None:
        """Drive."""
        self._bridge.drive(command)


class TwoWheels(Actuator):
    """Two motors that are told their shares of the full speed: ``(left, right)``.

    More than the full speed, 1.0, is the full speed.

    Args:
        left: The pins that drive the left motor forwards and backwards.
        right: The same of the right one.
        frequency: Pulses per second.
        name: The name of the actuator.
    """

    safe: "tuple[float, float]" = (0.0, 0.0)

    def __init__(
        self,
        left: "tuple[int | str, int | str]",
        right: "tuple[int | str, int | str]",
        frequency: int = 20000,
        name: "str | None" = None,
    ) -> None:
        Actuator.__init__(self, name)
        if len(left) != 2 or len(right) != 2:
            raise ValueError("left, right: expected two pins each")
        self.left = left
        self.right = right
        self.frequency = frequency

    def open(self) -> None:
        """Take the pins; both motors rest."""
        self._left = _Bridge(self.left, self.frequency)
        self._right = _Bridge(self.right, self.frequency)

    def close(self) -> None:
        """Let both motors rest, and make no more pulses."""
        self._left.close()
        self._right.close()

    def write(self, command: "tuple[float, float]") -> None:
        """Drive both."""
        left, right = command
        self._left.drive(left)
        self._right.drive(right)
