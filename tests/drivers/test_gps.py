"""The GPS receiver: sentences, fixes, and a recorded log at full speed."""

from __future__ import annotations

import asyncio
import datetime
import math
from types import SimpleNamespace
from typing import Any

import attrs
import hypothesis
import pytest
from hypothesis import strategies as st
from pynmeagps import NMEAReader  # type: ignore[import-untyped]
from tests.drivers.parts import Powered

import esair
from esair.drivers import gps
from esair.drivers.gps import PARSE_COST, Fix, FixBuilder, Gps
from esair.drivers.gps.fake import FakeGps, encode_fix
from esair.exceptions import DeviceLostError, StaleReadingError
from esair.framing import Sentences
from esair.testing import FakeSerial, SensorContract

GGA = b"GPGGA,123519.50,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
RMC = b"GPRMC,123519.50,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W"
MOMENT = datetime.datetime(2026, 1, 1, 12, 0, tzinfo=datetime.UTC)

EPOCH = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)

fixes = st.builds(
    Fix,
    latitude_deg=st.floats(-90, 90),
    longitude_deg=st.floats(-180, 180),
    altitude=st.none() | st.floats(-400, 9000),
    speed=st.none() | st.floats(0, 300),
    course=st.none() | st.floats(0, 6.28),
    quality=st.integers(1, 6),
    satellites=st.integers(0, 40),
    hdop=st.none() | st.floats(0.5, 50),
    time=st.integers(0, 200_000_000_000).map(
        lambda moment: EPOCH + datetime.timedelta(seconds=moment / 100)
    ),
)


def make(**options: Any) -> tuple[Gps, FakeSerial, FakeGps]:
    line = FakeSerial("gps", framing="nmea")
    part = FakeGps(line)
    return Gps(bus=line, **options), line, part


class TestGps(Powered, SensorContract):
    def make(self) -> Gps:
        device, _, self.far = make()
        return device

    keeps_nothing = "it is told nothing"


@pytest.mark.real_clock
@pytest.mark.long
class TestGpsOnATerminal(TestGps):
    """The same, through the kernel."""

    silent_for = 1.0


# The codec.


def test_two_sentences_of_one_moment_are_a_fix() -> None:
    """Degrees, metres, metres per second, radians, and a time with a date."""
    builder = FixBuilder()

    assert builder.feed(GGA) is None
    fix = builder.feed(RMC)

    assert fix is not None
    assert fix.latitude_deg == pytest.approx(48.1173)
    assert fix.longitude_deg == pytest.approx(11.516667)
    assert fix.altitude == 545.4
    assert fix.speed == pytest.approx(22.4 * 0.514444, rel=1e-5)
    assert fix.course == pytest.approx(math.radians(84.4))
    assert (fix.quality, fix.satellites, fix.hdop) == (1, 8, 0.9)
    assert fix.time == datetime.datetime(
        1994, 3, 23, 12, 35, 19, 500000, tzinfo=datetime.UTC
    )


@pytest.mark.parametrize(("kind", "body"), [("GGA", GGA), ("RMC", RMC)])
def test_one_kind_may_be_enough(kind: str, body: bytes) -> None:
    """What the other one would have told is not made up."""
    fix = FixBuilder([kind]).feed(body)

    assert fix is not None
    assert fix.latitude_deg == pytest.approx(48.1173)
    assert (fix.altitude is None) == (kind == "RMC")
    assert (fix.speed is None) == (kind == "GGA")


def test_a_field_may_be_empty() -> None:
    """A receiver that does not count its satellites knows where it is all the same."""
    fix = FixBuilder(["GGA"]).feed(GGA.replace(b",1,08,", b",1,,"))

    assert fix is not None
    assert fix.satellites is None


def test_sentences_of_different_moments_are_fixes_each() -> None:
    """Of a receiver that never says both of one moment; nothing is mixed, or made up."""
    builder = FixBuilder()
    fixes = []
    for second in range(20, 40):
        at = b"1235%d.50" % second
        fixes.append(builder.feed(GGA.replace(b"123519.50", at)))
        other = b"1235%d.00" % second
        fixes.append(builder.feed(RMC.replace(b"123519.50", other)))

    got = [fix for fix in fixes if fix is not None]
    assert len(got) == 37
    assert {(fix.altitude is None, fix.speed is None) for fix in got} == {
        (True, False), (False, True),
    }  # fmt: skip
    assert builder.feed(GGA) is not None
    whole = builder.feed(RMC)
    assert whole is not None
    assert None not in {whole.altitude, whole.speed}
    assert builder.feed(GGA.replace(b"123519.50", b"123520.50")) is None


