"""One opening of a serial line: who gets its bytes, and who waits to send."""

from __future__ import annotations

import abc
import asyncio
from collections.abc import Awaitable, Callable
from typing import Protocol

from esair.buses._bus import Wire
from esair.loop import ignore


class SerialLink(Protocol):
    """The robot's end of a serial line; pyserial-asyncio's transport is one."""

    def write(self, data: bytes) -> None:
        """Take bytes and send them when the line takes them; never waits."""

    def get_write_buffer_size(self) -> int:
        """Return how many bytes the line has not taken yet."""

    def flush(self) -> None:
        """Throw the bytes away that the line has not taken yet."""

    def is_closing(self) -> bool:
        """Return whether the line was let go."""

    def abort(self) -> None:
        """Let the line go at once; what it has not taken is thrown away."""


class SerialWire(Wire, abc.ABC):
    """The far end of a serial line."""

    @abc.abstractmethod
    async def open(
        self,
        protocol: asyncio.Protocol,
        port: Callable[[str], Awaitable[SerialLink]] | None = None,
    ) -> SerialLink:
        """Open the robot's end.

        Args:
            protocol: Is told what comes, and of the end.
            port: Opens a device file as every port is opened, for the protocol.

        Raises:
            DeviceLostError: Nothing is plugged in, or somebody else has it.
        """


class Line(asyncio.Protocol):
    """What a link tells: bytes, room to send, its end. Silent once it is closed."""

    link: SerialLink

    def __init__(
        self,
        received: Callable[[bytes], None],
        gone: Callable[[Line, Exception | None], None],
    ) -> None:
        self.data_received = received  # type: ignore[method-assign, assignment]
        self._gone = gone
        self._writers: list[asyncio.Future[None]] = []
        self._sizes: list[int] = []
        self._over = False

    def write(self, data: bytes) -> bool:
        """Hand a message to the link; tell whether it has taken all of it at once."""
        self.link.write(data)
        if not self.link.get_write_buffer_size():
            return True
        self._sizes.append(len(data))
        return False

    def ends_in_a_message(self) -> bool:
        """Tell whether what the link has taken ends in the middle of a message."""
        waiting = self.link.get_write_buffer_size()
        whole = 0
        for size in reversed(self._sizes):
            if whole >= waiting:
                break
            whole += size
        return whole != waiting

    @property
    def waiting(self) -> int:
        """How many writers wait."""
        return len(self._writers)

    def wait(self) -> asyncio.Future[None]:
        """Return a future that is done when the link has taken all bytes."""
        writer: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._writers.append(writer)
        return writer

    def forget(self, writer: asyncio.Future[None]) -> None:
        """Tell a writer nothing more."""
        if writer in self._writers:
            self._writers.remove(writer)

    def settle(self, error: BaseException | None) -> None:
        """Tell all writers that wait how it ended."""
        writers, self._writers = self._writers, []
        for writer in writers:
            if writer.done():
                continue
            if error is None:
                writer.set_result(None)
            else:
                writer.set_exception(error)

    def end(self) -> None:
        """Let the link go; nothing more is heard of it."""
        self._over = True
        self.data_received = ignore  # type: ignore[method-assign, assignment]
        if not self.link.is_closing():
            self.link.abort()

    def resume_writing(self) -> None:
        self._sizes.clear()
        self.settle(None)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self._over:
            self._over = True
            self._gone(self, exc)
