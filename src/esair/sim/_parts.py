"""The parts of the rover at their wires: inertial unit, motors, range finder, bumper."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Protocol

from esair.buses import Frame
from esair.drivers.mpu6050 import GRAVITY, Motion
from esair.drivers.mpu6050.fake import FakeMpu6050
from esair.drivers.wheel_motor import (
    OWN_TIMEOUT,
    WheelFeedback,
    command_id,
    decode_command,
    encode_feedback,
    feedback_id,
)
from esair.framing import Sentences
from esair.sim._world import World


class SimMpu6050(FakeMpu6050):
    """An MPU-6050 whose values have noise, and whose gyroscope has a bias.

    Its low-pass filter takes the mean of the last two steps of the world.
    """

    def __init__(self, world: World, *, seed: int = 0) -> None:
        super().__init__()
        self._world = world
        self._noise = random.Random(f"imu {seed}")
        self._bias = self._noise.gauss(0.0, 0.01)
        self._turn_rate = 0.0

    def step(self) -> None:
        """Measure, unless asleep."""
        if self.asleep:
            return
        ahead, left = self._world.acceleration
        before, self._turn_rate = self._turn_rate, self._world.turn_rate
        noise = self._noise.gauss
        self.motion = Motion(
            (
                ahead + noise(0.0, 0.05),
                left + noise(0.0, 0.05),
                GRAVITY + noise(0.0, 0.05),
            ),
            (
                noise(0.0, 0.004),
                noise(0.0, 0.004),
                (before + self._turn_rate) / 2 + self._bias + noise(0.0, 0.004),
            ),
            27.0,
        )


FEEDBACK_PERIOD = 0.02  # Between two feedback frames, in seconds


class SimMotor:
    """One motor controller. It trusts nobody: silence stops its wheel.

    Attributes:
        timeouts: How often it has stopped because no command came.
        bad_frames: How many command frames it could not read.
    """

    def __init__(self, world: World, side: int, send: Callable[[Frame], None]) -> None:
        self.timeouts: int = 0
        self.bad_frames: int = 0
        self._world = world
        self._side = side
        self._send = send
        self._heard: float | None = None
        self._enabled = False
        self._sequence = 0
        self._due = 0.0

    def receive(self, frame: Frame) -> None:
        """Take a frame from the bus; frames for others are left alone."""
        if frame.id != command_id(self._side) or frame.extended:
            return
        try:
            command = decode_command(self._side, frame.data)
        except ValueError:
            self.bad_frames += 1
            return
        self._heard = self._world.time
        self._enabled = command.enable
        self._world.target[self._side] = command.speed if command.enable else 0.0

    def step(self) -> None:
        """Do what is due at the world's time."""
        now = self._world.time
        timed_out = self._heard is not None and now - self._heard > OWN_TIMEOUT
        if timed_out and self._enabled:
            self._enabled = False
            self.timeouts += 1
            self._world.target[self._side] = 0.0
        if now + 1e-9 < self._due:
            return
        self._due = now + FEEDBACK_PERIOD
        self._sequence += 1
        feedback = WheelFeedback(
            self._world.wheel_angle[self._side],
            self._world.wheel_speed[self._side],
            self._enabled,
            timed_out,
            self._sequence,
        )
        self._send(
            Frame(feedback_id(self._side), encode_feedback(self._side, feedback))
        )


BEAMS = 41  # How many directions a sweep has
STEP_DEG = 6  # Between two beams, in degrees

FIRST_DEG = -STEP_DEG * (BEAMS - 1) // 2
"""The first beam, to the right, in degrees from straight ahead."""

REACH = 2.5  # How far the range finder sees, in metres


class Line(Protocol):
    """The part's end of a serial line."""

    heard: Callable[[bytes], None]

    def write(self, data: bytes) -> None:
        """Send bytes; what does not fit is lost, as on a wire."""


class _Part:
    """What takes sentences from a line, and counts what it could not read."""

    def __init__(self, world: World, line: Line) -> None:
        self._world = world
        self._line = line
        self._sentences = Sentences()
        self._refused = 0
        self._sequence = 0
        self._due = 0.0
        line.heard = self._hear

    @property
    def bad_sentences(self) -> int:
        """How many came damaged, or say nothing to it."""
        return self._sentences.bad_frames + self._refused

    def _hear(self, data: bytes) -> None:
        for payload in self._sentences.feed(data):
            self._obey(payload.decode("ascii").split(","))

    def _obey(self, fields: list[str]) -> None:
        raise NotImplementedError

    def _say(self, *fields: str | int) -> None:
        payload = ",".join(map(str, fields)).encode("ascii")
        self._line.write(self._sentences.encode(payload))

    def _next(self) -> int:
        self._sequence = (self._sequence + 1) % 1000
        return self._sequence


class SimRangeFinder(_Part):
    """Sweeps the space ahead and says ``$RFSWP`` with a distance for each beam.

    It answers ``$RFWHO`` with ``$RFIAM,fan41`` and ``$RFRTE,hertz`` (1 to 20) with
    ``$RFACK,RTE,hertz``. A sweep is sequence, first angle and step in hundredths of
    a degree, then a distance in millimetres for each beam, 0 if nothing is in reach.
    """

    def __init__(self, world: World, line: Line, *, seed: int = 0) -> None:
        super().__init__(world, line)
        self._period = 0.1
        self._noise = random.Random(f"range finder {seed}")

    def step(self) -> None:
        """Do what is due at the world's time."""
        if self._world.time + 1e-9 < self._due:
            return
        self._due = self._world.time + self._period
        ranges = [
            self._measure(math.radians(FIRST_DEG + beam * STEP_DEG))
            for beam in range(BEAMS)
        ]
        self._say("RFSWP", self._next(), FIRST_DEG * 100, STEP_DEG * 100, *ranges)

    def _measure(self, angle: float) -> int:
        distance = self._world.distance_ahead(angle, REACH)
        noise = self._noise.gauss(0.0, 0.006)
        if distance is None:
            return 0
        return max(1, round(1000 * (distance + noise * (1.0 + distance))))

    def _obey(self, fields: list[str]) -> None:
        match fields:
            case ["RFWHO"]:
                self._say("RFIAM", f"fan{BEAMS}", "1.0")
            case ["RFRTE", hertz] if hertz.isdecimal() and 1 <= int(hertz) <= 20:
                self._period = 1.0 / int(hertz)
                self._say("RFACK", "RTE", int(hertz))
            case _:
                self._refused += 1
                self._say("RFNAK", fields[0][:8])


class SimBumper(_Part):
    """Says ``$BMSTA,sequence,left,right`` at each touch, and ten times a second."""

    def __init__(self, world: World, line: Line) -> None:
        super().__init__(world, line)
        self._said: tuple[bool, bool] | None = None

    def step(self) -> None:
        """Do what is due at the world's time."""
        state = self._world.bumps
        if state == self._said and self._world.time + 1e-9 < self._due:
            return
        self._due = self._world.time + 0.1
        self._said = state
        self._say("BMSTA", self._next(), int(state[0]), int(state[1]))

    def _obey(self, fields: list[str]) -> None:
        if fields == ["BMWHO"]:
            self._say("BMIAM", "skirt2", "1.0")
        else:
            self._refused += 1
