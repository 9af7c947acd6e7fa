"""The rover's devices, as the robot sees them: what is on its buses."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Sequence

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
            fields = decode_sentence(await inbox.take(timeout=IDENTITY_TIMEOUT))
        except SentenceError as error:
            raise DeviceFaultError(self.name, str(error)) from error
        except TimeoutError as error:
            raise DeviceLostError(self.name, f"no answer to {question[0]}") from error
        finally:
            inbox.close()
        return fields


class RangeFinder(_SerialSensor, Sensor[Scan]):
    """A range finder with a fan of beams, on a serial line.

    Attributes:
        bad_lines: How many sweeps were damaged on their way.
    """

    rate = setting(10.0, unit="Hz", min=1.0, max=20.0, doc="how often it sweeps")

    def __init__(self, **options: object) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self.bad_lines = 0

    async def open(self) -> None:
        """Make sure that it is a range finder and not something else."""
        fields = await self._ask("RFIAM", "RFWHO")
        if fields[1:2] != ["fan41"]:
            raise DeviceFaultError(self.name, f"expected a fan41, found {fields[1:]}")

    async def apply(self, *, rate: float, **_: object) -> None:
        """Tell it how often to sweep."""
        hertz = round(rate)
        if await self._ask("RFACK", "RFRTE", hertz) != ["RFACK", "RTE", str(hertz)]:
            raise DeviceFaultError(self.name, f"it did not accept {hertz} Hz")

    async def stream(self) -> AsyncIterator[Scan]:
        """Yield every sweep that arrives whole."""
        inbox = self._line.frames(b"$RFSWP", limit=4)
        try:
            async for line in inbox:
                scan = _scan(line)
                if scan is None:
                    self.bad_lines += 1
                else:
                    yield scan
        finally:
            inbox.close()


def _scan(line: bytes) -> Scan | None:
    try:
        _, _, first, step, *distances = decode_sentence(line)
        millimetres = [int(distance) for distance in distances]
        return Scan(
            math.radians(int(first) / 100),
            math.radians(int(step) / 100),
            tuple(value / 1000 if value > 0 else math.inf for value in millimetres),
        )
    except ValueError:  # a SentenceError, or a field that is no number
        return None


class Bumper(_SerialSensor, Sensor[Touch]):
    """A bumper with two switches, on a serial line."""

    def __init__(self, **options: object) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self.bad_lines = 0

    async def open(self) -> None:
        """Make sure that it is a bumper and not something else."""
        fields = await self._ask("BMIAM", "BMWHO")
        if fields[1:2] != ["skirt2"]:
            raise DeviceFaultError(self.name, f"expected a skirt2, found {fields[1:]}")

    async def stream(self) -> AsyncIterator[Touch]:
        """Yield what it feels, at each touch and ten times a second."""
        inbox = self._line.frames(b"$BMSTA", limit=4)
        try:
            async for line in inbox:
                try:
                    _, _, left, right = decode_sentence(line)
                except ValueError:
                    self.bad_lines += 1
                else:
                    yield Touch(left == "1", right == "1")
        finally:
            inbox.close()


def _drive(name: str, bus: object) -> CanBus:
    if not isinstance(bus, CanBus):
        raise ConfigError(name, "bus", f"expected a CanBus, not {bus!r}")
    return bus


class Wheels(Actuator[Twist]):
    """Two driven wheels, each with a motor controller on the CAN bus.

    Args:
        wheel_radius: In metres.
        wheel_base: Between the wheels, in metres.
    """

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2
    limits = {"linear": (-0.6, 0.6), "angular": (-2.5, 2.5)}  # noqa: RUF012 - the base says so
    own_timeout = OWN_TIMEOUT

    def __init__(
        self, *, wheel_radius: float = 0.05, wheel_base: float = 0.26, **options: object
    ) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self.wheel_radius = wheel_radius
        self.wheel_base = wheel_base
        self._sequence = 0

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

    Args:
        wheel_radius: In metres.
        wheel_base: Between the wheels, in metres.
    """

    def __init__(
        self, *, wheel_radius: float = 0.05, wheel_base: float = 0.26, **options: object
    ) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self.wheel_radius = wheel_radius
        self.wheel_base = wheel_base
        self.bad_frames = 0

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
