"""The host's end of the link to a board, on a fake line."""

from __future__ import annotations

import asyncio
import gc
import itertools
import struct
from collections.abc import Callable
from typing import Any

import pytest

import esair
from esair.boards.link import VERSION
from esair.buses.serial import FakeSerial
from esair.drivers.board import BoardActuator, BoardSensor
from esair.drivers.board.wire import Wire, signed, unstuffed
from esair.messages import ResourceState

pytestmark = pytest.mark.promise("MIN-4")


def beating(line: FakeSerial, *now_ms: int) -> FakeSerial:
    """Let a board beat on a line; its own time is this, and then goes on."""
    times = list(now_ms)

    def beat() -> bytes:
        now = times.pop(0)
        times[:] = times or [now + 100]
        whole = struct.pack("<BBBBHIIIIHH", ord("b"), VERSION, *[0] * 3, now, *[0] * 5)
        names = signed(b"n" + struct.pack("<II", 50_000, 0) + b"light;wheels")
        return line.framing.encode(signed(whole)) + line.framing.encode(names)

    def answer(data: bytes) -> None:
        for each in filter(None, data.split(b"\0")):
            said = unstuffed(each) or b""
            if said[:1] == b"w":
                line.say(signed(b"a" + said[1:2] + b"T"))

    line.on_write = answer
    line.repeat(beat, 0.1)
    return line


@pytest.mark.long
@pytest.mark.fault("D16")
async def test_a_line_that_stalls_while_a_beat_is_sent_leaves_no_error_behind(
    fake_serial: Callable[..., FakeSerial],
) -> None:
    """The devices tell their loss; nobody else hears of the beats' own task."""
    told: list[dict[str, Any]] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: told.append(context))
    line = beating(fake_serial("base", framing="cobs", write_timeout=0.05), 5)
    wheels = BoardActuator(name="wheels", bus=line, safe=0.0)
    light = BoardSensor(name="light", bus=line)

    async with esair.Robot(resources=[wheels, light]) as robot:
        for lost in (1, 2, 3):
            await asyncio.sleep(5.0)
            line.stall()
            await asyncio.sleep(3.0)
            line.resume()
            assert robot.resources.query("light").losses == lost
    gc.collect()

    assert told == []


@pytest.mark.promise("RES-4", "BUS-4")
@pytest.mark.parametrize("how", ["silent", "restarted"])
async def test_an_actuator_misses_its_board_though_nobody_writes(
    fake_serial: Callable[..., FakeSerial], how: str
) -> None:
    """It is asked each second whether its beats still come."""
    times = [*range(0, 2000, 100), 0] if how == "restarted" else [0]
    line = beating(fake_serial("base", framing="cobs"), *times)
    wheels = BoardActuator(name="wheels", bus=line, safe=0.0)

    async with esair.Robot(resources=[wheels]) as robot:
        await asyncio.sleep(1.0)
        assert robot.resources.query("wheels").state is ResourceState.READY
        if how == "silent":
            line.stall()
        await asyncio.sleep(4.0)
        assert robot.resources.query("wheels").losses == 1


async def test_what_the_board_has_not_is_told_for_a_sensor_as_for_an_actuator(
    fake_serial: Callable[..., FakeSerial],
) -> None:
    """It was built from an older file: nobody waits for a reading that never comes."""
    line = beating(fake_serial("base", framing="cobs"), 5)
    parts = [
        BoardSensor(name="battery", bus=line),
        BoardActuator(name="lamp", bus=line, safe=False),
        BoardSensor(name="light", bus=line),
    ]

    async with esair.Robot(resources=parts) as robot:
        await asyncio.sleep(1.0)
        for name, kind in (("battery", "sensor"), ("lamp", "actuator")):
            error = str(robot.resources.query(name).error)
            assert f"the board has no {kind} of this name: build and deploy" in error
        assert robot.resources.query("light").state is ResourceState.READY


@pytest.mark.promise("SEC-2")
@pytest.mark.parametrize(
    "payload",
    [
        b"n" + struct.pack("<II", 0, 0) + b"light;wheels",
        b"B\0[1e999]",
        b"B\0" + b"[" * 1018,
        b"B\0[]",
        b"s\0j\x01",
    ],
    ids=["no rate", "infinite version", "deep", "empty", "cut"],
)
def test_what_no_board_can_mean_is_no_message(payload: bytes) -> None:
    """Its checksum is right, and it says nothing; the line goes on."""
    board = Wire()
    whole = struct.pack("<BBBBHIIIIHH", ord("b"), VERSION, *[0] * 9)
    names = b"n" + struct.pack("<II", 50_000, 0) + b"light;wheels"
    assert board.said(whole)
    assert board.said(names) == []

    assert board.said(payload) == []
    assert board.named
    assert board.period == 0.02


async def test_what_the_line_has_kept_meanwhile_is_no_news(
    fake_serial: Callable[..., FakeSerial],
) -> None:
    """The computer stood still: old readings and beats come at once, and count as old."""
    line = fake_serial("base", framing="cobs")
    light = BoardSensor(name="light", bus=line, link_rate=100.0)
    seen: list[float] = []

    def say(*beats: int, reading: float) -> None:
        line.say(signed(b"n" + struct.pack("<II", 50_000, 0) + b"light;"))
        line.say(signed(struct.pack("<BBBf", ord("s"), 0, ord("f"), reading)))
        for each in beats:
            whole = struct.pack(
                "<BBBBHIIIIHH", ord("b"), VERSION, *[0] * 3, each, *[0] * 5
            )
            line.say(signed(whole))

    class Look(esair.Reaction):
        light = esair.reads(float)

        def react(self, light: float) -> None:
            seen.append(light)

    async with esair.Robot(resources=[light], behaviors=[Look()]):
        for now in range(0, 1000, 100):
            say(now, reading=1.0)
            await asyncio.sleep(0.1)
        await asyncio.sleep(0.39)
        say(950, reading=2.0)
        say(1000, reading=2.0)
        await asyncio.sleep(0.1)
        say(1600, reading=3.0)
        say(1700, reading=3.0)
        await asyncio.sleep(0.1)

    assert 2.0 not in seen
    assert seen[-1] == 3.0
    beats = [
        struct.unpack("<H", each[3:5])[0] * 16 for each in line.sent if each[:1] == b"h"
    ]
    assert 900 - 16 < max(each for each in beats if each < 1500) <= 900


async def test_a_board_that_says_only_what_is_old_is_lost_and_comes_back(
    fake_serial: Callable[..., FakeSerial],
) -> None:
    """Its clock runs at a third: what it says gets older without an end."""
    line = fake_serial("base", framing="cobs")
    light = BoardSensor(name="light", bus=line)
    times = itertools.count(0, 100)
    seen: list[float] = []

    def say() -> bytes:
        now = next(times)
        said = (
            b"n" + struct.pack("<II", 50_000, 0) + b"light;",
            struct.pack("<BBBBHIIIIHH", ord("b"), VERSION, *[0] * 3, now, *[0] * 5),
            struct.pack("<BBBf", ord("s"), 0, ord("f"), now / 1000),
        )
        return b"".join(line.framing.encode(signed(each)) for each in said)

    class Look(esair.Reaction):
        light = esair.reads(float)

        def react(self, light: float) -> None:
            seen.append(light)

    line.repeat(say, 0.3)
    async with esair.Robot(resources=[light], behaviors=[Look()]) as robot:
        await asyncio.sleep(20.0)
        assert robot.resources.query("light").losses > 1
    assert seen[-1] > 5.0
