"""Messages through a broker, by their topics."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Any

from esair.buses._bus import Bus
from esair.buses._inbox import Inbox
from esair.buses.finding import ROOT, Device
from esair.buses.mqtt._wire import Message, MqttLink, MqttWire, matches
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.values import check_bytes, check_seconds, check_whole


class MqttBus(Bus):
    """A broker of MQTT, and who listens to which topics.

    A message is sent once it is acknowledged (QoS 1). A broker that does not acknowledge
    in time is gone: the connection ends with all that waits in it, so nothing comes late.

    An actuator has a connection of its own, because a connection has one last will: its
    safe command. The broker publishes it as soon as that connection ends, however it
    ends. If it has fallen silent, that is one and a half times ``keepalive`` later, when
    the broker looks: mosquitto looks every 5 s.

    Args:
        name: The name of the bus.
        host: The name or address of the broker.
        port: Its port.
        timeout: How long a connection or an acknowledge may take, in seconds.
        keepalive: After how many seconds of silence the broker is asked for a sign of
            life; it misses the robot after half as long again.
        discovery: Under which topic Home Assistant looks for what is announced.
        wire: What is opened instead of a broker on the network.
        **options: Further options of ``aiomqtt.Client``, such as ``username`` and
            ``password``.
    """

    def __init__(
        self,
        *,
        name: str,
        host: str = "",
        port: int = 1883,
        timeout: float = 1.0,
        keepalive: int = 4,
        discovery: str = "homeassistant",
        wire: MqttWire | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name=name, wire=wire)
        if not host and wire is None:
            raise ConfigError(
                name, "host", "expected the name or address of the broker"
            )
        self.host = host
        self.port: int = check_whole(name, "port", port, 1, 65535)
        self.timeout: float = check_seconds(name, "timeout", timeout)
        self.keepalive: int = check_whole(name, "keepalive", keepalive, 2, 3600)
        self.discovery = discovery
        self._options = options
        self._links: list[MqttLink] = []
        self._inboxes: dict[Inbox[Message], tuple[str, ...]] = {}

    async def subscribe(self, *patterns: str, limit: int = 16) -> Inbox[Message]:
        """Listen to the topics that fit one of some patterns.

        Args:
            *patterns: Topics; a level of one may be ``+`` for any, the last ``#`` for all.
            limit: How many messages are kept until they are taken; then the newest win.

        Raises:
            DeviceLostError: The broker is gone.
        """
        link = self._connected()[0]
        for pattern in patterns:
            check_topic(self.name, pattern)
        inbox: Inbox[Message] = Inbox(limit, self._forget)
        self._inboxes[inbox] = patterns
        try:
            for pattern in patterns:
                await self._made(link.subscribe(pattern, self.timeout), "subscribe")
        except BaseException:
            inbox.close()
            raise
        return inbox

    async def publish(
        self,
        topic: str,
        payload: bytes | str,
        *,
        retain: bool = False,
        link: MqttLink | None = None,
    ) -> None:
        """Send a message, and wait until the broker has it.

        Args:
            topic: What it is about.
            payload: What it says.
            retain: Whether the broker keeps it for who comes later.
            link: The connection of an actuator; that of the bus if None.

        Raises:
            DeviceLostError: The broker is gone, or does not acknowledge it in time.
        """
        message = self._message(topic, payload, retain)
        link = link or self._connected()[0]
        if link not in self._links:
            raise DeviceLostError(self.name, "the connection is closed")
        await self._made(link.publish(message, self.timeout), "publish")
        self.stats.sent += 1

    async def connect(
        self, topic: str, payload: bytes | str, *, retain: bool = False
    ) -> MqttLink:
        """Return a further connection with a last will; hand it back to `disconnect`."""
        self._connected()
        return await self._connect(self._message(topic, payload, retain))

    async def disconnect(self, link: MqttLink | None) -> None:
        """End a connection: its last will is published."""
        if link in self._links:
            self._links.remove(link)
            await link.close()

    async def _made(self, call: Any, what: str) -> None:
        try:
            await self.wait_for(call, self.timeout)
        except DriverStuckError:
            silent = f"the broker has not answered for {self.timeout:g} s: {what}"
            loss = DeviceLostError(self.name, silent)
            self._gone(loss)
            raise loss from None
        except DeviceLostError:
            raise
        except OSError as error:
            loss = self.loss(error)
            self._gone(loss)
            raise loss from error

    def _message(self, topic: str, payload: bytes | str, retain: bool) -> Message:
        check_topic(self.name, topic, wild=False)
        data = payload.encode() if isinstance(payload, str) else payload
        return Message(topic, check_bytes(self.name, "payload", data), retain)

    def _connected(self) -> list[MqttLink]:
        if not self.is_open or not self._links:
            raise DeviceLostError(self.name, "there is no connection to the broker")
        return self._links

    async def _connect(self, will: Message | None) -> MqttLink:
        wire = self._wire
        if wire is not None:
            wire = await self._far_end(wire)
        else:
            from esair.buses.mqtt._client import Broker  # as late as can be

            wire = Broker(
                self.host,
                self.port,
                keepalive=self.keepalive,
                timeout=self.timeout,
                **self._options,
            )
        assert isinstance(wire, MqttWire)
        try:
            async with asyncio.timeout(self.timeout):
                link = await wire.connect(self._heard, self._gone, will)
        except OSError as error:  # a TimeoutError is one too
            where = f"the broker at {self.host}:{self.port}" if self.host else "it"
            detail = f"{where} cannot be reached: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error
        self._links.append(link)
        return link

    async def _open(self) -> None:
        await self._connect(None)

    async def _close(self) -> None:
        links, self._links = self._links, []
        self._fail(DeviceLostError(self.name, "the bus was closed"))
        for link in reversed(links):  # last wills first
            await link.close()

    def _heard(self, message: Message) -> None:
        self.stats.received += 1
        takers = [
            inbox
            for inbox, patterns in self._inboxes.items()
            if any(matches(each, message.topic) for each in patterns)
        ]
        self.stats.unheard += not takers
        for inbox in takers:
            before = inbox.dropped
            inbox.offer(message)
            self.stats.dropped += inbox.dropped - before

    def _gone(self, error: BaseException) -> None:
        if not self.is_open:
            return
        loss = self.loss(error)
        self._fail(loss)
        self.lost(loss)

    def _fail(self, error: BaseException) -> None:
        inboxes, self._inboxes = tuple(self._inboxes), {}
        for inbox in inboxes:
            inbox.fail(error)

    def _forget(self, inbox: Inbox[Message]) -> None:
        with contextlib.suppress(KeyError):
            del self._inboxes[inbox]


def check_topic(owner: str, topic: object, *, wild: bool = True) -> str:
    """Return a topic, or a pattern of topics, if it is one.

    Raises:
        BadValueError: It is empty, too long, or has a ``+`` or ``#`` where none may be.
    """
    if isinstance(topic, str) and 0 < len(topic.encode()) <= 65535:
        *levels, last = topic.split("/")
        levels += [] if last == "#" and wild else [last]
        allowed = {"+"} if wild else set()
        if all(each in allowed or not set(each) & set("+#\0") for each in levels):
            return topic
    what = "a topic" if not wild else "a topic, or one with + and a last #"
    raise BadValueError(owner, "topic", f"expected {what}, not {topic!r:.80}")


def devices(root: Path = ROOT) -> list[Device]:
    """Return nothing: a broker is not plugged in."""
    return []


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a broker."""
    return [f"[bus.{name}]", 'type = "mqtt"', f'host = "{device.address}"']
