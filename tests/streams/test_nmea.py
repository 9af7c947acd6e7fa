"""A log of a GPS receiver, at full speed through a pseudo-terminal, into a sensor.

``walk.nmea.gz`` is what the receiver of the test kit says on a walk of five minutes at
10 Hz, with no fix for 5 s, a flipped bit in 1 % of the moments, and bursts of noise.
"""

from __future__ import annotations

import asyncio
import gzip
import os
import pty
import tty
from pathlib import Path

import pytest

import esair
from esair.buses import SerialBus
from esair.drivers.gps import Fix, FixBuilder, Gps
from esair.framing import Sentences, encode_sentence

LOG = gzip.decompress(Path(__file__).with_name("walk.nmea.gz").read_bytes())

HELLO = encode_sentence("GPTXT", "hello")


def told() -> list[Fix]:
    """The fixes in the log, taken from it in one piece."""
    builder = FixBuilder()
    fixes = [builder.feed(body) for body in Sentences().feed(LOG)]
    return [fix for fix in fixes if fix is not None]


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.fault("D09", "D10")
async def test_a_log_at_full_speed() -> None:
    """Every sentence is a part of a fix, or is counted."""
    framing = Sentences()
    framing.feed(LOG)
    master, slave = pty.openpty()
    tty.setraw(slave)
    bus = SerialBus(name="gps", port=os.ttyname(slave), framing="nmea")
    gps = Gps(bus=bus)

    def play() -> None:
        begin = 0
        while begin < len(LOG):
            begin += os.write(master, LOG[begin : begin + 1000])

    greetings = 0

    async def greet() -> None:
        nonlocal greetings
        while True:  # what comes before somebody listens is thrown away
            if bus.is_open:
                greetings += os.write(master, HELLO)
            await asyncio.sleep(0.05)

    try:
        greeting = asyncio.create_task(greet())
        async with asyncio.timeout(60), esair.Robot(resources=[gps]) as robot:
            greeting.cancel()
            await asyncio.wait({greeting})
            playing = asyncio.create_task(asyncio.to_thread(play))
            right = await robot.resources.register("me", "gps", esair.Access.READ)
            await playing
            while bus.stats.received < len(LOG) + greetings:  # noqa: ASYNC110 - a thread sends
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.1)

            newest = await robot.sensors.read(right, max_age=60.0)
            count = robot.sensors.channel("gps").sequence
    finally:
        os.close(master)
        os.close(slave)

    fixes = told()
    assert len(fixes) > 2800
    assert newest.value == fixes[-1]
    assert framing.bad_frames > 20
    assert bus.stats.bad_frames == framing.bad_frames
    assert len(fixes) - bus.stats.dropped <= count <= len(fixes)
