"""A robot that is a citizen of ROS: what the tests of it have in common."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterable
from typing import Any

import attrs

import esair
from esair.buses.peer import PeerBus
from esair.buses.ros import FakeRos, Link, Ros, form_of
from esair.drivers.peer import Peer, PeerSensor
from esair.peers import Drive, Share, Sharing, peer_behavior
from esair.testing import FakeActuator, FakeSensor

TWIST = "geometry_msgs/msg/Twist"


@attrs.frozen
class Motion:
    """The robot's own class of commands."""

    linear: float
    angular: float


STILL = Motion(0.0, 0.0)


@attrs.frozen
class Done:
    """A response, by the names that it has in ROS."""

    success: bool
    message: str


@attrs.frozen
class Light(esair.Request[Done]):
    """``std_srvs/srv/SetBool``."""

    on: bool  # ROS calls it data, which every request here has


@attrs.frozen
class Count(esair.Request[tuple[int, ...]]):
    """``test_msgs/action/Fibonacci``."""

    order: int


class Lamp(esair.Behavior):
    """Takes what ROS asks for."""

    lights = esair.takes(Light)
    counts = esair.takes(Count)

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Any] = []
        self.cancelled = 0
        self.go = asyncio.Event()

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._light())
            tasks.create_task(self._count())

    async def _light(self) -> None:
        async for request in self.lights:
            async with request:
                self.seen.append(request.data)
                if request.data.on:
                    request.answer(Done(True, "lit"))
                else:
                    request.refuse("it stays lit")

    async def _count(self) -> None:
        async for request in self.counts:
            with contextlib.suppress(esair.EsairError):
                async with request:
                    self.seen.append(request.data)
                    request.progress({"sequence": [0, 1]})
                    try:
                        await self.go.wait()
                    except asyncio.CancelledError:
                        self.cancelled += 1
                        raise
                    request.answer((0, 1, 1, 2))


class Beating(esair.Behavior):
    """Works fifty times a second, and keeps how late it was."""

    late: list[float]

    async def run(self) -> None:
        self.late = []
        loop = asyncio.get_running_loop()
        due = loop.time()
        async for _ in esair.every(0.02):
            self.late.append(loop.time() - due)
            due = loop.time() + 0.02


def drive(topic: str, actuator: str = "wheels", priority: int = 5) -> tuple[Any, ...]:
    """A topic that drives an actuator: its link, its sensor and its behavior."""
    name = topic.strip("/").replace("/", "_")
    link = Link(topic, TWIST, "topic", "in", name, form_of(TWIST, Motion))
    return (
        link,
        name,
        Drive(topic=topic, sensor=name, actuator=actuator, priority=priority),
    )


class Citizen:
    """The robot, and the bus to ROS."""

    def __init__(
        self, begin: Any = None, topics: Iterable[str] = ("/cmd_vel",)
    ) -> None:
        self.fake = FakeRos()
        self.wheels = FakeActuator("wheels", safe=STILL, command_timeout=0.2)
        self.sonar: Any = FakeSensor("sonar", 0.7)
        self.lamp = Lamp()
        drives = [drive(each, priority=5 + n) for n, each in enumerate(topics)]
        self.network = Ros(
            [
                *(link for link, _, _ in drives),
                self.heard("/range", "std_msgs/msg/Float32"),
                self.out("/sonar", "std_msgs/msg/Float32", "sonar", 50.0),
                self.call("/light", "in", "lamp", "std_srvs/srv/SetBool", Light),
                self.call("/count", "in", "lamp", "test_msgs/action/Fibonacci", Count),
                self.call("/far_light", "out", "far", "std_srvs/srv/SetBool", Light),
                self.call(
                    "/far_count", "out", "far", "test_msgs/action/Fibonacci", Count
                ),
            ],
            me="rover",
            begin=begin or self.fake,
        )
        self.bus = PeerBus(name="ros", network=self.network)
        self.sensors = [
            Peer(name="ros", bus=self.bus),
            self.sensor("range", "/range"),
            *(self.sensor(name, link.name) for link, name, _ in drives),
        ]
        self.behaviors = [
            *(each for _, _, each in drives),
            self.lamp,
            Sharing(
                bus=self.bus,
                shares=[Share("sonar", "read", rate=50.0), Share("lamp", "ask")],
            ),
            peer_behavior("far_light", self.bus, [Light], remote="/far_light"),
            peer_behavior("far_count", self.bus, [Count], remote="/far_count"),
        ]

    @staticmethod
    def heard(name: str, kind: str, form: Any = None, latched: bool = False) -> Link:
        part = name.strip("/")
        return Link(
            name, kind, "topic", "in", part, form or form_of(kind), latched=latched
        )

    @staticmethod
    def out(name: str, kind: str, part: str, rate: float = 20.0, **of: Any) -> Link:
        return Link(name, kind, "topic", "out", part, form_of(kind, **of), rate=rate)

    @staticmethod
    def call(name: str, flow: Any, part: str, kind: str, request: Any) -> Link:
        is_count = request is Count
        answer = form_of(kind, None, "sequence") if is_count else form_of(kind, Done)
        word: Any = "action" if is_count else "service"
        form = form_of(kind, request, None if is_count else {"on": "data"})
        return Link(name, kind, word, flow, part, form, answer)

    def sensor(self, name: str, topic: str, kind: Any = Any) -> PeerSensor:
        """A sensor that hears a topic."""
        return PeerSensor(
            name=name, bus=self.bus, remote=topic, type=kind, link_rate=200.0
        )

    def robot(
        self, *behaviors: Any, resources: Any = (), **options: Any
    ) -> esair.Robot:
        return esair.Robot(
            name="rover",
            resources=[self.wheels, self.sonar, *self.sensors, *resources],
            behaviors=[*self.behaviors, *behaviors],
            **options,
        )

    @contextlib.asynccontextmanager
    async def running(
        self, *behaviors: Any, **options: Any
    ) -> AsyncIterator[esair.Robot]:
        """Run it on the fake, and let it be there."""
        async with self.robot(*behaviors, **options) as robot:
            await asyncio.sleep(1.0)
            yield robot


def twist(linear: float, angular: float = 0.0) -> dict[str, Any]:
    """What ROS publishes."""
    return {
        "linear": {"x": linear, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": angular},
    }
