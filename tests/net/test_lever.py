"""A program in C uses a robot: the messages are what their page says, and no more."""

from __future__ import annotations

import asyncio
import os
import shutil
from pathlib import Path

import pytest
from tests.net.parts import free_port

import esair
from esair.buses.peer import Network, PeerBus
from esair.drivers.peer import Peer
from esair.peers import Share, Sharing
from esair.testing import FakeActuator

pytest.importorskip("zenoh")
pytestmark = [pytest.mark.real_clock, pytest.mark.promise("NET-6")]

SOURCE = Path(__file__).parents[2] / "examples/lever/lever.c"
PICO = Path(os.environ.get("ZENOH_PICO", "/usr/local"))
"""Where zenoh-pico is: include/ and lib/, or a checkout that was built in build/."""


LIBRARIES = [*PICO.glob("lib/libzenohpico.a"), *PICO.glob("build/lib/libzenohpico.a")]


def test_it_is_short() -> None:
    """Less than a hundred lines speak the protocol."""
    assert len(SOURCE.read_text().splitlines()) < 100


@pytest.fixture
async def lever(tmp_path: Path) -> Path:
    """The program, if zenoh-pico and a compiler are there."""
    if shutil.which("cc") is None or not LIBRARIES:
        pytest.skip("needs a C compiler and zenoh-pico: ZENOH_PICO=its folder")
    folders = [f"-I{PICO / each}" for each in ("include", "build/include")]
    made = await asyncio.create_subprocess_exec(
        *("cc", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-DZENOH_LINUX", *folders),
        *(str(SOURCE), str(LIBRARIES[0]), "-lpthread", "-lm", "-lrt"),
        *("-o", str(tmp_path / "lever")),
    )
    assert await made.wait() == 0
    return tmp_path / "lever"


async def test_it_drives(lever: Path) -> None:
    """Its commands move, are answered, and are over with it."""
    end = f"tcp/127.0.0.1:{free_port()}"
    speed: FakeActuator[float] = FakeActuator("speed", safe=0.0)
    network = Network(me="base", peers=["lever"], listen=[end])
    bus = PeerBus(name="lever", network=network)
    sharing = Sharing(bus=bus, shares=[Share("speed", "write", priority=3)])
    async with esair.Robot(
        resources=[speed, Peer(name="lever", bus=bus)], behaviors=[sharing]
    ) as robot:
        process = await asyncio.create_subprocess_exec(
            *(str(lever), end, "base", "speed", "0.3", "1.5"),
            stdout=asyncio.subprocess.PIPE,
        )
        await speed.until(0.3, timeout=3.0)
        assert robot.resources.why("speed").holder == "lever"
        said, _ = await process.communicate()
        assert process.returncode == 0, said
        assert b"written " in said
        assert int(said.split()[1].rstrip(b",")) > 10, said
        await speed.until(0.0, timeout=0.5)
        assert bus.stats.bad_frames == 0
