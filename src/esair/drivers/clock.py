"""The clock on the wall as a sensor: what a plan of the day reads, and a recording keeps.

The robot's own time (`esair.now`) never jumps and knows no day. A plan of the day reads this
sensor: a test then sets the hour, and a replay has that of then::

    [sensor.clock]
    driver = "esair.drivers.clock:Clock"
    not_before = "2026-01-01"

A computer without a battery for its clock wakes up in another year. Until somebody has set it,
which is when it is later than ``not_before``, the sensor is lost, and nobody acts on a wrong day.
"""

from __future__ import annotations

import datetime
import time
from typing import Unpack

import attrs

from esair.exceptions import ConfigError, DeviceLostError
from esair.loop import now
from esair.resources import Sensor, SensorSettings

__all__ = ["Clock", "FakeClock", "WallTime"]

DAY = 86_400


@attrs.frozen
class WallTime:
    """A moment as people say it.

    Attributes:
        unix: Seconds since 1970, UTC.
        offset: How far the time here is before UTC, in seconds: 3600 in Berlin's winter.
    """

    unix: float
    offset: float = 0.0

    @property
    def hours(self) -> float:
        """Hours since midnight here: 13.5 is half past one."""
        return (self.unix + self.offset) % DAY / 3600

    @property
    def weekday(self) -> int:
        """The day of the week here: 1 is Monday, 7 is Sunday."""
        return int((self.unix + self.offset) // DAY + 3) % 7 + 1

    @property
    def date(self) -> str:
        """The day here: ``2026-03-29``."""
        return str(self)[:10]

    def __str__(self) -> str:
        moment = datetime.datetime.fromtimestamp(self.unix + self.offset, datetime.UTC)
        return moment.strftime("%Y-%m-%d %H:%M:%S")

    @classmethod
    def of(cls, text: str, offset: float = 0.0) -> WallTime:
        """Return a moment by what is said here: ``2026-03-29``, ``2026-03-29 06:30:00``.

        Raises:
            ConfigError: It is none.
        """
        try:
            here = datetime.datetime.fromisoformat(text)
            unix = here.replace(tzinfo=datetime.UTC).timestamp() - offset
        except (TypeError, ValueError):
            told = f"expected a moment such as '2026-03-29 06:30', not {text!r:.80}"
            raise ConfigError("clock", "", told) from None
        return cls(unix, offset)


class Clock(Sensor[WallTime]):
    """The time of this computer, in its time zone.

    Args:
        not_before: The day before which this computer's clock is not set yet.
        **settings: Those of any sensor.
    """

    rate: float = 1.0
    blocking = False

    def __init__(
        self,
        *,
        not_before: str = "2025-01-01",
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        self.not_before = not_before
        self._least = WallTime.of(not_before).unix

    def open(self) -> None:
        """Find the clock set.

        Raises:
            DeviceLostError: It is not, or no more.
        """
        self.read()

    def read(self) -> WallTime:
        """Return the moment."""
        moment = self._now()
        if moment.unix < self._least:
            told = f"it says {moment}, it is not set: it is after {self.not_before}"
            raise DeviceLostError(self.name, told)
        return moment

    def _now(self) -> WallTime:
        unix = time.time()
        return WallTime(unix, float(time.localtime(unix).tm_gmtoff))


class FakeClock(Clock):
    """A clock for tests: it says what it was set to, and goes with the robot's time.

    Args:
        moment: What it says at first, such as ``2026-03-29 06:59:50``.
        offset: How far that is before UTC, in seconds.
        not_before: As of `Clock`.
        **settings: Those of any sensor.
    """

    def __init__(
        self,
        moment: str,
        offset: float = 0.0,
        /,
        *,
        not_before: str = "2025-01-01",
        **settings: Unpack[SensorSettings],
    ) -> None:
        settings.setdefault("name", "clock")
        super().__init__(not_before=not_before, **settings)
        self._at: float | None = None
        self.set(moment, offset)

    def set(self, moment: str, offset: float = 0.0) -> None:
        """Set it: forth, back, to summer time, or to a year in which nobody set it."""
        self._moment = WallTime.of(moment, offset)
        self._at = None

    def _now(self) -> WallTime:
        at = now()
        if self._at is None:
            self._at = at
        return attrs.evolve(self._moment, unix=self._moment.unix + at - self._at)
