"""How often readings are said: they leave the way to beats and commands."""

from __future__ import annotations

import asyncio
import random

import pytest
from tests.net.parts import STILL, Pair, Twist
from tests.net.test_gaps import Driving, listen

import esair
from esair.drivers.peer import Peer, PeerActuator, PeerSensor
from esair.peers import Share
from esair.testing import FakeSensor

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("NET-3", "NET-2")
async def test_readings_leave_a_slow_way_to_commands() -> None:
    """Of more than it carries the newest are said: nothing is lost, and all is of now."""
    pair, driving = Pair(delay=0.005), Driving()
    pair.network.rate, bus = 20_000.0, pair.to_base
    pair.sonar = FakeSensor("sonar", "x" * 1000, rate=100.0)
    robot = esair.Robot(
        name="rover",
        resources=[
            Peer(name="base", bus=bus),
            PeerSensor(name="far_sonar", remote="sonar", bus=bus, link_rate=100.0),
            PeerActuator(name="far_wheels", remote="wheels", bus=bus, type=Twist),
        ],
        behaviors=[driving],
    )
    async with pair.base() as base, robot:
        await asyncio.sleep(0.5)
        sent = listen(base)
        await asyncio.sleep(5.0)
        told = [command for _, command in sent]
        assert STILL not in told
        assert len(told) > 40
        newest = robot.sensors.channels["far_sonar"].newest
        assert asyncio.get_running_loop().time() - newest.time < 0.5
        assert robot.resources.query("far_sonar").losses == 0


@pytest.mark.promise("NET-2")
@pytest.mark.parametrize("seed", range(4))
async def test_a_way_that_becomes_slower_is_no_way_full_of_readings(seed: int) -> None:
    """On a good way that is a bad one later, never the same, they come as often."""
    pair, chance = Pair(delay=0.005), random.Random(seed)
    pair.sonar = FakeSensor("sonar", 1.0, rate=20.0)
    async with pair.both():
        await asyncio.sleep(1.0)
        said, moments = pair.to_rover.told_at, set()
        for _ in range(500):
            pair.network.delay = chance.uniform(0.02, 0.08)
            await asyncio.sleep(0.02)
            moments.add(said["sonar"])
        assert len(moments) > 150


@pytest.mark.promise("NET-2")
@pytest.mark.parametrize("seed", range(4))
async def test_many_small_readings_are_of_now_where_some_packets_are_lost(
    seed: int,
) -> None:
    """As by radio: TCP sends again what is lost, and the way has room for much more."""
    pair, loop = Pair(delay=0.005, loss=0.01, seed=seed), asyncio.get_running_loop()
    names = [f"sonar_{number}" for number in range(10)]
    pair.shares = [Share(name, "read") for name in names]
    far = [PeerSensor(name=name, bus=pair.to_base, type=float) for name in names]
    rover = esair.Robot(
        name="rover", resources=[Peer(name="base", bus=pair.to_base), *far]
    )
    near = [FakeSensor(name, 1.0, rate=20.0) for name in names]
    async with pair.base(resources=near), rover:
        await asyncio.sleep(2.0)
        ages = []
        for _ in range(200):
            await asyncio.sleep(0.0501)
            channels = rover.sensors.channels
            ages += [loop.time() - channels[each].newest.time for each in names]
    ages.sort()
    assert ages[len(ages) // 2] < 0.15
    assert ages[len(ages) * 9 // 10] < 0.4
