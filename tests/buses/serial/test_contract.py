"""The serial bus keeps the published contract: in memory, on a terminal, on a URL."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from serial import SerialException

from esair.buses import SerialBus
from esair.testing import BusContract, FakeSerial


class OnFakes(BusContract):
    """Asks a far end that echoes."""

    def make(self) -> FakeSerial:
        line = FakeSerial("front", write_timeout=0.2)
        line.on_frame = lambda message: b"echo " + message
        return line

    async def use(self, bus: Any) -> None:
        assert await bus.ask(b"hello", prefix=b"echo") == b"echo hello"

    async def ask(self, bus: Any, number: int) -> int:
        return int((await bus.ask(b"%d" % number, timeout=1.0)).removeprefix(b"echo "))

    async def delay(self, bus: Any, seconds: float) -> None:
        def answer(message: bytes) -> None:
            loop.call_later(seconds, bus.say, b"echo " + message)

        loop = asyncio.get_running_loop()
        bus.on_frame = answer


class TestInMemory(OnFakes):
    """On the virtual clock."""


@pytest.mark.real_clock
class TestOnATerminal(OnFakes):
    """On a pseudo-terminal, with the kernel, descriptors and a thread."""


@pytest.mark.real_clock
class TestOnAUrl(BusContract):
    """On pyserial's own loop, which has no descriptor: threads wait for it."""

    @pytest.fixture(autouse=True)
    def _with_a_cable(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.plugged, self.silent = True, False
        loop: Any = importlib.import_module("serial.urlhandler.protocol_loop").Serial
        monkeypatch.setattr(loop, "open", self._patched(self._open, loop.open))
        monkeypatch.setattr(loop, "read", self._patched(self._read, loop.read))

    def _patched(self, instead: Any, method: Any) -> Any:
        return lambda port, *args: instead(port, method, *args)

    def _open(self, port: Any, openly: Any) -> None:
        if not self.plugged:
            raise SerialException("there is no such port")
        openly(port)

    def _read(self, port: Any, read: Any, size: int = 1) -> bytes:
        if not self.plugged:
            raise SerialException("the device is gone")
        data: bytes = read(port, size)
        return b"" if self.silent else data

    def make(self) -> SerialBus:
        return SerialBus(name="loop", port="loop://", late_limit=0.1)

    async def use(self, bus: Any) -> None:
        assert await bus.ask(b"hello") == b"hello"

    async def unplug(self, bus: Any) -> None:
        self.plugged = False

    async def plug(self, bus: Any) -> None:
        self.plugged = True

    async def stall(self, bus: Any) -> None:
        self.silent = True

    async def resume(self, bus: Any) -> None:
        self.silent = False

    async def ask(self, bus: Any, number: int) -> int:
        return int(await bus.ask(b"%d" % number, timeout=1.0))

    async def delay(self, bus: Any, seconds: float) -> None:
        assert await self.ask(bus, 1) == 1, "there is nothing that could be late"


class Server:
    """A device server: what it gets in lines goes back."""

    def __init__(self) -> None:
        self.delay = 0.0
        self.silent = False
        self.port = 0
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.StreamWriter] = set()

    async def plug(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def unplug(self) -> None:
        assert self._server is not None
        self._server.close()
        await asyncio.sleep(0.01)  # who has just connected is served first
        for each in self._clients:
            each.transport.abort()

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._clients.add(writer)
        with contextlib.suppress(ConnectionError):
            while line := await reader.readline():
                await asyncio.sleep(self.delay)
                if not self.silent:
                    writer.write(line)
        self._clients.discard(writer)
        writer.transport.abort()


@pytest.mark.real_clock
@pytest.mark.long
class TestOnASocket(TestOnAUrl):
    """On a socket, by pyserial: without a thread, as any port."""

    @pytest_asyncio.fixture(autouse=True)
    async def _with_a_server(self) -> AsyncIterator[None]:
        self.server = Server()
        await self.server.plug()
        yield
        await self.server.unplug()

    def make(self) -> SerialBus:
        port = f"socket://127.0.0.1:{self.server.port}"
        return SerialBus(name="remote", port=port, late_limit=0.1)

    async def unplug(self, bus: Any) -> None:
        await self.server.unplug()

    async def plug(self, bus: Any) -> None:
        await self.server.plug()

    async def stall(self, bus: Any) -> None:
        self.server.silent = True

    async def resume(self, bus: Any) -> None:
        self.server.silent = False

    async def delay(self, bus: Any, seconds: float) -> None:
        self.server.delay = seconds
