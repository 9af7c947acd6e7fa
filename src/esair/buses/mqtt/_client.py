"""Connections to a broker by aiomqtt; nothing else knows that package.

Its traps: the connection is made in a thread that cannot be stopped, so one that comes too
late is ended here; what it has received is unbounded, so it goes on at once; and it can
only leave with a farewell, for which a broker publishes no will.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Coroutine
from typing import Any

from esair.buses.mqtt._wire import Message, MqttWire
from esair.exceptions import describe
from esair.loading import of_extra
from esair.loop import spawn

with of_extra("mqtt"):
    import aiomqtt

CLOSE_TIMEOUT = 0.2
"""How long the end of a connection may take, in seconds."""


class Broker(MqttWire):
    """A broker on the network; arguments are those of ``aiomqtt.Client``."""

    def __init__(self, *address: Any, **options: Any) -> None:
        super().__init__()
        self._address = address
        self._options = options

    async def connect(
        self,
        heard: Callable[[Message], None],
        gone: Callable[[BaseException], None],
        will: Message | None,
    ) -> Client:
        """Connect; raises an `OSError` if that fails."""
        client = aiomqtt.Client(
            *self._address,
            queue_type=lambda maxsize: _Straight(heard),
            will=None
            if will is None
            else aiomqtt.Will(will.topic, will.payload, 1, will.retained),
            **self._options,
        )
        link = Client(client, gone)
        await link.enter()
        return link


class Client:
    """One connection."""

    def __init__(
        self, client: aiomqtt.Client, gone: Callable[[BaseException], None]
    ) -> None:
        self._client = client
        self._gone: Callable[[BaseException], None] | None = gone
        self._loop = asyncio.get_running_loop()
        self._watching: asyncio.Task[None] | None = None

    async def enter(self) -> None:
        """Connect, and watch out for the end of it."""
        entering = spawn(self._loop, self._client.__aenter__(), name="mqtt connect")
        try:
            await asyncio.shield(entering)
        except BaseException as error:
            entering.add_done_callback(self._leave)
            if isinstance(error, aiomqtt.MqttError):
                raise ConnectionError(describe(error)) from error
            raise
        self._watching = spawn(self._loop, self._watch(), name="mqtt watch")

    def _leave(self, entering: asyncio.Future[Any]) -> None:
        if entering.cancelled() or entering.exception() is not None:
            # It would ask how the connection was made, and raise in the event loop.
            self._client._client.on_disconnect = None  # noqa: SLF001
        self._shut()

    async def _watch(self) -> None:
        error: BaseException = ConnectionError("the broker hung up")
        try:
            async for _ in self._client.messages:  # all of them went on already
                pass
        except aiomqtt.MqttError as ended:
            error = ended.__cause__ or ended
        gone, self._gone = self._gone, None
        if gone is not None:
            gone(error)

    async def publish(self, message: Message, timeout: float) -> None:
        """Publish, at least once."""
        await _made(
            self._client.publish(
                message.topic,
                message.payload,
                qos=1,
                retain=message.retained,
                timeout=timeout + 1.0,  # the time of the bus is over before
            )
        )

    async def subscribe(self, pattern: str, timeout: float) -> None:
        """Subscribe."""
        await _made(self._client.subscribe(pattern, qos=1, timeout=timeout + 1.0))

    async def close(self) -> None:
        """End it without a farewell."""
        self._gone = None
        self._shut()
        if self._watching is not None:
            await asyncio.wait({self._watching}, timeout=CLOSE_TIMEOUT)
            self._watching.cancel()

    def _shut(self) -> None:
        """End the connection under the package, which then puts all of it away."""
        wire = self._client._client.socket()  # noqa: SLF001 - see above
        with contextlib.suppress(OSError, AttributeError):
            wire.shutdown(socket.SHUT_RDWR)


async def _made(call: Coroutine[Any, Any, Any]) -> None:
    try:
        await call
    except aiomqtt.MqttError as error:
        raise ConnectionError(describe(error)) from error


class _Straight(asyncio.Queue[Any]):
    """A queue that keeps nothing: what comes goes to the bus at once."""

    def __init__(self, heard: Callable[[Message], None]) -> None:
        super().__init__()
        self._heard = heard

    def put_nowait(self, message: Any) -> None:
        payload = bytes(message.payload or b"")  # only what is sent may be another type
        self._heard(Message(str(message.topic), payload, message.retain))
