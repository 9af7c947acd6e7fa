"""Parts on serial lines: a range finder and a bumper, that talk in sentences."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Protocol

from esair.framing import Sentences
from esair.sim._world import World

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
