"""A GPS receiver on a fake serial line, that says where it is."""

from __future__ import annotations

import datetime
import math

import attrs

from esair.buses.serial import FakeSerial
from esair.drivers.gps import KNOT, Fix
from esair.framing import encode_sentence

START = 20
"""How many moments a receiver takes to know where it is; in half of them it is silent."""


class FakeGps:
    """Says ``$GPGGA`` and ``$GPRMC`` again and again, as receivers do.

    Args:
        line: The line, with ``framing="nmea"``.
        fix: Where it is; its ``quality`` 0 is no fix.
        period: From one moment to the next, in seconds.

    Attributes:
        fix: What it says next; change it to move.
        moments: How often it has said where it is.
        silent: Whether it says nothing, as without power.
    """

    def __init__(
        self, line: FakeSerial, fix: Fix | None = None, *, period: float = 0.1
    ) -> None:
        self.fix: Fix = fix or Fix(48.1173, 11.516667, altitude=545.4, quality=1)
        self.moments: int = 0
        self.silent = False
        self._starting = 0
        self._start = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
        self._period = datetime.timedelta(seconds=period)
        line.repeat(self.next, period)

    def next(self) -> bytes:
        """Return the sentences of the next moment."""
        self._starting -= 1
        if self.silent or self._starting > START / 2:
            return b""
        moment = self._start + self.moments * self._period
        self.moments += 1
        quality = 0 if self._starting > 0 else self.fix.quality
        return encode_fix(attrs.evolve(self.fix, time=moment, quality=quality))

    def power_cycle(self) -> None:
        """Lose the power: it says nothing for a while, then that it has no fix yet."""
        self._starting = START


def encode_fix(fix: Fix) -> bytes:
    """Return a GGA and an RMC sentence, as a receiver sends them."""
    moment = fix.time
    assert isinstance(moment, datetime.datetime)
    time = f"{moment:%H%M%S}.{moment.microsecond // 10000:02d}"
    place: list[str] = ["", "", "", ""]
    if fix.quality != 0:
        place = [
            _angle(fix.latitude_deg, 2),
            "N" if fix.latitude_deg >= 0 else "S",
            _angle(fix.longitude_deg, 3),
            "E" if fix.longitude_deg >= 0 else "W",
        ]
    quality = 1 if fix.quality is None else fix.quality
    used = f"{fix.satellites or 0:02d}"
    hdop, altitude = _number(fix.hdop, 1), _number(fix.altitude, 1)
    speed = _number(None if fix.speed is None else fix.speed / KNOT, 3)
    course = _number(None if fix.course is None else math.degrees(fix.course), 2)
    date, status = f"{moment:%d%m%y}", "V" if quality == 0 else "A"
    gga = ["GPGGA", time, *place, quality, used, hdop, altitude, "M", "", "M", "", ""]
    rmc = ["GPRMC", time, status, *place, speed, course, date, "", ""]
    return encode_sentence(*map(str, gga)) + encode_sentence(*map(str, rmc))


def _angle(degrees: float, digits: int) -> str:
    minutes = round(abs(degrees) * 60, 5)
    whole = int(minutes // 60)
    return f"{whole:0{digits}d}{minutes - 60 * whole:08.5f}"


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
