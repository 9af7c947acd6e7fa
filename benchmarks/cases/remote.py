"""P24: an actuator of a peer on this machine, in a process of its own: a write and its answer."""

from __future__ import annotations

import asyncio
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import esair
from benchmarks.harness import Row, ms, percentile
from esair.buses.peer import Network, PeerBus, Tls
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
    tls = None
    if endpoint.startswith("tls"):
        there = Path(folder)
        tls = Tls(there / "ca.pem", there / f"{me}.pem", there / f"{me}.key")
    listen, connect = ([endpoint], []) if me == "owner" else ([], [endpoint])
    return Network(me=me, peers=[peer], listen=listen, connect=connect, tls=tls)


async def owner(endpoint: str, folder: str) -> None:
    """Have the wheels, until the other process ends this one."""
    bus = PeerBus(name="user", network=network("owner", "user", endpoint, folder))
    robot = esair.Robot(
        name="owner",
        resources=[FakeActuator("wheels", safe=0.0), Peer(name="user", bus=bus)],
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
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"{kind}/127.0.0.1:{probe.getsockname()[1]}"
    arguments = "-m", "benchmarks.cases.remote", endpoint, folder
    process = await asyncio.create_subprocess_exec(sys.executable, *arguments)
    writing = Writing()
    bus = PeerBus(name="owner", network=network("user", "owner", endpoint, folder))
    wheels = PeerActuator(name="wheels", bus=bus, type=float)
    try:
        async with esair.Robot(
            name="user",
            resources=[Peer(name="owner", bus=bus), wheels],
            behaviors=[writing],
        ):
            async with asyncio.timeout(PATIENCE):
                await writing.over.wait()
    finally:
        process.kill()
        await process.wait()
    return writing.took


def certify(folder: Path) -> None:
    """Make an authority, and a certificate of it for each of the two."""

    def openssl(*arguments: str) -> None:
        subprocess.run(
            ["openssl", *arguments], cwd=folder, check=True, capture_output=True
        )

    curve = "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"
    signed = "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-extfile", "names"
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1\n")
    openssl(
        "req", "-x509", *curve, "-subj", "/CN=ca", "-keyout", "ca.key", "-out", "ca.pem"
    )
    for name in ("owner", "user"):
        files = "-keyout", f"{name}.key", "-out", f"{name}.csr"
        openssl("req", *curve, "-subj", f"/CN={name}", *files)
        openssl("x509", "-req", "-in", f"{name}.csr", *signed, "-out", f"{name}.pem")


if __name__ == "__main__":
    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(owner(*sys.argv[1:]))
