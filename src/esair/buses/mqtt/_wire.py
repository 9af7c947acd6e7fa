"""What goes through a broker, and how a bus reaches one."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import NamedTuple, Protocol

from esair.buses._bus import Wire


class Message(NamedTuple):
    """A message that a broker has passed on.

    Attributes:
        topic: What it is about, such as ``"garden/pump"``.
        payload: What it says.
        retained: Whether the broker had kept it: nobody knows how old it is.
    """

    topic: str
    payload: bytes
    retained: bool = False


class MqttLink(Protocol):
    """One connection to a broker."""

    async def publish(self, message: Message, timeout: float) -> None:
        """Hand a message over; the broker has acknowledged it when this returns."""

    async def subscribe(self, pattern: str, timeout: float) -> None:
        """Have what fits a pattern from now on, and what the broker has kept of it."""

    async def close(self) -> None:
        """End it without a farewell: its last will is published. Does not wait long."""


class MqttWire(Wire, abc.ABC):
    """A broker, as a bus reaches it."""

    @abc.abstractmethod
    async def connect(
        self,
        heard: Callable[[Message], None],
        gone: Callable[[BaseException], None],
        will: Message | None,
    ) -> MqttLink:
        """Connect; raise an `OSError` if that fails."""


def matches(pattern: str, topic: str) -> bool:
    """Tell whether a topic fits a pattern, whose levels may be ``+`` or a last ``#``."""
    if topic[:1] == "$" and pattern[:1] in {"+", "#"}:
        return False
    there = topic.split("/")
    for n, level in enumerate(wanted := pattern.split("/")):
        if level == "#":
            return True
        if n >= len(there) or level not in {"+", there[n]}:
            return False
    return len(wanted) == len(there)