def test_moments_are_not_mixed() -> None:
    """A sentence that was lost costs its own moment only."""
    builder = FixBuilder()
    later = GGA.replace(b"123519.50", b"123520.50")

    assert builder.feed(GGA) is None
    assert builder.feed(later) is None
    assert builder.feed(RMC) is None
    assert builder.feed(GGA) is not None


@pytest.mark.parametrize(
    "bodies",
    [
        (GGA.replace(b"E,1,08", b"E,0,00"), RMC),
        (GGA, RMC.replace(b",A,", b",V,")),
        (b"GPGGA,,,,,,0,00,99.99,,,,,,",),
    ],
)
def test_without_a_position_there_is_no_fix(bodies: tuple[bytes, ...]) -> None:
    """It is counted, and the next fix comes."""
    builder = FixBuilder()

    assert [builder.feed(body) for body in bodies][-1] is None

    assert builder.without_fix == 1
    assert builder.feed(GGA) is None
    assert builder.feed(RMC) is not None


@pytest.mark.fault("D26")
@pytest.mark.parametrize(
    "body",
    [
        GGA.replace(b"4807.038", b"9907.038"),
        GGA.replace(b"4807.038", b"north"),
        GGA.replace(b"4807.038", b""),
        GGA.replace(b"123519.50", b"993519.50"),
        GGA.replace(b",1,08", b",x,08"),
        b"GPGGA,123519.50",
        b"GPGGA",
    ],
)
def test_a_sentence_that_is_none_is_counted(body: bytes) -> None:
    """Its checksum may be right and its contents wrong."""
    builder = FixBuilder(["GGA"])

    assert builder.feed(body) is None

    assert builder.bad_sentences + builder.without_fix == 1
    assert builder.feed(GGA) is not None


@hypothesis.given(fixes)
def test_a_fix_goes_there_and_back(fix: Fix) -> None:
    """Through the sentences that a receiver sends, to their last digit."""
    builder = FixBuilder()
    got = [builder.feed(body) for body in Sentences().feed(encode_fix(fix))][-1]

    assert got is not None
    assert got.time == fix.time
    assert got.quality == fix.quality
    assert got.latitude_deg == pytest.approx(fix.latitude_deg, abs=1e-6)
    assert got.longitude_deg == pytest.approx(fix.longitude_deg, abs=1e-6)
    for told, wanted, digits in (
        (got.altitude, fix.altitude, 0.05),
        (got.speed, fix.speed, 0.001),
        (got.course, fix.course, 0.0001),
        (got.hdop, fix.hdop, 0.05),
    ):
        assert (told is None) == (wanted is None)
        assert told is None or told == pytest.approx(wanted, abs=digits * 1.01)


@pytest.mark.fault("D12", "D26")
@hypothesis.given(
    st.sampled_from([GGA, RMC]), st.integers(0, 70), st.binary(min_size=1, max_size=3)
)
def test_any_body_is_a_fix_or_none(body: bytes, place: int, damage: bytes) -> None:
    """Nothing is raised, and no number is beyond what is possible."""
    builder = FixBuilder([body[2:5].decode()])

    fix = builder.feed(body[:place] + damage + body[place + len(damage) :])

    if fix is not None:
        assert -90 <= fix.latitude_deg <= 90
        assert -180 <= fix.longitude_deg <= 180


# The sensor.


async def test_what_other_sentences_say_is_ignored(fake_serial: Any) -> None:
    """Receivers say much more than where they are."""
    gps, line, _ = make()
    await line.open()
    values = gps.stream()
    waiting = asyncio.ensure_future(anext(values))
    await asyncio.sleep(0.05)

    for body in (b"GPGSV,1,1,00", b"GPGSA,A,1,,,", b"PUBX,00", b"X"):
        line.say(body)

    assert isinstance(await waiting, Fix)
    assert gps.builder.bad_sentences == 0
    await values.aclose()
    await line.close()


@pytest.mark.fault("D14")
async def test_indoors_there_is_no_fresh_reading(fake_serial: Any) -> None:
    """A receiver that talks but knows nothing never gives an old position."""
    gps, _, part = make(name="position")
    part.fix = attrs.evolve(part.fix, quality=0)

    class Look(esair.Behavior):
        position = esair.reads(Fix, max_age=1.0)

        async def run(self) -> None:
            with pytest.raises(StaleReadingError):
                await self.position.read(timeout=3.0)
            part.fix = attrs.evolve(part.fix, quality=1)
            self.offer(await self.position.read(timeout=3.0))
            await asyncio.Event().wait()

    async with esair.Robot(resources=[gps], behaviors=[Look()]) as robot:
        fix = await robot.behaviors.get(sender="look", receiver="user", interval=9.0)

    assert isinstance(fix, Fix)
    assert gps.builder.without_fix > 10


