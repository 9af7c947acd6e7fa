"""The rover's devices, as the robot sees them: what is on its buses."""

from __future__ import annotations

import contextlib
import math
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from typing import ClassVar, TypeVar

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
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.framing import SentenceError, decode_sentence, encode_sentence
from esair.resources import Actuator, Sensor, setting

T = TypeVar("T")

IDENTITY_TIMEOUT = 0.5  # How long a part may take to say who it is, in seconds


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


class _SerialSensor:
    """What the parts on serial lines have in common."""

    name: str
    bus: object
    talker: ClassVar[str]
    model: ClassVar[str]
    bad_lines = 0  # How many sentences were damaged on their way

    async def open(self) -> None:
        """Make sure that it is this part and not something else."""
        fields = await self._ask(f"{self.talker}IAM", f"{self.talker}WHO")
        if fields[1:2] != [self.model]:
            told = f"expected a {self.model}, found {fields[1:]}"
            raise DeviceFaultError(self.name, told)

    @property
    def _line(self) -> SerialBus:
        if not isinstance(self.bus, SerialBus):
            raise ConfigError(
                self.name, "bus", f"expected a SerialBus, not {self.bus!r}"
            )
        return self.bus

    async def _ask(self, answer: str, *question: str | int) -> list[str]:
        inbox = self._line.frames(b"$" + answer.encode(), limit=4)
        try:
            await self._line.write(encode_sentence(*question))
            return decode_sentence(await inbox.take(timeout=IDENTITY_TIMEOUT))
        except SentenceError as error:
            raise DeviceFaultError(self.name, str(error)) from error
        except TimeoutError as error:
            raise DeviceLostError(self.name, f"no answer to {question[0]}") from error
        finally:
            inbox.close()

    async def _told(
        self, what: str, read: Callable[[list[str]], T]
    ) -> AsyncGenerator[T, None]:
        """Yield what each sentence says that arrives whole."""
        inbox = self._line.frames(f"${self.talker}{what}".encode(), limit=4)
        try:
            async for line in inbox:
                try:
                    value = read(decode_sentence(line))
                except ValueError:  # a SentenceError, or a field that is no number
                    self.bad_lines += 1
                else:
                    yield value
        finally:
            inbox.close()


class RangeFinder(_SerialSensor, Sensor[Scan]):
    """A range finder with a fan of beams, on a serial line."""

    talker, model = "RF", "fan41"
    rate = setting(10.0, unit="Hz", min=1.0, max=20.0, doc="how often it sweeps")

    async def apply(self, *, rate: float, **_: object) -> None:
        """Tell it how often to sweep."""
        hertz = round(rate)
        if await self._ask("RFACK", "RFRTE", hertz) != ["RFACK", "RTE", str(hertz)]:
            raise DeviceFaultError(self.name, f"it did not accept {hertz} Hz")

    async def stream(self) -> AsyncIterator[Scan]:
        """Yield every sweep that arrives whole."""
        async with contextlib.aclosing(self._told("SWP", _scan)) as scans:
            async for scan in scans:
                yield scan


def _scan(fields: list[str]) -> Scan:
    _, _, first, step, *distances = fields
    millimetres = [int(distance) for distance in distances]
    return Scan(
        math.radians(int(first) / 100),
        math.radians(int(step) / 100),
        tuple(value / 1000 if value > 0 else math.inf for value in millimetres),
    )


class Bumper(_SerialSensor, Sensor[Touch]):
    """A bumper with two switches, on a serial line."""

    talker, model = "BM", "skirt2"

    async def stream(self) -> AsyncIterator[Touch]:
        """Yield what it feels, at each touch and ten times a second."""
        async with contextlib.aclosing(self._told("STA", _touch)) as touches:
            async for touch in touches:
                yield touch


def _touch(fields: list[str]) -> Touch:
    _, _, left, right = fields
    return Touch(left == "1", right == "1")


def _drive(name: str, bus: object) -> CanBus:
    if not isinstance(bus, CanBus):
        raise ConfigError(name, "bus", f"expected a CanBus, not {bus!r}")
    return bus


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
    _sequence = 0

    async def write(self, command: Twist) -> Twist:
        """Tell both motors their speed; a stop takes their power away."""
        half = command.angular * self.wheel_base / 2
        left = (command.linear - half) / self.wheel_radius
        right = (command.linear + half) / self.wheel_radius
        scale = min(1.0, MAX_SPEED / max(abs(left), abs(right), MAX_SPEED))
        self._sequence += 1
        enable = command != self.safe
        bus = _drive(self.name, self.bus)
        for side, speed in ((LEFT, left * scale), (RIGHT, right * scale)):
            data = encode_command(side, WheelCommand(speed, enable, self._sequence))
            await bus.send(command_id(side), data, replaces=True)
        return Twist(command.linear * scale, command.angular * scale)


class Odometry(Sensor[Travel]):
    """How far the wheels have gone, from what the motor controllers tell.

    Attributes:
        wheel_radius: In metres.
        wheel_base: Between the wheels, in metres.
    """

    wheel_radius = Wheels.wheel_radius
    wheel_base = Wheels.wheel_base
    bad_frames = 0

    async def stream(self) -> AsyncIterator[Travel]:
        """Yield how far it is, each time both wheels have told."""
        bus = _drive(self.name, self.bus)
        sides = {feedback_id(side): side for side in (LEFT, RIGHT)}
        inbox = bus.frames(*sides, limit=32)
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
