"""The laser range finder: packets, turns, and what it does when it is swapped."""

from __future__ import annotations

import asyncio
import math
import random
from typing import Any

import hypothesis
import pytest
from hypothesis import strategies as st
from tests.drivers.parts import Powered

import esair
from esair.drivers.rplidar import (
    GET_HEALTH,
    GET_INFO,
    HEALTH_DESCRIPTOR,
    INFO_DESCRIPTOR,
    LOOKS,
    SCAN,
    STOP,
    Health,
    Info,
    RpLidar,
    Scan,
    ScanDecoder,
    decode_health,
    decode_info,
    encode_health,
    encode_info,
    encode_scan,
    request,
)
from esair.drivers.rplidar.fake import FakeRpLidar
from esair.exceptions import DeviceFaultError
from esair.testing import FakeSerial, SensorContract

scans = st.lists(
    st.tuples(
        st.floats(-math.pi + 0.001, math.pi),
        st.floats(0.001, 16.0) | st.just(math.inf),
        st.integers(0, 63),
    ),
    min_size=1,
    max_size=40,
).map(lambda rows: Scan(*map(tuple, zip(*rows, strict=True))))


def make(**options: Any) -> tuple[RpLidar, FakeSerial, FakeRpLidar]:
    line = FakeSerial("lidar", framing="raw")
    part = FakeRpLidar(line)
    return RpLidar(bus=line, **options), line, part


class TestRpLidar(Powered, SensorContract):
    def make(self) -> RpLidar:
        lidar, _, self.far = make()
        return lidar

    keeps_nothing = "a lidar that does not scan is silent: it is lost, and told to scan"


@pytest.mark.real_clock
@pytest.mark.long
class TestRpLidarOnATerminal(TestRpLidar):
    """The same, through the kernel."""

    silent_for = 1.0


# The codec.


def test_a_measurement_as_the_document_shows_it() -> None:
    """Start bit, its inverse, check bit, angle in 1/64 degrees, distance in 1/4 mm."""
    decoder = ScanDecoder()
    first = bytes(
        [0x3E << 2 | 0b01, (90 * 64 << 1 | 1) & 0xFF, 90 * 64 >> 7, 0xA0, 0x0F]
    )
    second = bytes([0x3E << 2 | 0b10, (180 * 64 << 1 | 1) & 0xFF, 180 * 64 >> 7, 0, 0])

    (scan,) = decoder.feed(first + second + first)

    assert scan.angles == pytest.approx((-math.pi / 2, math.pi))
    assert scan.ranges == (1.0, math.inf)
    assert scan.qualities == (0x3E, 0x3E)


@hypothesis.given(scans)
def test_a_turn_goes_there_and_back(scan: Scan) -> None:
    """To 1/64 of a degree and a quarter of a millimetre."""
    wire = encode_scan(scan)

    (got,) = ScanDecoder().feed(wire + wire[:5])

    assert got.qualities == scan.qualities
    assert got.ranges == pytest.approx(scan.ranges, abs=0.0002)
    for told, angle in zip(got.angles, scan.angles, strict=True):
        off = (told - angle + math.pi) % math.tau - math.pi
        assert abs(off) <= math.radians(1 / 128) + 1e-9


@pytest.mark.fault("D08")
@hypothesis.given(scans, st.lists(st.integers(1, 30), max_size=20))
def test_pieces_make_no_difference(scan: Scan, sizes: list[int]) -> None:
    """The same turns come out, however the bytes are cut."""
    wire = encode_scan(scan) * 3
    whole = ScanDecoder().feed(wire)
    decoder = ScanDecoder()
    got: list[Scan] = []

    for size in sizes:
        got += decoder.feed(wire[:size])
        wire = wire[size:]
    got += decoder.feed(wire)

    assert got == whole


@pytest.mark.fault("D09", "D12")
@hypothesis.given(st.binary(max_size=400))
def test_after_garbage_whole_turns_come_again(garbage: bytes) -> None:
    """Nothing is raised, and the second turn after the noise is right."""
    scan = Scan((0.0, 1.0, 2.0), (1.0, 2.0, 3.0), (15, 15, 15))
    wire = encode_scan(scan)
    decoder = ScanDecoder()

    decoder.feed(garbage)
    got = decoder.feed(wire * 20)

    assert got[-1].ranges == pytest.approx(scan.ranges)
    assert got[-1].angles == pytest.approx(scan.angles, abs=0.001)


GARBAGE = [
    b"\x01",
    encode_scan(Scan((0.0,), (1.0,), (15,))),
    encode_scan(Scan((0.0, 1.0), (1.0, 1.0), (15, 15))),
    encode_scan(Scan((0.0,), (1.0,), (15,))) + b"\0",
    random.Random(7).randbytes(1 << 16),
]


