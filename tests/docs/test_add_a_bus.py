"""The bus of the how-to page, under the contract that all buses keep."""

import asyncio
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from tcp_bus import TcpBus

import esair
from esair.testing import BusContract


class Server:
    """A device server that can be unplugged and stalled."""

    def __init__(self) -> None:
        self.port = 0
        self.silent = False
        self.delay = 0.0
        self._server: asyncio.Server | None = None
        self._clients: dict[asyncio.StreamWriter, None] = {}

    async def plug(self) -> None:
        self._server = await asyncio.start_server(
            self._serve, "127.0.0.1", self.port, reuse_address=True
        )
        self.port = self._server.sockets[0].getsockname()[1]

    async def unplug(self) -> None:
        assert self._server is not None
        self._server.close()
        for client in self._clients:
            client.transport.abort()
        await self._server.wait_closed()

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._clients[writer] = None
        try:
            while request := await reader.readline():
                await asyncio.sleep(self.delay)
                if not self.silent:
                    writer.write(b"got " + request)
        except ConnectionError:
            pass
        finally:
            del self._clients[writer]
            writer.transport.abort()


@pytest_asyncio.fixture
async def server() -> AsyncIterator[Server]:
    server = Server()
    await server.plug()
    yield server
    await server.unplug()


@pytest.mark.real_clock
class TestTcpBus(BusContract):
    server: Server

    @pytest_asyncio.fixture(autouse=True)
    async def _with_a_server(self, server: Server) -> None:
        self.server = server

    def make(self) -> TcpBus:
        return TcpBus(name="tcp", host="127.0.0.1", port=self.server.port, timeout=1.0)

    async def use(self, bus: TcpBus) -> None:
        assert await bus.ask(b"ping") == b"got ping"

    async def unplug(self, bus: TcpBus) -> None:
        await self.server.unplug()

    async def plug(self, bus: TcpBus) -> None:
        await self.server.plug()

    async def stall(self, bus: TcpBus) -> None:
        self.server.silent = True

    async def resume(self, bus: TcpBus) -> None:
        self.server.silent = False

    async def ask(self, bus: TcpBus, number: int) -> int:
        return int((await bus.ask(b"%d" % number)).removeprefix(b"got "))

    async def delay(self, bus: TcpBus, seconds: float) -> None:
        self.server.delay = seconds


@pytest.mark.real_clock
async def test_requests_of_several_devices_take_turns(server: Server) -> None:
    """Whoever asks gets the answer to their own request."""
    bus = TcpBus(name="tcp", host="127.0.0.1", port=server.port)
    await bus.open()

    answers = await asyncio.gather(*(bus.ask(b"%d" % n) for n in range(50)))

    assert answers == [b"got %d" % n for n in range(50)]
    await bus.close()


class Level(esair.Sensor[float]):
    """The level in a tank, from the server."""

    bus: TcpBus

    async def read(self) -> float:
        answer = await self.bus.ask(b"0.25")
        return float(answer.removeprefix(b"got "))


@pytest.mark.real_clock
async def test_a_sensor_on_it_comes_back(server: Server) -> None:
    """A robot needs nothing else to lose and regain what is behind the bus."""
    level = Level(bus=TcpBus(name="tcp", host="127.0.0.1", port=server.port))

    async with esair.Robot(resources=[level]) as robot, asyncio.timeout(10):
        right = await robot.resources.register("me", "level", esair.Access.READ)
        assert (await robot.sensors.read(right)).value == 0.25

        await server.unplug()
        with pytest.raises(esair.DeviceLostError):
            await robot.sensors.read(right, fresh=True)
        await server.plug()
        while robot.resources.query("level").state is not esair.ResourceState.READY:  # noqa: ASYNC110 - there is no event for it
            await asyncio.sleep(0.01)

        assert (await robot.sensors.read(right, fresh=True)).value == 0.25
