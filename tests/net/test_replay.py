"""A robot with remote parts repeats without a network."""

from __future__ import annotations

import asyncio
import contextvars
from pathlib import Path
from typing import Any

import pytest
from tests.net.parts import Dock, Docked, Hand, Pair, Twist

import esair
from esair.buses.peer import PeerBus
from esair.replay import Replay

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("NET-2")]

TIMES = [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 21))]


class Following(Hand):
    """Drives by what it hears of the peer, and asks it."""

    async def run(self) -> None:
        for _ in range(12):
            try:
                far = await self.sonar.read(timeout=0.1)
                await self.wheels.write(Twist(0.1 * far, 0.0))
                docked = await self.ask("far_docking", Dock(2), progress=self.heard)
                await self.wheels.write(Twist(0.1, float(docked.bay)))
            except esair.EsairError:
                pass
            await asyncio.sleep(0.03)

    def heard(self, _: object) -> None:
        """Hear how far it is."""


class Outside(esair.Sensor[float]):
    """Where the other side is begun, in a run; a replay opens nothing."""

    def __init__(self, begin: Any = None) -> None:
        super().__init__()
        self.begin = begin

    async def open(self) -> None:
        if self.begin is not None:
            loop = asyncio.get_running_loop()
            self.task = asyncio.Task(
                self.begin(), loop=loop, context=contextvars.Context()
            )

    async def read(self) -> float:
        return 0.0


def equal(path: Path, robot: esair.Robot, least: int) -> None:
    """Repeat it; nothing else is there."""
    outcome = Replay(path).run(robot)
    assert outcome.divergence is None
    assert outcome.short == ""
    assert outcome.equal > least


@pytest.mark.long
@pytest.mark.parametrize("seed", TIMES)
def test_the_owner_repeats(tmp_path: Path, seed: int) -> None:
    """What a peer asked for comes from the recording, by the door."""
    pair, path = Pair(delay=0.002), tmp_path / "run.mcap"

    async def rover() -> None:
        bus = pair.to_base
        for kind in (Twist, Dock, Docked):
            bus.declare(kind)
        pair.docking.go.set()
        for _ in range(20):
            try:
                await bus.open()
                break
            except ConnectionError:
                await asyncio.sleep(0.01)
        inbox = bus.follow("sonar", 50.0)
        await asyncio.sleep(0.05)
        for number in range(8):
            command = Twist(0.1 * number, seed)
            told = await bus.request("write", "wheels", command)
            while "the newest beat" in str(told):  # it came late: the computer is busy
                told = await bus.request("write", "wheels", command)
            assert told[0] == "written", told
            assert (await bus.request("ask", "docking", Dock(2)))[0] == "answered"
            await asyncio.sleep(0.02)
        await bus.request("release", "wheels")
        inbox.close()
        pair.network.inject("rover", "base", "write", b"x" * 50)
        await bus.close()
        await asyncio.sleep(0.3)

    begun = Outside(rover)
    robot = pair.base(resources=[begun], record=esair.Recording(path))
    esair.run(robot, duration=2.4)  # long enough on a busy computer, too
    begun.task.result()
    again = Pair()
    again.docking.go.set()
    equal(path, again.base(resources=[Outside()]), 30)
    assert again.network.log == []
    assert again.wheels.commands == []


@pytest.mark.parametrize("seed", TIMES)
def test_the_user_repeats(tmp_path: Path, seed: int) -> None:
    """What its remote parts gave comes from the recording, as that of local ones does."""
    pair, path = Pair(delay=0.002), tmp_path / "run.mcap"

    async def base() -> None:
        bus: PeerBus = pair.to_rover

        def serve(what: str, _: float, body: bytes) -> None:
            parts = bus.parts(what, body) or ()
            if what == "follow":
                bus.say("reading", "sonar", 0.0, 0.5 + seed)
            elif what == "ask":
                bus.say("progress", parts[0], 0.5)
                bus.say("answer", parts[0], "answered", Docked(parts[2].bay))
            elif what in {"write", "release"}:
                bus.say("answer", parts[0], "written", None)

        bus.declare(Dock)
        bus.declare(Docked)
        bus.serve(serve)
        try:
            await bus.open()
        except ConnectionError:
            await bus.open()
        await asyncio.sleep(1.8)  # long enough on a busy computer, too
        await bus.close()
        await asyncio.sleep(0.2)

    begun = Outside(base)
    robot = pair.rover(Following(), resources=[begun], record=esair.Recording(path))
    esair.run(robot, duration=2.4)
    begun.task.result()
    again = Pair()
    equal(path, again.rover(Following(), resources=[Outside()]), 30)
    assert again.network.log == []
