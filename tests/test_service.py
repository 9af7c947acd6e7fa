"""What the service manager hears of a robot, and a robot that runs for a year."""

from __future__ import annotations

import asyncio
import errno
import random
import socket
import time
from pathlib import Path

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor, VirtualLoop

DAY = 2_400.0
"""How long a day of the year lasts, in seconds: its hours in which nothing happens are
left out."""


@pytest.mark.real_clock
@pytest.mark.promise("SUP-4")
async def test_the_service_manager_hears_of_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """READY when it is up, beats from its loop, STOPPING first of all."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as hears:
        hears.bind(str(tmp_path / "notify"))
        hears.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "2000000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        async with esair.Robot():
            await asyncio.sleep(1.4)
        heard = []
        while True:
            try:
                heard.append(hears.recv(64).decode())
            except BlockingIOError:
                break
    beats = [each for each in heard if each == "WATCHDOG=1"]
    assert [each for each in heard if each not in beats] == ["READY=1", "STOPPING=1"]
    assert len(beats) >= 2
    assert heard[-1] == "STOPPING=1"


class World:
    """A house whose network, disk and power are away at times."""

    def __init__(self, dice: random.Random, days: int, day: float) -> None:
        self.network = self._outages(dice, days, day, 1.0)
        self.disk = self._outages(dice, days, day, 1 / 14)
        cuts = max(200 * days // 365, 2)
        self.cuts = sorted(dice.uniform(0.0, days * day) for _ in range(cuts))

    @staticmethod
    def _outages(
        dice: random.Random, days: int, day: float, rate: float
    ) -> list[tuple[float, float]]:
        found = []
        for number in range(days):
            if dice.random() < rate:
                begin = number * day + dice.uniform(0.0, 600.0)
                found.append((begin, begin + dice.uniform(1.0, 1500.0)))
        return found

    def is_away(self, outages: list[tuple[float, float]], now: float) -> bool:
        return any(begin <= now < end for begin, end in outages)


class Report(esair.Behavior):
    """Sends the level to a server, each minute."""

    level = esair.reads(float)
    restart = esair.Restart(retry=240.0)

    def __init__(self, world: World, log: dict[str, float], start: float) -> None:
        super().__init__()
        self.world, self.log, self.start = world, log, start

    async def run(self) -> None:
        async for _ in esair.every(60.0):
            now = self.start + esair.now()
            if self.world.is_away(self.world.network, now):
                raise OSError(errno.ENETUNREACH, "Network is unreachable")
            self.log["report"] = now


class Keep(Report):
    """Writes it to a file, each minute."""

    async def run(self) -> None:
        async for _ in esair.every(60.0):
            now = self.start + esair.now()
            if self.world.is_away(self.world.disk, now):
                raise OSError(errno.ENOSPC, "No space left on device")
            self.log["keep"] = now


class Water(esair.Behavior):
    """Opens the valve for a minute each quarter of an hour, if it is dry."""

    level = esair.reads(float)
    valve = esair.writes(bool)
    essential = True

    def __init__(self, log: dict[str, float], start: float) -> None:
        super().__init__()
        self.log, self.start = log, start

    async def run(self) -> None:
        async for _ in esair.every(150.0):
            if await self.level.read() < 0.5:
                await self.valve.write(True)
                self.log["water"] = self.start + esair.now()


@pytest.mark.long
@pytest.mark.promise("SUP-4")
def test_in_a_year_nothing_stays_down_for_longer_than_five_minutes(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Daily outages of the network, full disks, 200 power cuts, a wall clock that jumps.

    After the end of its cause everybody works again within five minutes: looked at each
    minute. Two days in each run, the year with --esair-long.
    """
    soak = request.config.getoption("--esair-soak")
    days = 365 if soak else 60 if request.config.getoption("--esair-long") else 2
    dice = random.Random(days)
    world = World(dice, days, DAY)
    wall, steps = time.time, [0.0]
    monkeypatch.setattr(time, "time", lambda: wall() + steps[-1])
    log = dict.fromkeys(("report", "keep", "water"), 0.0)
    end, now, looks = days * DAY, 0.0, 0

    async def power_on(start: float, until: float) -> None:
        """Run until the power is cut; the service manager has started it anew."""
        nonlocal looks
        level = FakeSensor("level", 0.2, type=float, rate=0.02)
        valve = FakeActuator("valve", safe=False, command_timeout=90.0)
        behaviors = [
            Report(world, log, start),
            Keep(world, log, start),
            Water(log, start),
        ]
        async with esair.Robot(resources=[level, valve], behaviors=behaviors):
            while start + esair.now() < until:
                await asyncio.sleep(min(60.0, until - start - esair.now()))
                if dice.random() < 0.01:  # a cable is loose
                    level.unplug()
                    await asyncio.sleep(1.0)
                    level.plug()
                if dice.random() < 0.01:  # the clock of the wall is set
                    steps.append(dice.uniform(-4e8, 4e8))
                moment = start + esair.now()
                causes = {
                    "report": [e for b, e in world.network if b <= moment],
                    "keep": [e for b, e in world.disk if b <= moment],
                    "water": [],
                }
                for who, ends in causes.items():
                    over = max([start, *ends, log[who]])
                    assert moment - over <= 300.0, (who, moment / DAY, moment - over)
                    looks += 1

    for cut in [*(each for each in world.cuts if each < end), end]:
        with asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=1)) as runner:
            runner.run(power_on(now, cut))
        now = cut + 5.0
    assert looks > 2 * days * DAY / 60