@pytest.mark.fault("D11", "D12")
@pytest.mark.parametrize("garbage", GARBAGE, ids=lambda each: f"{each[:6]!r}")
def test_garbage_is_looked_at_in_few_places(garbage: bytes) -> None:
    """However it is made and cut; real turns after it are given again."""
    garbage = (garbage * ((1 << 18) // len(garbage)))[: 1 << 18]
    angles = tuple(-math.tau * n / 400 for n in range(400))
    wire = garbage + encode_scan(Scan(angles, (1.0,) * 400, (15,) * 400)) * 100
    results = []
    for size in (64, 1000, len(wire)):
        decoder = ScanDecoder()
        scans: list[Scan] = []
        for begin in range(0, len(wire), size):
            scans += decoder.feed(wire[begin : begin + size])
            if begin < len(garbage) <= begin + size:
                assert decoder.looks.count * LOOKS <= 2048 + len(wire) / 128
        assert scans[-1].ranges == (1.0,) * 400
        results.append((scans, decoder.discarded, decoder.bad_turns))
    assert all(each == results[0] for each in results)


@pytest.mark.fault("D11")
def test_a_turn_that_never_ends_takes_no_memory() -> None:
    """It is thrown away and counted."""
    decoder = ScanDecoder()
    scan = Scan((0.0, 1.0), (1.0, 1.0), (15, 15))
    begin, on = encode_scan(scan)[:5], encode_scan(scan)[5:]

    assert decoder.feed(begin + on * 100_000) == []

    assert decoder.bad_turns == 1
    assert len(decoder._turn) == 0
    assert len(decoder.feed((begin + on) * 2)) == 1


def test_info_and_health_go_there_and_back() -> None:
    """As the document lays them out."""
    info = Info(0x18, (1, 29), 7, "00112233445566778899AABBCCDDEEFF")
    assert decode_info(encode_info(info)) == info
    assert encode_info(info)[:4] == bytes([0x18, 29, 1, 7])
    health = Health("warning", 0x1234)
    assert decode_health(encode_health(health)) == health
    with pytest.raises(ValueError, match="status of 0 to 2"):
        decode_health(b"\x07\x00\x00")


# The sensor.


async def test_it_is_stopped_asked_and_started(fake_serial: Any) -> None:
    """In this order; and stopped again when it is closed."""
    lidar, line, part = make()
    await line.open()

    await lidar.open()
    values = lidar.stream()
    scan = await anext(values)
    await values.aclose()
    await lidar.close()
    await asyncio.sleep(0.01)

    assert part.requests == [STOP, GET_INFO, GET_HEALTH, SCAN, STOP]
    assert scan.nearest(-0.5, 0.5) == 1.0
    assert scan.nearest(9.0, 9.1) == math.inf
    assert lidar.info == part.info
    await line.close()


async def test_it_is_opened_in_the_middle_of_a_scan(fake_serial: Any) -> None:
    """A robot that was killed leaves it scanning."""
    lidar, line, part = make()
    part.scanning = True
    line.slow(20_000)
    await line.open()
    await asyncio.sleep(0.35)

    await lidar.open()
    values = lidar.stream()

    assert len((await anext(values)).angles) == 90
    await values.aclose()
    await line.close()


@pytest.mark.fault("D05")
@pytest.mark.promise("RES-2")
async def test_another_one_in_its_place_stays_lost(fake_serial: Any) -> None:
    """Its serial number is remembered; the right one comes back by itself."""
    lidar, line, part = make(name="lidar")
    right = part.info

    async with esair.Robot(resources=[lidar]) as robot:
        await asyncio.sleep(0.5)
        assert robot.resources.query("lidar").state is esair.ResourceState.READY
        line.unplug()
        part.info = Info(0x18, (1, 29), 7, "F" * 32)
        line.plug()
        await asyncio.sleep(5.0)
        assert robot.resources.query("lidar").state is not esair.ResourceState.READY
        part.info = right
        await asyncio.sleep(30.0)
        assert robot.resources.query("lidar").state is esair.ResourceState.READY


@pytest.mark.fault("D26")
@pytest.mark.parametrize(
    ("health", "told"),
    [
        (encode_health(Health("error", 0x8002)), "out of order, code 0x8002"),
        (b"\x07\x00\x00", "status of 0 to 2, not 7"),
        (None, "no answer to request 0x52, but 5 other bytes"),
    ],
)
async def test_one_that_is_ill_is_a_fault(
    fake_serial: Any, health: bytes | None, told: str
) -> None:
    """It says so, or it says nonsense, or nothing that is an answer."""
    lidar, line, part = make()
    answers = {
        request(GET_INFO): INFO_DESCRIPTOR + encode_info(part.info),
        request(GET_HEALTH): b"noise" if health is None else HEALTH_DESCRIPTOR + health,
    }
    line.on_write = lambda data: answers.get(data, b"")
    await line.open()

    with pytest.raises(DeviceFaultError, match=told):
        await lidar.open()

    await line.close()


@pytest.mark.fault("D09")
async def test_noise_costs_the_turn_that_it_touches(fake_serial: Any) -> None:
    """And is counted."""
    lidar, line, _ = make()
    await line.open()
    await lidar.open()
    values = lidar.stream()
    await anext(values)

    line.feed(b"\xff\xff\xff")
    scans = [await anext(values) for _ in range(3)]

    assert all(len(scan.angles) == 90 for scan in scans)
    assert lidar.decoder.discarded >= 3
    assert lidar.decoder.bad_turns == 1
    await values.aclose()
    await line.close()
