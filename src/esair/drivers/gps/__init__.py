"""A GPS receiver that speaks NMEA 0183, on a serial line.

Source: NMEA 0183, sentences GGA (fix data) and RMC (recommended minimum data); they
are parsed by pynmeagps. Any receiver of GPS, Galileo, GLONASS or BeiDou sends them.

The bus cuts the bytes into sentences and checks them: ``framing="nmea"``. Most
receivers talk at 9600 bits per second, once a second::

    [bus.gps]
    type = "serial"
    port = "usb:1546:01a7"
    baudrate = 9600
    framing = "nmea"

    [sensor.position]
    driver = "gps"
    bus = "gps"
"""

from __future__ import annotations

import datetime
import math
from collections.abc import AsyncIterator, Sequence
from typing import Any, Unpack

import attrs

from esair.buses import SerialBus
from esair.drivers._on_bus import check_bus, heard
from esair.exceptions import ConfigError
from esair.framing import Looks, Sentences
from esair.loading import of_extra
from esair.resources import Sensor, SensorSettings

with of_extra("gps"):
    from pynmeagps import NMEAReader  # type: ignore[import-untyped]

__all__ = ["Fix", "FixBuilder", "Gps"]

KNOT = 1852 / 3600
"""In m/s."""

SENTENCES = ("GGA", "RMC")
"""The kinds of sentence that a fix is made of."""

FRAME = 6
"""The bytes of a sentence beside its body."""

PARSE_COST = 80.0
"""What the reading of a sentence costs, in looks at a place of a stream."""

APART = 3
"""After how many moments in a row that stayed incomplete each sentence is a fix."""


@attrs.frozen
class Fix:
    """Where the antenna is, by one moment's measurement.

    Attributes:
        latitude_deg: North positive, WGS 84.
        longitude_deg: East positive, WGS 84.
        altitude: Above mean sea level, in m; None if no GGA told it.
        speed: Over ground, in m/s; None if no RMC told it.
        course: Direction of travel in rad, clockwise from true north; None if no RMC
            told it, or while the antenna stands.
        quality: 1 satellites alone, 2 differential, 4 RTK fixed, 5 RTK float, 6 dead
            reckoning; None if no GGA told it.
        satellites: How many were used; None if no GGA told it.
        hdop: Horizontal dilution of precision; None if no GGA told it.
        time: When it was measured, by the receiver; without a date if no RMC told it.
    """

    latitude_deg: float
    longitude_deg: float
    altitude: float | None = None
    speed: float | None = None
    course: float | None = None
    quality: int | None = None
    satellites: int | None = None
    hdop: float | None = None
    time: datetime.datetime | datetime.time | None = None