@pytest.mark.fault("D14")
async def test_a_silent_line_is_a_loss_at_the_opening(fake_serial: Any) -> None:
    """The error says what to look at."""
    line = fake_serial("gps", framing="nmea")
    gps = Gps(bus=line)
    await line.open()

    with pytest.raises(DeviceLostError, match="check the baud rate"):
        await gps.open()

    await line.close()


@pytest.mark.real_clock
@pytest.mark.fault("D08", "D13")
@pytest.mark.long
async def test_a_recorded_log_at_full_speed_through_a_terminal() -> None:
    """Ten minutes at 10 Hz in a moment; what is not given was counted as dropped."""
    line = FakeSerial("gps", framing="nmea")
    gps = Gps(bus=line)
    await line.open()
    moments = 6000
    log = b"".join(
        encode_fix(
            Fix(
                48.0 + number * 1e-5,
                11.5,
                altitude=500.0,
                quality=1,
                time=MOMENT + number * datetime.timedelta(seconds=0.1),
            )
        )
        for number in range(moments)
    )
    got: list[Fix] = []

    async def follow() -> None:
        async for fix in gps.stream():
            got.append(fix)
            if fix.latitude_deg > 48.0 + (moments - 1.5) * 1e-5:
                return

    following = asyncio.create_task(follow())
    await asyncio.sleep(0)
    for begin in range(0, len(log), 1021):  # as much as a terminal takes at once
        before = line.stats.received
        piece = log[begin : begin + 1021]
        line.feed(piece)
        async with asyncio.timeout(10):
            while line.stats.received < before + len(piece):  # noqa: ASYNC110
                await asyncio.sleep(0)
    async with asyncio.timeout(30):
        await following

    assert line.stats.received == len(log)
    assert line.stats.bad_frames == line.lost_bytes == 0
    assert len(got) * 2 + line.stats.dropped == 2 * moments
    latitudes = [fix.latitude_deg for fix in got]
    assert latitudes == sorted(latitudes)
    await line.close()


@pytest.mark.fault("D11", "D12")
@pytest.mark.parametrize(
    "sentences",
    [
        [b"GPRMC,%06d,A,,,,,,,,,", b"GPGGA,%06d,,,,,1,,,,,,,,"],
        [b"GPRMC,%06d,A,x,x,x,x,x,x,x,x,x", b"GPGGA,%06d,x,x,x,x,1,,,,,,,,"],
        [b"GPRMC,%06d,A,9999.0,N,01131.000,E,,,230394,,"],
    ],
)
def test_fixes_that_are_none_are_read_seldom(
    sentences: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Right sentences without a place are garbage: most are left out unseen."""
    count = 0

    def parse(message: bytes, **keywords: Any) -> Any:
        nonlocal count
        count += 1
        return NMEAReader.parse(message, **keywords)

    monkeypatch.setattr(gps, "NMEAReader", SimpleNamespace(parse=parse))
    builder = FixBuilder()
    size = 0
    for second in range(3000):
        for sentence in sentences:
            body = sentence % (second % 60)
            size += len(body) + 6
            assert builder.feed(body) is None
    assert count * PARSE_COST <= 2048 + size / 128 + 2 * PARSE_COST
    good = (
        b"GPGGA,%06d,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,",
        b"GPRMC,%06d,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W",
    )
    fixes = [builder.feed(each % (n % 60)) for n in range(400) for each in good]
    assert fixes[-1] is not None


@pytest.mark.virtual_clock
@pytest.mark.promise("SC-3")
async def test_without_a_fix_the_last_one_is_soon_not_current() -> None:
    """The receiver speaks all the time, and knows no position any more."""
    device, _, part = make(name="gps")
    user = esair.Behavior(name="user", reads={"gps": esair.reads(Fix)}, writes={})
    async with esair.Robot(resources=[device], behaviors=[user]) as robot:
        await asyncio.sleep(3.0)
        assert await user.gps.read()
        part.fix = attrs.evolve(part.fix, quality=0)
        await asyncio.sleep(4.0)
        with pytest.raises(StaleReadingError):
            await user.gps.read()
        assert robot.resources.query("gps").losses == 0
