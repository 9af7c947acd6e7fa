"""A serial line without a descriptor, such as ``loop://``: threads wait for it."""

from __future__ import annotations

import asyncio
import contextlib
import math
from typing import Any

from esair.loop import Executor, spawn

READ_PERIOD = 0.1
"""How long a thread waits for bytes before it looks whether it is needed, in s."""

PIECE = 256
"""How many bytes are given to the line at once; what waits can be thrown away."""


class ThreadLink:
    """Two threads that read and write, for a port that the loop cannot wait for.

    The methods are those of a transport: nothing waits, and bytes that the line has
    not taken can be thrown away, except the piece that is being written.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        protocol: asyncio.Protocol,
        device: Any,
        *,
        name: str,
    ) -> None:
        self._loop = loop
        self._protocol = protocol
        self._device = device
        self._in = Executor(f"{name}-in")
        self._out = Executor(f"{name}-out")
        self._buffer = bytearray()
        self._in_flight = 0
        self._closing = False
        self._name = name
        self._reading = spawn(loop, self._read(), name=f"{name} in")
        self._writing: asyncio.Task[None] | None = None

    def write(self, data: bytes) -> None:
        """Take bytes and send them when the line takes them."""
        if self._closing:
            return
        self._buffer += data
        if self._writing is None:
            self._writing = spawn(self._loop, self._write(), name=f"{self._name} out")

    def get_write_buffer_size(self) -> int:
        """Return how many bytes the line has not taken yet."""
        return len(self._buffer) + self._in_flight

    def set_write_buffer_limits(
        self, high: int | None = None, low: int | None = None
    ) -> None:
        """Need no limits: the protocol is told when everything is sent."""

    def flush(self) -> None:
        """Throw the bytes away that are not being written."""
        self._buffer.clear()

    def is_closing(self) -> bool:
        """Return whether the line was let go."""
        return self._closing

    def abort(self) -> None:
        """Let the line go at once; the threads end as soon as the port lets them."""
        self._closing = True
        self._buffer.clear()
        self._reading.cancel()
        if self._writing is not None:
            self._writing.cancel()
        self._in.close()
        self._out.close()

    async def _read(self) -> None:
        with self._telling():
            while True:
                data = await self._in.call(self._take, timeout=math.inf)
                if data:
                    self._protocol.data_received(data)

    async def _write(self) -> None:
        with self._telling():
            while self._buffer:
                piece = bytes(self._buffer[:PIECE])
                del self._buffer[:PIECE]
                self._in_flight = len(piece)
                await self._out.call(self._device.write, piece, timeout=math.inf)
                self._in_flight = 0
            self._writing = None
            self._protocol.resume_writing()

    def _take(self) -> bytes:
        device = self._device
        first: bytes = device.read(1)
        waiting = min(device.in_waiting, 4096) if first else 0
        return first + device.read(waiting) if waiting else first

    @contextlib.contextmanager
    def _telling(self) -> Any:
        """Tell the protocol of an error of the port."""
        try:
            yield
        except Exception as error:  # pyserial raises SerialException, TypeError, ...
            if not self._closing:
                self._protocol.connection_lost(error)
