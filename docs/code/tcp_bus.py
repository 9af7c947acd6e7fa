"""One more kind of bus in one file: lines over TCP, a request and its answer."""

import asyncio

from esair.buses import Bus, Exchanges
from esair.exceptions import DeviceLostError, describe
from esair.framing import Lines


class TcpBus(Bus):
    """A device server on the network that answers each line with a line.

    Args:
        name: The name of the bus.
        host: The name or address of the server.
        port: Its port.
        timeout: How long a connection or an answer may take, in seconds.
    """

    def __init__(
        self, *, name: str, host: str, port: int, timeout: float = 0.5
    ) -> None:
        super().__init__(name=name)
        self.host = host
        self.port = port
        self.timeout = timeout
        self._exchanges = Exchanges(self)
        self._line: _Line | None = None

    async def ask(self, request: bytes) -> bytes:
        """Send a line and return the line that answers it.

        Raises:
            DeviceLostError: The connection is gone, or there is none.
            BusyError: Too many wait for their turn; nothing was sent.
            DriverStuckError: No answer came in time. When it comes, it is nobody's.
        """
        self._connected()

        async def send(_seconds: float) -> None:
            self._connected().write(request + b"\n")
            self.stats.sent += len(request) + 1

        return await self._exchanges.ask(send, timeout=self.timeout)

    def heard(self, data: bytes, messages: list[bytes]) -> None:
        """Take what came: each line belongs to one request, or to none."""
        self.stats.received += len(data)
        for message in messages:
            self._exchanges.offer(message)

    def gone(self, line: "_Line", error: Exception | None) -> None:
        """Notice that the connection has ended, without being used."""
        if line is self._line:
            why = "the server hung up" if error is None else describe(error)
            loss = DeviceLostError(self.name, why)
            self._exchanges.fail(loss)
            self.lost(loss)

    def _connected(self) -> asyncio.Transport:
        if not self.is_open or self._line is None:
            raise DeviceLostError(self.name, "the bus is not open")
        return self._line.transport

    async def _open(self) -> None:
        self._exchanges.clear()  # a new connection owes nothing
        loop = asyncio.get_running_loop()
        line = _Line(self)
        try:
            async with asyncio.timeout(self.timeout):
                await loop.create_connection(lambda: line, self.host, self.port)
        except OSError as error:  # a TimeoutError is one too
            where = f"{self.host}:{self.port}"
            detail = f"no connection to {where}: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error
        self._line = line

    async def _close(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            self._exchanges.fail(DeviceLostError(self.name, "the bus was closed"))
            line.transport.abort()  # at once: close() would wait for a stuck peer
            await line.ended.wait()


class _Line(asyncio.Protocol):
    """One connection: its bytes, cut into lines."""

    transport: asyncio.Transport

    def __init__(self, bus: TcpBus) -> None:
        self._bus = bus
        self._framing = Lines(max_length=4096)
        self.ended = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self._bus.heard(data, self._framing.feed(data))

    def connection_lost(self, error: Exception | None) -> None:
        self.ended.set()
        self._bus.gone(self, error)
