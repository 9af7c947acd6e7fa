"""A device that publishes by MQTT what it measures, and does what it is told."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from esair.buses.mqtt import FakeMqtt, Message


class FakeThing:
    """Publishes its values, its status too, and obeys.

    Args:
        bus: The broker that it is on.
        values: What it publishes, by topic.
        commands: The topics that it listens to.
        status: The topic of its last will.
        period: After how many seconds it publishes its values again.

    Attributes:
        values: What it publishes now; change it.
        told: What it was told last, by topic.
    """

    def __init__(
        self,
        bus: FakeMqtt,
        values: Mapping[str, str] | None = None,
        commands: tuple[str, ...] = (),
        *,
        status: str = "thing/status",
        period: float = 0.05,
    ) -> None:
        self.values: dict[str, str] = dict(values or {})
        self.told: dict[str, str] = {}
        self._commands = commands
        self._bus = bus
        self._status = status
        self._period = period
        self._timer: asyncio.TimerHandle | None = None
        bus.on_message(self._heard)
        self.start()

    def start(self) -> None:
        """Have power."""
        self.stop()
        self._bus.feed(self._status, "online", retain=True)
        self._report()

    def stop(self) -> None:
        """Lose the power: its last will is published."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
            self._bus.feed(self._status, "offline", retain=True)

    def power_cycle(self) -> None:
        """Lose the power for a moment: what it was told is forgotten."""
        self.stop()
        self.told.clear()
        self._timer = asyncio.get_running_loop().call_later(1.0, self.start)

    def _report(self) -> None:
        for topic, value in self.values.items():
            self._bus.feed(topic, value)
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(self._period, self._report)

    def _heard(self, message: Message) -> None:
        if self._timer is not None and message.topic in self._commands:
            self.told[message.topic] = message.payload.decode()
