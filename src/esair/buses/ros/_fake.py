"""ROS in memory: a graph for tests, whose side speaks as the real one does."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, ClassVar

import attrs

from esair.buses.peer import PeerBus
from esair.buses.ros._child import BEAT, Bridge, Room, pack, unpack
from esair.loop import arrive, spawn


class FakeRos:
    """A graph of ROS without ROS, also on the virtual clock: ``Ros(links, begin=FakeRos())``.

    Attributes:
        published: What the robot has published: topic, message.
        services: What serves the robot's requests and goals, by name: an async function
            of the message and of what tells progress; it returns the response, or raises.
        begun: How often it was begun.
        others: What else is in the graph: name, type here, other type, whose.

    Example:
        >>> ros = FakeRos()
        >>> ros.publish("/cmd_vel", {"linear": {"x": 0.2}, "angular": {"z": 0.0}})
    """

    def __init__(self) -> None:
        self.published: list[tuple[str, Any]] = []
        self.services: dict[str, Callable[..., Awaitable[Any]]] = {}
        self.begun: int = 0
        self.others: list[tuple[str, str, str, str]] = []
        self.topics: set[str] = set()
        self._bridge: Bridge | None = None
        self._room = Room()
        self._frames: asyncio.Queue[list[Any] | None] = asyncio.Queue()
        self._beating: asyncio.Task[None] | None = None
        self._working: dict[int, asyncio.Task[None]] = {}
        self._stalled = False

    async def __call__(self, bus: PeerBus, setup: dict[str, Any]) -> FakeRos:
        """Begin, as a process would."""
        loop = asyncio.get_running_loop()
        self.begun += 1
        self._stalled = False
        self._room, self._frames = Room(), asyncio.Queue()

        def send(frame: list[Any]) -> bool:
            if has_room := self._room.has(frame):
                self._room.add(frame, 0)
                self._frames.put_nowait(frame)
            return has_room

        self._bridge = bridge = Bridge(send, loop.time)
        self.topics = {each["name"] for each in setup["links"]}
        bridge.begin(_Graph(self, bridge, self.topics, self._working), setup["feeds"])

        async def beat() -> None:
            while True:
                if not self._stalled:
                    bridge.tick()
                await asyncio.sleep(BEAT)

        self._beating = spawn(loop, beat(), name="ros beats")
        return self

    # What a node of ROS does.

    def publish(self, topic: str, message: Any) -> None:
        """Let the robot hear a message."""
        if self._bridge is not None and not self._stalled:
            self._bridge.heard(topic, lambda: message)

    def call(
        self,
        name: str,
        request: Any,
        progress: Callable[[Any], object] = lambda _: None,
    ) -> asyncio.Future[tuple[str, Any]]:
        """Ask the robot; how it ends, and with what. Cancelled: the goal is cancelled."""
        assert self._bridge is not None
        outcome: asyncio.Future[tuple[str, Any]]
        outcome = asyncio.get_running_loop().create_future()

        bridge = self._bridge
        about = name, request, lambda *end: arrive(outcome, end), progress
        number = bridge.asked(*about)
        outcome.add_done_callback(
            lambda done: bridge.give_up(number) if done.cancelled() else None
        )
        return outcome

    def kill(self) -> None:
        """Let it end, as a process that crashes."""
        self._stop()
        self._frames.put_nowait(None)

    def stall(self) -> None:
        """Let it hang: it says nothing, and hears nothing."""
        self._stalled = True

    # The process.

    def send(self, frame: list[Any]) -> bool:
        """Take what the robot says, as it comes out of its bytes."""
        frame = unpack(pack(frame)[4:])
        if self._bridge is not None and not self._stalled:
            self._bridge.took(frame)
        return True

    async def take(self) -> list[Any] | None:
        """Return what it says next; None when it has ended."""
        if (frame := await self._frames.get()) is not None:
            self._room.add(frame, 0, -1)
        return frame

    async def end(self) -> str:
        """End it."""
        self._stop()
        return "signal 9; it is a fake"

    def _stop(self) -> None:
        self._bridge = None
        for task in (*self._working.values(), self._beating):
            if task is not None:
                task.cancel()
        self._beating = None


@attrs.frozen
class _Graph:
    """What the robot's side asks of the graph."""

    ros: FakeRos
    bridge: Bridge
    topics: set[str]
    missing: ClassVar[dict[str, str]] = {}
    asked: dict[int, asyncio.Task[None]]

    def publish(self, topic: str, _age: float, message: Any) -> None:
        self.ros.published.append((topic, message))

    def ask(self, number: int, name: str, message: Any) -> None:
        loop = asyncio.get_running_loop()
        work = self._work(number, name, message)
        self.asked[number] = spawn(loop, work, name=f"{name} is served")

    async def _work(self, number: int, name: str, message: Any) -> None:
        say = self.bridge.say
        served = self.ros.services.get(name)
        if served is None:
            say("answer", number, "declined", f"nobody serves {name} in ROS")
            return
        try:
            answer = served(message, lambda value: say("progress", number, value))
            say("answer", number, "answered", await answer)
        except Exception as error:
            say("answer", number, "failed", str(error))
        finally:
            del self.asked[number]

    def cancel(self, number: int) -> None:
        if number in self.asked:
            self.asked[number].cancel()

    def strangers(self) -> list[tuple[str, str, str, str]]:
        others, self.ros.others = self.ros.others, []
        return others