class FixBuilder:
    """Puts the sentences of one moment together. No I/O.

    Some receivers never say both kinds of one moment. After three moments in a row that
    stayed incomplete each sentence is a fix by itself, until a moment is complete.

    Args:
        sentences: The kinds that have to come before a fix is whole.

    Attributes:
        bad_sentences: How many were no sentence of their kind.
        without_fix: How many moments the receiver knew no position.
    """

    def __init__(self, sentences: Sequence[str] = SENTENCES) -> None:
        self._wanted = frozenset(sentences)
        self._kinds = {kind.encode(): kind for kind in sentences}
        self._found: dict[str, bytes | None] = {}  # None knows no position
        self._moment: float | None = None  # as hhmmss.ss
        self._apart = 0
        self._looks = Looks()
        self._passed = self._unseen = 0  # in bytes, since a sentence was bad
        self.bad_sentences: int = 0
        self.without_fix: int = 0

    def feed(self, body: bytes) -> Fix | None:
        """Take a sentence, as it stands between ``$`` and ``*``.

        Returns:
            The fix that it completes; None if it completes none.
        """
        kind = self._kinds.get(body[2:5])
        if kind is None:
            return None
        self._passed = passed = self._passed + len(body) + FRAME
        if passed < self._unseen or len(fields := body.split(b",", 7)) < 8:
            self.bad_sentences += 1
            return None
        if not fields[1]:  # it does not know the time yet
            self.without_fix += 1
            return None
        told, none = (fields[6], b"0") if kind == "GGA" else (fields[2], b"V")
        try:
            moment = float(fields[1])
        except ValueError:
            self._count_bad(1)
            return None
        if moment != self._moment:
            self._apart += bool(self._found)
            self._moment = moment
            self._found.clear()
        self._found[kind] = body if told and told != none else None
        if len(self._found) < len(self._wanted) and self._apart < APART:
            return None
        if None in self._found.values():
            self._none()
            return None
        return self._read()

    def _read(self) -> Fix | None:
        """Return the fix of the sentences that are there; what is none is counted."""
        told = {}
        for kind, body in tuple(self._found.items()):
            assert body is not None
            try:
                message = NMEAReader.parse(b"$%b*00\r\n" % body, validate=0)
                if not isinstance(message.time, datetime.time):
                    raise ValueError("a time that is none")
                if kind == "GGA" and message.quality <= 0:
                    self._none()
                    return None
            except Exception:  # it parses what a stranger sends
                self._count_bad(len(self._found))
                del self._found[kind]
            else:
                told[kind] = message
        if not told or (len(told) < len(self._wanted) and self._apart < APART):
            return None
        self._begin_anew()
        fix = self._fix(told.get("GGA"), told.get("RMC"))
        if fix is None:
            self._count_bad(len(told))
        return fix

    def _none(self) -> None:
        self.without_fix += 1
        self._begin_anew()

    def _begin_anew(self) -> None:
        if len(self._found) == len(self._wanted):
            self._apart = 0
            self._found = {}
            self._moment = None

    def _count_bad(self, parsed: int) -> None:
        self.bad_sentences += 1
        self._looks.earn(self._passed)
        self._passed = 0
        self._unseen = self._looks.pay(PARSE_COST * parsed)

    def _fix(self, gga: Any, rmc: Any) -> Fix | None:
        place = gga or rmc
        try:
            fix = Fix(
                latitude_deg=_number(place.lat, -90.0, 90.0),
                longitude_deg=_number(place.lon, -180.0, 180.0),
                altitude=gga and _optional(gga.alt),
                speed=rmc and _optional(rmc.spd, KNOT),
                course=rmc and _optional(rmc.cog, math.radians(1.0)),
                quality=gga and int(gga.quality),
                satellites=gga and _count(gga.numSV),
                hdop=gga and _optional(gga.HDOP),
                time=datetime.datetime.combine(rmc.date, place.time, datetime.UTC)
                if rmc is not None and isinstance(rmc.date, datetime.date)
                else place.time,
            )
        except Exception:  # so do its fields
            return None
        return fix


def _number(value: Any, low: float, high: float) -> float:
    number = float(value)
    if not low <= number <= high:
        raise ValueError(f"expected {low} to {high}, not {number}")
    return number


def _count(value: Any) -> int | None:
    return None if value == "" else int(value)  # an empty field


def _optional(value: Any, unit: float = 1.0) -> float | None:
    if isinstance(value, int | float) and math.isfinite(value):
        return value * unit
    return None  # an empty field


class Gps(Sensor[Fix]):
    """A receiver that pushes where it is.

    It gives a value for each moment at which it knows its position; while it knows
    none, indoors say, the last one is current for a ``period`` of 2.5 s, no longer, and
    ``without_fix`` counts.

    Args:
        sentences: The kinds of sentence that a fix is made of, of GGA and RMC; one
            alone for a receiver that does not send the other.

    Attributes:
        builder: Puts sentences together, and counts those that were bad.
    """

    bus: SerialBus
    deadline: float = 2.5
    period: float | None = 2.5

    def __init__(
        self,
        *,
        sentences: tuple[str, ...] = SENTENCES,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        if not sentences or not set(sentences) <= set(SENTENCES):
            told = f"expected of GGA and RMC, not {sentences!r:.80}"
            raise ConfigError(self.name, "sentences", told)
        check_bus(self, SerialBus, Sentences)
        self.sentences: tuple[str, ...] = tuple(sentences)
        self.builder: FixBuilder = FixBuilder(self.sentences)

    def counts(self) -> dict[str, int]:
        """Return the sentences that were bad, and the moments without a position."""
        return {
            "bad_sentences": self.builder.bad_sentences,
            "without_fix": self.builder.without_fix,
        }

    async def open(self) -> None:
        """Wait until it says anything: then the port and the baud rate are right.

        Raises:
            DeviceLostError: It is silent, or nothing but noise comes.
        """
        what = "check the baud rate: no sentence came"
        with self.bus.frames() as sentences:
            await anext(heard(self, sentences, self.deadline, what=what))

    async def stream(self) -> AsyncIterator[Fix]:
        """Yield each fix as soon as it is whole.

        Raises:
            DeviceLostError: It falls silent; a receiver without a fix still speaks.
        """
        past, self.builder = self.builder, FixBuilder(self.sentences)
        self.builder.bad_sentences = past.bad_sentences
        self.builder.without_fix = past.without_fix
        with self.bus.frames(limit=256) as sentences:
            async for body in heard(self, sentences, self.deadline):
                fix = self.builder.feed(body)
                if fix is not None:
                    yield fix
