"""The rover's devices, as the robot sees them: what is on its buses."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Sequence
from typing import Any, ClassVar

import attrs

from esair.buses import CanBus, SerialBus
from esair.demo._values import Scan, Touch, Twist
from esair.drivers.wheel_motor import (
    LEFT,
    MAX_SPEED,
    OWN_TIMEOUT,
    RIGHT,
    WheelCommand,
    command_id,
    decode_feedback,
    encode_command,
    feedback_id,
)
from esair.exceptions import DeviceFaultError
from esair.resources import Actuator, Resource, Sensor, setting


@attrs.frozen
class Travel:
    """How far the rover has gone since its motors got power, by its wheels.

    Attributes:
        distance: In metres, backward negative.
        turn: In rad, counter-clockwise.
        speed: In m/s.
        turn_rate: In rad/s.
        time: When the wheels said so, in seconds of the event loop's clock.
    """

    distance: float
    turn: float
    speed: float
    turn_rate: float
    time: float


class _Talker(Resource):
    """What the parts on serial lines have in common: they talk in sentences."""

    bus: SerialBus
    talker: ClassVar[str]
    model: ClassVar[str]
    tells: ClassVar[str]
    """Which of its sentences have a value."""

    bad_sentences = 0
    """How many of those had none."""

    async def open(self) -> None:
        """Make sure that it is this part and not something else."""
        fields = await self._ask("WHO", "IAM")
        if fields[:1] != [self.model]:
            told = f"expected a {self.model}, found {fields}"
            raise DeviceFaultError(self.name, told)

    async def _ask(self, question: str, answer: str) -> list[str]:
        prefix = f"{self.talker}{answer}".encode()
        told = await self.bus.ask(f"{self.talker}{question}".encode(), prefix=prefix)
        return told.decode().split(",")[1:]

    def value_of(self, fields: list[str]) -> Any:
        """Return what a sentence tells, after its number."""
        raise NotImplementedError

    async def stream(self) -> AsyncIterator[Any]:
        """Yield what it tells."""
        inbox = self.bus.frames(f"{self.talker}{self.tells},".encode(), limit=4)
        try:
            async for sentence in inbox:
                try:
                    value = self.value_of(sentence.decode().split(",")[2:])
                except ValueError:  # too few fields, or one that is no number
                    self.bad_sentences += 1
                else:
                    yield value
        finally:
            inbox.close()


class RangeFinder(_Talker, Sensor[Scan]):
    """A range finder with a fan of beams, on a serial line of sentences."""

    talker, model, tells = "RF", "fan41", "SWP"
    rate = setting(10.0, unit="Hz", min=1.0, max=20.0, doc="how often it sweeps")

    async def apply(self, *, rate: float, **_: object) -> None:
        """Tell it how often to sweep."""
        hertz = round(rate)
        if await self._ask(f"RTE,{hertz}", "ACK") != ["RTE", str(hertz)]:
            raise DeviceFaultError(self.name, f"it did not accept {hertz} Hz")

    def value_of(self, fields: list[str]) -> Scan:
        """Return a sweep: angles come in hundredths of a degree, distances in mm."""
        first, step, *distances = fields
        millimetres = map(int, distances)
        return Scan(
            math.radians(int(first) / 100),
            math.radians(int(step) / 100),
            tuple(value / 1000 if value > 0 else math.inf for value in millimetres),
        )


class Bumper(_Talker, Sensor[Touch]):
    """A bumper with two switches; it tells each touch, and ten times a second."""

    talker, model, tells = "BM", "skirt2", "STA"

    def value_of(self, fields: list[str]) -> Touch:
        """Return which of its switches is closed."""
        left, right = fields
        return Touch(left == "1", right == "1")


class Wheels(Actuator[Twist]):
    """Two driven wheels, each with a motor controller on the CAN bus.

    Attributes:
        wheel_radius: In metres.
        wheel_base: Between the wheels, in metres.
    """

    wheel_radius = 0.05
    wheel_base = 0.26
    safe = Twist(0.0, 0.0)
    command_timeout = 0.2
    limits = {"linear": (-0.6, 0.6), "angular": (-2.5, 2.5)}  # noqa: RUF012 - the base says so
    own_timeout = OWN_TIMEOUT
    bus: CanBus
    _sequence = 0

    async def write(self, command: Twist) -> Twist:
        """Tell both motors their speed; a stop takes their power away."""
        half = command.angular * self.wheel_base / 2
        left = (command.linear - half) / self.wheel_radius
        right = (command.linear + half) / self.wheel_radius
        scale = min(1.0, MAX_SPEED / max(abs(left), abs(right), MAX_SPEED))
        self._sequence += 1
        enable = command != self.safe
        for side, speed in ((LEFT, left * scale), (RIGHT, right * scale)):
            data = encode_command(side, WheelCommand(speed, enable, self._sequence))
            await self.bus.send(command_id(side), data, replaces=True)
        return Twist(command.linear * scale, command.angular * scale)


class Odometry(Sensor[Travel]):
    """How far the wheels have gone, from what the motor controllers tell.

    Attributes:
        wheel_radius: In metres.
        wheel_base: Between the wheels, in metres.
    """

    wheel_radius = Wheels.wheel_radius
    wheel_base = Wheels.wheel_base
    bus: CanBus
    bad_frames = 0

    async def stream(self) -> AsyncIterator[Travel]:
        """Yield how far it is, each time both wheels have told."""
        sides = {feedback_id(side): side for side in (LEFT, RIGHT)}
        inbox = self.bus.frames(*sides, limit=32)
        told: dict[int, tuple[float, float]] = {}
        try:
            async for frame in inbox:
                side = sides[frame.id]
                try:
                    feedback = decode_feedback(side, frame.data)
                except ValueError:
                    self.bad_frames += 1
                    continue
                told[side] = (
                    feedback.angle * self.wheel_radius,
                    feedback.speed * self.wheel_radius,
                )
                if len(told) == len(sides):
                    yield self._travel(told[LEFT], told[RIGHT], frame.time)
                    told.clear()
        finally:
            inbox.close()

    def _travel(
        self, left: Sequence[float], right: Sequence[float], time: float
    ) -> Travel:
        return Travel(
            distance=(left[0] + right[0]) / 2,
            turn=(right[0] - left[0]) / self.wheel_base,
            speed=(left[1] + right[1]) / 2,
            turn_rate=(right[1] - left[1]) / self.wheel_base,
            time=time,
        )
