"""The rover of `esair demo` on a Raspberry Pi Pico: what is on its pins.

Plain Python that runs on MicroPython and on CPython; the wiring is in
docs/how-to/from-std-to-min.md.
"""

# ruff: noqa: B905, PLC2701 - a board knows no strict=, and only this part of the demo

from esair.boards.digital import DigitalIn
from esair.boards.servo import PwmServo
from esair.boards.ultrasonic import UltrasonicRange
from esair.demo._values import Scan, Touch, Twist
from esair.minimal import Actuator, Sensor

TRACK = 0.16
"""From wheel to wheel, in metres."""

TOP_SPEED = 0.5
"""Of a wheel at full pulses, in m/s."""


class Ranges(Sensor):
    """Three ultrasonic range finders: right, ahead, left."""

    example = Scan(-0.6, 0.6, (1.0, 1.0, 1.0))  # for C, which asks how long a row is

    def __init__(
        self, triggers: "tuple[int, ...]", echoes: "tuple[int, ...]", angle: float = 0.6
    ) -> None:
        Sensor.__init__(self)
        self.angle = angle
        self.parts = [
            UltrasonicRange(trigger, echo, 2.0)
            for trigger, echo in zip(triggers, echoes)
        ]

    def open(self) -> None:
        for part in self.parts:
            part.open()

    def read(self) -> Scan:
        return Scan(-self.angle, self.angle, tuple([p.read() for p in self.parts]))


class Bumper(Sensor):
    """Two switches to ground."""

    example = Touch(False, False)

    def __init__(self, left: int, right: int) -> None:
        Sensor.__init__(self)
        self.left = DigitalIn(left, "up", True)
        self.right = DigitalIn(right, "up", True)

    def open(self) -> None:
        self.left.open()
        self.right.open()

    def read(self) -> Touch:
        return Touch(self.left.read(), self.right.read())


class Wheels(Actuator):
    """Two motor controllers that listen to servo pulses; 1.5 ms is stop."""

    safe = Twist(0.0, 0.0)

    def __init__(self, left: int, right: int) -> None:
        Actuator.__init__(self)
        self.left = PwmServo(left)
        self.right = PwmServo(right)

    def open(self) -> None:
        self.left.open()
        self.right.open()

    def close(self) -> None:
        self.left.close()
        self.right.close()

    def write(self, command: Twist) -> None:
        turn = command.angular * TRACK / 2
        self.left.write(_share(command.linear - turn))
        self.right.write(_share(command.linear + turn))


def _share(speed: float) -> float:
    return max(-1.0, min(1.0, speed / TOP_SPEED))
