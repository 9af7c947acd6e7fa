"""P24: an actuator of a peer on this machine, in a process of its own: a write and its answer."""

from __future__ import annotations

import asyncio
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

from tests.net.certificates import certify, tls
from tests.net.parts import free_port

import esair
from benchmarks.harness import Row, ms, percentile
from esair.buses.peer import Network, PeerBus
from esair.drivers.peer import Peer, PeerActuator
from esair.loop import TurnLoop
from esair.peers import Share, Sharing
from esair.testing import FakeActuator

COUNT = 400
PATIENCE = 30.0
"""How long the two may take to meet, in seconds."""

GOALS = {"tcp": 0.003, "tls": 0.006}


class Writing(esair.Behavior):
    """Writes, one after the other, and keeps how long each has taken."""

    wheels = esair.writes(float)

    def __init__(self) -> None:
        super().__init__()
        self.took: list[float] = []
        self.over = asyncio.Event()

    async def run(self) -> None:
        while len(self.took) < COUNT:
            begin = time.perf_counter()
            try:
                written = await self.wheels.write(0.5)
            except esair.EsairError:
                written = None  # not there yet
            if written:
                self.took.append(time.perf_counter() - begin)
            await asyncio.sleep(0.005)
        self.over.set()


def network(me: str, peer: str, endpoint: str, folder: str) -> Network:
    mine = tls(Path(folder), me) if endpoint.startswith("tls") else None
    listen, connect = ([endpoint], []) if me == "base" else ([], [endpoint])
    return Network(me=me, peers=[peer], listen=listen, connect=connect, tls=mine)


async def owner(endpoint: str, folder: str) -> None:
    """Have the wheels, until the other process ends this one."""
    bus = PeerBus(name="rover", network=network("base", "rover", endpoint, folder))
    robot = esair.Robot(
        name="base",
        resources=[FakeActuator("wheels", safe=0.0), Peer(name="rover", bus=bus)],
        behaviors=[Sharing(bus=bus, shares=[Share("wheels", "write")])],
    )
    async with robot:
        await asyncio.Event().wait()


async def rows() -> list[Row]:
    """Measure over TCP, and with certificates if openssl is there to make them."""
    try:
        import zenoh  # noqa: F401 - only whether it is there
    except ImportError:
        return [Row("P24", "", "", 0.0, None, note="eclipse-zenoh is not installed")]
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, goal in GOALS.items():
            if kind == "tls":
                if shutil.which("openssl") is None:
                    continue
                certify(Path(folder))
            took = await _measured(kind, folder)
            mine = statistics.median(took)
            note = f"99 %: {ms(percentile(took, 0.99))}"
            case = f"P24 a write to a peer and its answer, {kind}"
            found.append(Row(case, ms(mine), ms(goal), mine / goal, 1.0, note))
    return found


async def _measured(kind: str, folder: str) -> list[float]:
    endpoint = f"{kind}/127.0.0.1:{free_port()}"
    arguments = "-m", "benchmarks.cases.remote", endpoint, folder
    process = await asyncio.create_subprocess_exec(sys.executable, *arguments)
    writing = Writing()
    bus = PeerBus(name="base", network=network("rover", "base", endpoint, folder))
    wheels = PeerActuator(name="wheels", bus=bus, type=float)
    try:
        async with esair.Robot(
            name="rover",
            resources=[Peer(name="base", bus=bus), wheels],
            behaviors=[writing],
        ):
            async with asyncio.timeout(PATIENCE):
                await writing.over.wait()
    finally:
        process.kill()
        await process.wait()
    return writing.took


if __name__ == "__main__":
    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(owner(*sys.argv[1:]))
