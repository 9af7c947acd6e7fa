"""A robot with a control socket of its own folder, and clients in threads."""

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import attrs
import pytest

import esair
from esair.seat import VERSION


@attrs.frozen
class Twist:
    linear: float
    angular: float


STILL = Twist(0.0, 0.0)


class Wander(esair.Behavior):
    """Drives slowly, always."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            await self.wheels.write(Twist(0.3, 0.0))


class Raw:
    """A client that says whatever it likes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: list[dict[str, Any]] = []

    async def __aenter__(self) -> "Raw":
        self.reader, self.writer = await asyncio.open_unix_connection(
            str(self.path), limit=1 << 22
        )
        return self

    async def __aexit__(self, *_: object) -> None:
        self.writer.close()

    def send(self, data: bytes | dict[str, Any]) -> None:
        if isinstance(data, dict):
            data = json.dumps({"v": VERSION, **data}).encode() + b"\n"
        self.writer.write(data)

    async def hear(self, timeout: float = 5.0) -> dict[str, Any]:
        """Return the next line."""
        async with asyncio.timeout(timeout):
            line = await self.reader.readline()
        if not line:
            raise EOFError
        found: dict[str, Any] = json.loads(line)
        self.lines.append(found)
        return found

    async def answer(self, name: str | None, timeout: float = 5.0) -> dict[str, Any]:
        """Return the answer to an id."""
        while True:
            found = await self.hear(timeout)
            if "ok" in found and found["id"] == name:
                return found

    async def do(self, name: str, act: str, /, **fields: Any) -> dict[str, Any]:
        self.send({"id": name, "act": act, **fields})
        return await self.answer(name)

    async def is_closed(self, timeout: float = 5.0) -> bool:
        """Tell whether the robot closes the connection within a time."""
        try:
            while True:
                await self.hear(timeout)
        except (EOFError, ConnectionError):
            return True
        except TimeoutError:
            return False


async def eventually(condition: Callable[[], object], seconds: float = 20.0) -> None:
    """Wait until something is so."""
    for _ in range(int(seconds / 0.05)):
        if condition():
            return
        await asyncio.sleep(0.05)
    raise TimeoutError


@contextlib.asynccontextmanager
async def held() -> AsyncIterator[list[float]]:
    """For how long the loop is held at a stretch meanwhile, in seconds of its own work."""
    found: list[float] = []

    async def look() -> None:
        while True:
            before = time.thread_time()
            await asyncio.sleep(0)
            found.append(time.thread_time() - before)

    looking = asyncio.create_task(look())
    try:
        yield found
    finally:
        looking.cancel()


@pytest.fixture
def sockets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the control sockets."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    return tmp_path / "esair"


@pytest.fixture
def raw(sockets: Path) -> Callable[..., Raw]:
    """Make a client of a robot."""
    return lambda name="rover": Raw(sockets / f"{name}.sock")


@pytest.fixture
def rover(sockets: Path, fake_actuator: Any) -> Callable[..., esair.Robot]:
    """Make a robot with a socket; its wheels are ``robot.wheels``."""

    def make(*behaviors: Any, **options: Any) -> esair.Robot:
        wheels = options.pop("wheels", None) or fake_actuator("wheels", STILL)
        resources = [wheels, *options.pop("resources", ())]
        robot = esair.Robot(
            name=options.pop("name", "rover"),
            resources=resources,
            behaviors=behaviors,
            socket=True,
            **options,
        )
        robot.wheels = wheels
        return robot

    return make
