"""A network in memory: peers in one process, and what goes wrong between them."""

from __future__ import annotations

import asyncio
import math
import random
from functools import partial
from typing import Final

import attrs

from esair.buses.peer._bus import PeerBus, Send
from esair.loop import Door

_AGAIN: Final = 0.2  # how long it takes until TCP sends again, in seconds


@attrs.frozen
class FakeAccess:
    """What one robot has of a `FakeNetwork`."""

    network: FakeNetwork
    me: str

    async def join(self, bus: PeerBus) -> Send:
        """Let a bus send and hear."""
        self.network.there[self.me, bus.name] = bus
        return partial(self.network.send, self.me, bus.name)

    async def leave(self, bus: PeerBus) -> None:
        """Hand on no more to a bus."""
        self.network.there.pop((self.me, bus.name), None)


class FakeNetwork:
    """A network between robots of one process, also on the virtual clock.

    Each robot makes its buses with ``network.of("its name")``. What is cut is lost; with
    ``keep=True`` it comes after the cut, all at once, as TCP does it.

    Attributes:
        delay: How long each message takes, in seconds.
        loss: Which share of the messages comes 0.2 s late, from 0 to 1, and holds up
            those behind it: TCP sends again what is lost.
        rate: How many bytes a second each way carries; what is more waits.
        deaf: Robots that hear nothing, though they are heard.
        log: Every message that was sent: who, to whom, what, and its bytes.
        there: The buses that hear: of whom, and to whom.

    Example:
        >>> network = FakeNetwork()
        >>> to_base = PeerBus(name="base", network=network.of("laptop"))
        >>> to_laptop = PeerBus(name="laptop", network=network.of("base"))
    """

    def __init__(
        self,
        *,
        delay: float = 0.0,
        loss: float = 0.0,
        rate: float = math.inf,
        seed: int = 0,
    ) -> None:
        self.delay = delay
        self.loss = loss
        self.rate = rate
        self.deaf: set[str] = set()
        self.log: list[tuple[str, str, str, bytes]] = []
        self._random = random.Random(seed)
        self.there: dict[tuple[str, str], PeerBus] = {}
        self._cut: dict[str, bool] = {}
        self._kept: list[tuple[str, str, str, bytes]] = []
        self._last: dict[tuple[str, str], float] = {}  # when a way's last one arrives

    def of(self, me: str) -> FakeAccess:
        """Return what a robot reaches its peers by."""
        return FakeAccess(self, me)

    def cut(self, *robots: str, keep: bool = False) -> None:
        """Let nothing come from or to some robots any more, or any if none is named."""
        for robot in robots or {name for pair in self.there for name in pair}:
            self._cut[robot] = keep

    def heal(self) -> None:
        """End all cuts; what was kept comes now."""
        self._cut.clear()
        kept, self._kept = self._kept, []
        for message in kept:
            self._deliver(message)

    def send(self, sender: str, to: str, what: str, data: bytes) -> None:
        """Carry a message, as well as it goes now."""
        message = sender, to, what, data
        self.log.append(message)
        del self.log[:-1000]
        cuts = [self._cut[each] for each in (sender, to) if each in self._cut]
        if cuts:
            if all(cuts):
                self._kept.append(message)
            return
        is_lost = self.loss and self._random.random() < self.loss
        self._deliver(message, _AGAIN if is_lost else 0.0)

    def _deliver(self, message: tuple[str, str, str, bytes], late: float = 0.0) -> None:
        loop = asyncio.get_running_loop()
        now, way = loop.time(), message[:2]
        at = max(now + self.delay + late, self._last.get(way, 0.0))
        at += len(message[3]) / self.rate
        if at > now:
            self._last[way] = at
            loop.call_at(at, self.inject, *message)
        else:
            self.inject(*message)

    def inject(self, sender: str, to: str, what: str, data: bytes) -> None:
        """Let a robot hear any bytes, as if another one had sent them."""
        bus = self.there.get((to, sender))
        if bus is not None and to not in self.deaf:
            door = Door.of(asyncio.get_running_loop())
            door.end(("peer", sender), bus.came, what, data)
