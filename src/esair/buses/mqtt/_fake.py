"""A broker in memory, whose other clients a test plays."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any

import attrs

from esair.buses._bus import listen
from esair.buses._fakes import Fake
from esair.buses.mqtt._bus import MqttBus
from esair.buses.mqtt._wire import Message, MqttWire, matches

SENT_LIMIT = 4096
"""How many messages of the robot are kept; then the newest win."""


class FakeMqtt(Fake[Message, str], MqttBus):
    """A broker in memory that does what its test tells it.

    ``until(wanted, timeout=1.0)`` waits for a message of the robot, by its topic or a
    condition, and returns the newest; ``fail(error, after=0, times=1)`` raises an error
    from what it publishes, and an `OSError` is a loss.

    Args:
        name: The name of the bus.
        **options: What else `MqttBus` takes, such as ``timeout``.

    Attributes:
        sent: The newest messages that the robot has published, its last wills too.
        kept: What the broker has kept, by topic.
    """

    def __init__(self, name: str = "mqtt", **options: Any) -> None:
        self._far = _Memory(self)
        super().__init__(name=name, wire=self._far, **options)
        self._begin(SENT_LIMIT)
        self.kept: dict[str, Message] = {}
        self._on_message: list[Callable[[Message], None]] = []

    def feed(self, topic: str, payload: bytes | str, *, retain: bool = False) -> None:
        """Publish a message as another client does."""
        self._far.spread(self._message(topic, payload, retain))

    def on_message(self, listener: Callable[[Message], None]) -> Callable[[], None]:
        """Call a function with each message of the robot; returns how to stop that."""
        return listen(self._on_message, listener)

    def stall(self) -> None:
        """Acknowledge nothing and pass nothing on, until `resume`."""
        self._far.go.clear()

    def resume(self) -> None:
        """Go on."""
        self._far.go.set()

    def unplug(self) -> None:
        """Have no broker: all connections end."""
        self._far.unplug()

    def plug(self) -> None:
        """Have the broker again, with what it had kept."""
        self._far.plugged = True
        self.arrived()

    def failed_now(self) -> None:
        """Raise what is to fail now."""
        self._failures.check()

    def _is(self, item: Message, wanted: str) -> bool:
        return item.topic == wanted

    def _there(self) -> Iterable[Message]:
        return reversed(self.sent)

    def came(self, message: Message) -> None:
        """Take a message of the robot, as the other clients do."""
        self.sent.append(message)
        self._awaited.came(message)
        for listener in tuple(self._on_message):
            listener(message)


class _Memory(MqttWire):
    def __init__(self, bus: FakeMqtt) -> None:
        super().__init__()
        self.bus = bus
        self.plugged = True
        self.go = asyncio.Event()
        self.go.set()
        self.links: list[_Link] = []

    async def connect(
        self,
        heard: Callable[[Message], None],
        gone: Callable[[BaseException], None],
        will: Message | None,
    ) -> _Link:
        if not self.plugged:
            raise ConnectionRefusedError("there is no broker")
        await self.go.wait()
        link = _Link(self, heard, gone, will)
        self.links.append(link)
        return link

    def unplug(self) -> None:
        self.plugged = False
        links, self.links = self.links, []
        for link in links:
            link.gone(ConnectionResetError("the broker hung up"))

    def spread(self, message: Message) -> None:
        """Pass a message on to who has subscribed to it, and keep it."""
        if message.retained:
            self.bus.kept[message.topic] = message
            if not message.payload:
                del self.bus.kept[message.topic]
        if self.plugged and self.go.is_set():
            for link in tuple(self.links):
                link.deliver(message._replace(retained=False))


@attrs.define(eq=False)
class _Link:
    _broker: _Memory
    _heard: Callable[[Message], None]
    gone: Callable[[BaseException], None]
    _will: Message | None
    _patterns: list[str] = attrs.field(factory=list, init=False)
    _loop: asyncio.AbstractEventLoop = attrs.field(
        factory=asyncio.get_running_loop, init=False
    )

    def deliver(self, message: Message) -> None:
        if any(matches(each, message.topic) for each in self._patterns):
            self._loop.call_soon(self._heard, message)

    async def publish(self, message: Message, timeout: float) -> None:
        await self._answered()
        self._broker.bus.failed_now()
        self._loop.call_soon(self._pass_on, message)

    async def subscribe(self, pattern: str, timeout: float) -> None:
        await self._answered()
        self._patterns.append(pattern)
        for kept in self._broker.bus.kept.values():
            if matches(pattern, kept.topic):
                self.deliver(kept)

    async def close(self) -> None:
        if self in self._broker.links:  # else the broker itself has gone
            self._broker.links.remove(self)
            if self._will is not None:
                self._pass_on(self._will)

    def _pass_on(self, message: Message) -> None:
        self._broker.bus.came(message)
        self._broker.spread(message)

    async def _answered(self) -> None:
        if self not in self._broker.links:
            raise ConnectionResetError("the broker hung up")
        await self._broker.go.wait()
