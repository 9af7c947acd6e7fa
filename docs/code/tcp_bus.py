"""A fourth kind of bus in one file: lines over TCP, a request and its answer."""

import asyncio

from esair.buses import Bus
from esair.exceptions import DeviceLostError, DriverStuckError, describe


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
        self._turn = asyncio.Lock()
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None

    async def ask(self, request: bytes) -> bytes:
        """Send a line and return the line that answers it.

        Raises:
            DeviceLostError: The connection is gone, or there is none.
            DriverStuckError: No answer came in time. The connection is given up,
                because a late answer would be taken for that of the next request.
        """
        try:
            async with asyncio.timeout(self.timeout), self._turn:
                reader, writer = self._connected()
                writer.write(request + b"\n")
                self.stats.sent += len(request) + 1
                answer = await reader.readuntil(b"\n")
                self.stats.received += len(answer)
                return answer[:-1]
        except TimeoutError:
            stuck = DriverStuckError(self.name, "ask", self.timeout)
            self._give_up(stuck)
            raise stuck from None
        except DeviceLostError:
            raise
        except (OSError, EOFError, asyncio.LimitOverrunError) as error:
            raise self._give_up(DeviceLostError(self.name, describe(error))) from error

    def _connected(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        if not self.is_open or self._reader is None or self._writer is None:
            raise DeviceLostError(self.name, "the bus is not open")
        return self._reader, self._writer

    def _give_up(self, error: OSError) -> OSError:
        if self._writer is not None:
            self._writer.transport.abort()
        self.lost(error)
        return error

    async def _open(self) -> None:
        await self._close()  # what a loss has left behind
        try:
            async with asyncio.timeout(self.timeout):
                self._reader, self._writer = await asyncio.open_connection(
                    self.host, self.port, limit=4096
                )
        except OSError as error:  # a TimeoutError is one too
            where = f"{self.host}:{self.port}"
            detail = f"no connection to {where}: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error

    async def _close(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.transport.abort()  # at once: close() would wait for a stuck peer
            try:
                await writer.wait_closed()
            except OSError:
                return  # it was lost before
