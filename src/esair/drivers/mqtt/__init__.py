"""What a device publishes by MQTT, and what it is told.

Most devices of a house and many boards (ESPHome, Tasmota, Zigbee2MQTT) publish numbers,
words or JSON::

    [bus.house]
    type = "mqtt"
    host = "192.168.1.2"

    [sensor.water]
    driver = "mqtt"
    bus = "house"
    topic = "garden/tank"
    value = "level.cm"              # a way in JSON
    status = "garden/status"        # its last will: there is "online", or it is lost

    [actuator.pump]
    driver = "mqtt"
    bus = "house"
    topic = "garden/pump/set"
    safe = false
    on = "ON"
    off = "OFF"

What a broker has kept (``retained``) is no reading unless the sensor says so: nobody knows
how old it is. The last will of an actuator's connection is its safe command, so the broker
tells it when the robot's process is gone.

Source: MQTT 3.1.1 (OASIS), 3.1.2.5 will, 3.3.1.3 retain, 4.7 topics; Home Assistant, MQTT
discovery.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Mapping
from typing import Any, ClassVar, TypedDict, Unpack

from esair.buses import Inbox
from esair.buses.mqtt import Message, MqttBus, MqttLink, matches
from esair.drivers._on_bus import check_bus, check_sense, ended, heard, watching
from esair.exceptions import BadValueError, ConfigError, DeviceLostError, describe
from esair.resources import (
    HOLD,
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)
from esair.values import check_seconds, digits_of

__all__ = ["MqttActuator", "MqttSensor"]

TYPES: Mapping[str, Any] = {
    "number": float,
    "switch": bool,
    "text": str,
    "json": object,
}
"""The kinds of payload, and the types of their values."""

PATIENCE = 2.0
"""How long a device has time to say that it is there, in seconds."""


class _OnMqtt(Resource):
    """What sensors and actuators have in common: a topic, and words for its values."""

    bus: MqttBus
    deadline: float = 3.0
    _topic_of_announcement = ""

    def __init__(
        self,
        *,
        topic: str,
        kind: str,
        on: str = "ON",
        off: str = "OFF",
        status: str | None = None,
        online: str = "online",
        announce: Mapping[str, Any] | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        check_bus(self, MqttBus)
        if kind not in TYPES:
            told = f"expected one of {', '.join(TYPES)}, not {kind!r:.40}"
            raise ConfigError(self.name, "kind", told)
        if announce is not None and "component" not in announce:
            told = "expected a table with a component, such as 'sensor' or 'number'"
            raise ConfigError(self.name, "announce", told)
        self.topic = topic
        self.kind = kind
        self.status = status
        self._words = {True: on, False: off}
        self._online = online
        self._announced = announce

    @property
    def value_type(self) -> Any:
        """The type of its values, by its kind."""
        return TYPES[self.kind]

    async def _announce(self) -> None:
        """Have Home Assistant show it, if wanted; the broker keeps that."""
        if self._announced is None:
            return
        told = dict(self._announced)
        place = f"{self.bus.discovery}/{told.pop('component')}/{self.bus.name}"
        told = {
            "name": self.name,
            "unique_id": f"{self.bus.name}_{self.name}",
            self._topic_of_announcement: self.topic,
            **told,
        }
        await self.bus.publish(
            f"{place}/{self.name}/config", json.dumps(told), retain=True
        )

    def _is_status(self, message: Message) -> bool:
        """Tell whether a message is about the device itself.

        Raises:
            DeviceLostError: It says that the device is not there.
        """
        if self.status is None or not matches(self.status, message.topic):
            return False
        word = message.payload.decode("utf-8", "replace")
        if word != self._online:
            told = f"{message.topic!r} says {word!r:.40}, not {self._online!r}"
            raise DeviceLostError(self.name, told)
        return True


class _MqttSettings(TypedDict, total=False):
    on: str
    off: str
    status: str | None
    online: str
    announce: Mapping[str, Any] | None


class _SensorSettings(_MqttSettings, SensorSettings): ...


class _ActuatorSettings(_MqttSettings, ActuatorSettings): ...


class MqttSensor(_OnMqtt, Sensor[Any]):
    """What is published on a topic.

    Args:
        topic: The topic.
        kind: ``"number"``, ``"switch"`` (a bool), ``"text"`` or ``"json"``.
        value: The way to it in JSON, such as ``"level.cm"`` or ``"cells.0"``.
        on: What a switch says when it is on; ``off`` likewise.
        retained: Whether what the broker has kept is a reading, too, however old it is:
            one, unless something newer has come.
        silent_after: After how many seconds without a value the device is lost; it may
            be silent for ever if None.
        status: The topic of the device's last will; it is lost unless ``online`` is
            there.
        online: What is there while the device is.
        limits: Least and greatest value; what is outside is a fault of the device.
        announce: What Home Assistant is told, to have it be set there: ``component``
            and what that has, such as ``{component = "number", min = 0, max = 1}``.

    Attributes:
        bad_payloads: How many messages had no such value; without a ``silent_after``
            three in a row are a fault.
    """

    _bad_in_row = 0

    _topic_of_announcement = "command_topic"
    counted: ClassVar[tuple[str, ...]] = ("bad_payloads",)

    def __init__(
        self,
        *,
        topic: str,
        kind: str = "number",
        value: str | None = None,
        retained: bool = False,
        silent_after: float | None = None,
        limits: tuple[float, float] | None = None,
        **settings: Unpack[_SensorSettings],
    ) -> None:
        super().__init__(topic=topic, kind=kind, **settings)
        self._way = [] if value is None else value.split(".")
        self.retained = retained
        self.silent_after = silent_after
        if silent_after is not None:
            check_seconds(self.name, "silent_after", silent_after)
            self.period = self.period or silent_after
        if limits is not None:
            self.limits: tuple[float, float] = limits
        self.bad_payloads: int = 0

    async def open(self) -> None:
        """Make sure that it is there, if it has to say so."""
        self._told: set[str] = set()
        await self._announce()
        if self.status is None and self.silent_after is None:
            return
        seconds = self.silent_after or PATIENCE
        with await self.bus.subscribe(self.status or self.topic) as inbox:
            async for message in heard(self, inbox, seconds):
                if self._is_status(message) or not message.retained:
                    return

    async def stream(self) -> AsyncIterator[Any]:
        """Yield each value that comes; what has none is counted and left out.

        Raises:
            DeviceFaultError: No value comes any more, but ``nan``, say, and the last one
                would stay current for ever.
        """
        topics = (self.topic,) if self.status is None else (self.status, self.topic)
        with await self.bus.subscribe(*topics) as inbox:
            values = heard(self, inbox, self.silent_after, self._value_of)
            async for (value,) in values:
                yield value

    def _value_of(self, message: Message) -> tuple[Any] | None:
        """Return the value of a message, if it has one; ``null`` of JSON is one, too."""
        if self._is_status(message):
            return None
        if message.retained and (not self.retained or message.topic in self._told):
            return None  # or it is told again because somebody else asks for it
        if self.retained:
            self._told.add(message.topic)
        try:
            value = self._decoded(message.payload)
        except (ValueError, LookupError, TypeError, ArithmeticError, RecursionError):
            self.bad_payloads += 1
            self._bad_in_row += 1
        else:
            self._bad_in_row = 0
            return (value,)
        check_sense(self, self._bad_in_row, "have no such value", message.payload)
        return None

    def _decoded(self, payload: bytes) -> Any:
        found: Any = payload.decode()
        if self._way or self.kind == "json":
            found = json.loads(found)
            for step in self._way:
                found = found[int(step) if isinstance(found, list) else step]
        if self.kind == "switch":
            if isinstance(found, bool):
                return found
            return {word: value for value, word in self._words.items()}[found]
        if self.kind == "number":
            number = math.nan if isinstance(found, bool) else float(found)
            if not math.isfinite(number):
                raise ValueError(found)
            return number
        return str(found) if self.kind == "text" else found


class MqttActuator(_OnMqtt, Actuator[Any]):
    """What is published to a device; the safe command is the last will.

    Args:
        topic: The topic that the device listens to.
        safe: The safe command, whose type is that of all; ``"hold"`` if it may stay
            where it is: then there is no last will.
        kind: ``"number"``, ``"switch"`` (a bool), ``"text"`` or ``"json"``; by the type
            of ``safe`` unless given.
        on: What is said for True; ``off`` likewise.
        retain: Whether the broker keeps the newest command for a device that comes
            later: for what may be told twice, such as a lamp.
        limits: Least and greatest command.
        own_timeout: After how many seconds without a command the device itself stops.
        **settings: ``status``, ``announce`` and more, as of an `MqttSensor`.
    """

    _topic_of_announcement = "state_topic"

    def __init__(
        self,
        *,
        topic: str,
        safe: Any,
        kind: str | None = None,
        retain: bool = False,
        limits: tuple[float, float] | None = None,
        own_timeout: float | None = None,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        if kind is None:
            kinds = {bool: "switch", str: "text", dict: "json", list: "json"}
            kind = "number" if safe == "hold" else kinds.get(type(safe), "number")
        super().__init__(topic=topic, kind=kind, **settings)
        self.safe: Any = HOLD if safe == "hold" else safe
        self.limits: tuple[float, float] | None = limits
        self.own_timeout = own_timeout
        self.retain = retain
        self.claim: str = f"the topic {topic!r}"
        self._link: MqttLink | None = None
        self._watching: asyncio.Task[None] | None = None

    @property
    def last_will(self) -> float | None:
        """When the broker publishes ``safe``: after one and a half keepalives."""
        has_one = self.safe is not HOLD and self.bus is not None
        return 1.5 * self.bus.keepalive if has_one else None

    async def open(self) -> None:
        """Connect with the last will, once the device is there if it has to say so."""
        await self._announce()
        if self.status is not None:
            inbox = await self.bus.subscribe(self.status)
            try:
                self._is_status(await heard(self, inbox, PATIENCE).__anext__())
            except BaseException:
                inbox.close()
                raise
            self._watching = watching(self, inbox, self._watch)
        if self.safe is not HOLD:
            self._link = await self.bus.connect(
                self.topic, self._encoded(self.safe), retain=self.retain
            )

    async def _watch(self, inbox: Inbox[Message]) -> None:
        async for message in inbox:
            self._is_status(message)

    async def close(self) -> None:
        """End the connection: the last will is published."""
        await ended(self._watching)
        link, self._link = self._link, None
        await self.bus.disconnect(link)

    def check(self, command: Any) -> None:
        """Refuse a command of which there is no JSON.

        Raises:
            BadValueError: It is one.
        """
        if self.kind == "json":
            self._encoded(command)

    async def write(self, command: Any) -> None:
        """Publish it, and wait until the broker has it.

        Raises:
            DeviceLostError: The broker is gone, or does not acknowledge it in time.
        """
        if command is not HOLD:
            await self.bus.publish(
                self.topic, self._encoded(command), retain=self.retain, link=self._link
            )

    def _encoded(self, command: Any) -> str:
        if self.kind == "number":
            return digits_of(command)
        if self.kind == "switch":
            return self._words[bool(command)]
        try:
            return command if self.kind == "text" else json.dumps(command)
        except (TypeError, ValueError) as error:
            raise BadValueError(self.name, "command", describe(error)) from error
