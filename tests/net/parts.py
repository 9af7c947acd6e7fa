"""Two robots and a network in memory: a base that shares, a rover that uses it."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from typing import Any

import attrs

import esair
from esair.buses.peer import FakeNetwork, PeerBus
from esair.drivers.peer import Peer, PeerActuator, PeerSensor
from esair.peers import Share, Sharing, peer_behavior
from esair.testing import FakeActuator, FakeSensor


@attrs.frozen
class Twist:
    """A motion."""

    linear: float
    angular: float


@attrs.frozen
class Docked:
    """An answer."""

    bay: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    """A request."""

    bay: int


STILL = Twist(0.0, 0.0)


class Docking(esair.Behavior):
    """Takes requests, and answers when it is told to."""

    orders = esair.takes(Dock)

    def __init__(self, *, name: str = "docking") -> None:
        super().__init__(name=name)
        self.go = asyncio.Event()
        self.begun: list[int] = []
        self.cancelled = 0

    async def run(self) -> None:
        async for request in self.orders:
            async with request:
                self.begun.append(request.bay)
                request.progress(0.5)
                try:
                    await self.go.wait()
                except asyncio.CancelledError:
                    self.cancelled += 1
                    raise
                if request.bay < 0:
                    request.refuse("there is no such bay")
                elif request.bay == 0:
                    raise ValueError("bay 0")
                else:
                    request.answer(Docked(request.bay))


class Pair:
    """A base that shares, and a rover with parts of it."""

    def __init__(
        self, *, priority: int = 5, rate: float = 100.0, **network: Any
    ) -> None:
        self.network = FakeNetwork(**network)
        self.sonar: Any = FakeSensor("sonar", 1.0)
        self.wheels = FakeActuator("wheels", safe=STILL)
        self.docking = Docking()
        self.to_rover = PeerBus(name="rover", network=self.network.of("base"))
        self.to_rover.declare(Twist)
        self.to_rover.declare(Docking)
        self.shares = [
            Share("sonar", "read", rate=rate),
            Share("wheels", "write", priority=priority),
            Share("docking", "ask"),
        ]
        self.to_base = PeerBus(name="base", network=self.network.of("rover"))

    def base(self, *behaviors: Any, resources: Any = (), **options: Any) -> esair.Robot:
        """The robot that shares."""
        return esair.Robot(
            name="base",
            resources=[
                *resources,
                *(self.sonar, self.wheels),
                Peer(name="rover", bus=self.to_rover),
            ],
            behaviors=[
                *(self.docking, *behaviors),
                Sharing(bus=self.to_rover, shares=self.shares),
            ],
            **options,
        )

    def rover(
        self, *behaviors: Any, resources: Any = (), **options: Any
    ) -> esair.Robot:
        """The robot that uses them, under other names."""
        return esair.Robot(
            name="rover",
            resources=[
                *resources,
                Peer(name="base", bus=self.to_base),
                PeerSensor(
                    name="far_sonar",
                    remote="sonar",
                    bus=self.to_base,
                    type=float,
                    link_rate=100.0,
                ),
                PeerActuator(
                    name="far_wheels", remote="wheels", bus=self.to_base, type=Twist
                ),
            ],
            behaviors=[
                *behaviors,
                peer_behavior("far_docking", self.to_base, [Dock], remote="docking"),
            ],
            **options,
        )

    @contextlib.asynccontextmanager
    async def both(self, *behaviors: Any) -> AsyncIterator[tuple[Any, Any]]:
        """Run both."""
        async with self.base() as base, self.rover(*behaviors) as rover:
            await asyncio.sleep(0.3)
            yield base, rover


class Hand(esair.Behavior):
    """A behavior in the hands of a test."""

    sonar = esair.reads(float, name="far_sonar")
    wheels = esair.writes(Twist, name="far_wheels")

    async def run(self) -> None:
        await asyncio.get_running_loop().create_future()


class Idle(esair.Behavior):
    """A behavior in the hands of a test that uses nothing."""

    async def run(self) -> None:
        await asyncio.get_running_loop().create_future()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
