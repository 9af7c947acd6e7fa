"""Components that are placed in processes of their own by the tests of this folder."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import logging
import math
import os
import resource
import signal
import socket
import sys
import time
import warnings
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import attrs

import esair
import esair.minimal as emin
from esair.placement._wire import Item, Op


@attrs.frozen
class Twist:
    linear: float
    angular: float


class Leaks(esair.Behavior):
    """Has no descriptor left for what it wants to send."""

    placement = "process"

    async def run(self) -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3))
        self.offer("x" * 200_000)


class Sonar(esair.Sensor[float]):
    """Counts up, in its own process; `fault` says what it does at the third read."""

    placement = "process"
    deadline = 0.5

    def __init__(self, *, fault: str = "", at: int = 3, **settings: object) -> None:
        super().__init__(**settings)  # type: ignore[arg-type]
        self.fault = fault
        self.at = at
        self.reads = 0

    async def open(self) -> None:
        if self.fault == "open":
            raise ConnectionError("nothing is plugged in")
        if self.fault == "exit at open":
            os._exit(3)

    def read(self) -> float:
        self.reads += 1
        if self.reads == self.at:
            misbehave(self.fault)
        return float(self.reads) + 0.001 * (os.getpid() % 1 if self.fault else 0)


class Pusher(esair.Sensor[float]):
    placement = "process"

    async def stream(self) -> AsyncIterator[float]:
        value = 0.0
        while True:
            yield value
            value += 1.0
            await asyncio.sleep(0.01)


class BlockingPusher(esair.Sensor[float]):
    placement = "process"

    def stream(self) -> Iterator[float]:
        value = 0.0
        while True:
            yield value
            value += 1.0
            time.sleep(0.01)


class Clock(esair.Sensor[float]):
    """Says when it has measured; a measurement takes most of its period."""

    placement = "process"
    rate = 20.0

    def read(self) -> float:
        time.sleep(0.04)
        return time.monotonic()


class Echo(esair.Sensor[float]):
    """Waits for an echo that does not come, by the robot's clock."""

    placement = "process"
    rate = 20.0

    def read(self) -> float:
        begun = esair.now()
        while esair.now() - begun < 0.01:
            time.sleep(0.001)
        return esair.now() - begun


class Stopwatch(esair.ThreadBehavior):
    """Says how long it has computed, by the robot's clock."""

    placement = "process"

    def run(self) -> None:
        for _ in range(3):
            begun = esair.now()
            time.sleep(0.1)
            self.offer(esair.now() - begun)
        time.sleep(60.0)


class AgedClock(Clock):
    """Says how old that is, too."""

    def read(self) -> Any:
        return esair.Stamped(super().read(), age=0.0)


class PushedClock(esair.Sensor[float]):
    """The same, pushed from a thread."""

    placement = "process"
    period = 0.2

    def stream(self) -> Iterator[float]:
        while True:
            time.sleep(0.04)
            yield time.monotonic()


def misbehave(fault: str) -> None:
    """Do what a component should not."""
    if fault == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif fault == "segfault":
        ctypes.string_at(0)
    elif fault == "exit":
        os._exit(7)
    elif fault == "abort":
        os.abort()
    elif fault == "stop":
        os.kill(os.getpid(), signal.SIGSTOP)
    elif fault == "hang":
        while True:
            pass
    elif fault == "talk":
        while True:
            print("it does not end")  # noqa: T201 - it is not silent
            time.sleep(0.005)
    elif fault == "raise":
        raise ValueError("it does not work")


class Avoid(esair.Reaction):
    placement = "process"
    sonar = esair.reads(float, max_age=1.0)
    wheels = esair.writes(Twist, priority=10)

    def __init__(
        self, *, fault: str = "", at: int = 3, name: str | None = None
    ) -> None:
        super().__init__(name=name)
        self.fault = fault
        self.at = at
        self.steps = 0

    def react(self, sonar: float) -> Twist | None:
        self.steps += 1
        if self.steps == self.at:
            misbehave(self.fault)
        return Twist(0.0, 1.2) if sonar < 0.4 else None


class Drive(esair.Behavior):
    """Drives, in its own process."""

    placement = "process"
    wheels = esair.writes(Twist)

    def __init__(
        self,
        speed: float = 0.3,
        *,
        fault: str = "",
        at: int = 20,
        name: str | None = None,
    ) -> None:
        super().__init__(name=name)
        self.speed = speed
        self.fault = fault
        self.at = at

    async def run(self) -> None:
        steps = 0
        async for _ in esair.every(0.01):
            steps += 1
            if steps == self.at:
                misbehave(self.fault)
            await self.wheels.write(Twist(self.speed, 0.0))


class Writes(esair.Behavior):
    """Writes as often as it is told to, and says when it has."""

    placement = "process"
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        while True:
            _, count = await self.receive_from()
            for _ in range(count):
                await self.wheels.write(Twist(0.1, 0.0))
            self.offer(count)


class ThreadDrive(esair.ThreadBehavior):
    placement = "process"
    wheels = esair.writes(Twist)

    def run(self) -> None:
        for _ in esair.every(0.01):
            self.wheels.write(Twist(0.3, 0.0))


@attrs.frozen
class Docked:
    bay: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    bay: int


class Registers(esair.Behavior):
    """Registers the same again for each of its jobs."""

    placement = "process"

    async def run(self) -> None:
        for _ in range(50):
            port = await self.register("sonar", esair.Access.READ)
            assert await port.read() == 1.0
        self.offer("done")
        await asyncio.sleep(60.0)


class Impatient(esair.Behavior):
    """Waits for a moment at a time, in one of three ways; offers what it has got."""

    placement = esair.Placement(stall=0.5)
    restart = esair.Restart(max=100, within=10)
    orders = esair.takes(Dock)
    inbox_size = 200
    outbox_size = 200

    def __init__(self, way: str, patience: float, *, name: str | None = None) -> None:
        super().__init__(name=name)
        self.way = way
        self.patience = patience

    async def run(self) -> None:
        orders = aiter(self.orders)
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self.patience):
                    if self.way == "receive":
                        got = await self.receive()
                    elif self.way == "get":
                        got = await self.get("source", 60.0)
                    else:
                        got = await anext(orders)
                if self.way == "ask":
                    async with got:
                        got.answer(Docked(got.data.bay))
                else:
                    self.offer(got)


class Docking(esair.Behavior):
    placement = "process"
    orders = esair.takes(Dock)

    async def run(self) -> None:
        async for request in self.orders:
            async with request:
                request.progress(0.5)
                await asyncio.sleep(0.01)
                if request.bay < 0:
                    request.refuse("no such bay")
                else:
                    request.answer(Docked(request.bay))


class OneByOne(Docking):
    """Begins a loop for each request; goes on with it after the loop."""

    async def run(self) -> None:
        while True:
            request = await anext(aiter(self.orders))
            async with request:
                request.answer(Docked(request.bay))


class Answering(esair.Behavior):
    placement = "process"

    @esair.answers
    async def dock(self, request: Dock) -> Docked:
        return Docked(request.bay)

    async def provide(self) -> Twist:
        return Twist(1.0, 2.0)


class Wanderer(esair.Behavior):
    """Draws random numbers, sleeps, and asks for time: all that could differ."""

    placement = "process"
    sonar = esair.reads(float)
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self.turn())
            async for _ in esair.every(0.05):
                far = await self.sonar.read()
                await self.wheels.write(
                    Twist(far * esair.random.uniform(0.1, 0.3), 0.0)
                )

    async def turn(self) -> None:
        begin = esair.now()
        while True:
            await asyncio.sleep(0.033)
            await self.wheels.write(Twist(0.0, round(esair.now() - begin, 3)))


class Unsendable(esair.Behavior):
    placement = "process"

    def __init__(self, function: Callable[[], None]) -> None:
        super().__init__()
        self.function = function


class Turn(esair.Reaction):
    """A step of another one: it turns, and misbehaves at its third decision."""

    sonar = esair.reads(float)
    wheels = esair.writes(Twist)

    def __init__(self, fault: str) -> None:
        super().__init__()
        self.fault = fault
        self.steps = 0

    def react(self, sonar: float) -> Twist:
        self.steps += 1
        if self.steps == 3:
            misbehave(self.fault)
        return Twist(0.0, 0.5)


class Watch(esair.Reaction):
    wheels = esair.guards(Twist)

    def react(self, wheels: Twist) -> Twist:
        return wheels


class Performer(esair.Behavior):
    """Performs what it should not: a guard, a step that dies, a lie."""

    placement = "process"
    wheels = esair.writes(Twist)

    def __init__(self, act: str) -> None:
        super().__init__()
        self.act = act

    async def run(self) -> None:
        child: Any = self._host._child
        if self.act == "guard":
            await self.perform(Watch())
        elif self.act == "local":

            class Local(esair.Behavior):
                pass

            await self.perform(Local())
        elif self.act == "function":
            told = {"module": "os", "class": "abort", "args": (), "options": {}}
            await child.call("step", told)
        elif self.act == "constructor":
            told = {"module": "os", "class": "PathLike", "args": (), "options": {}}
            await child.call("manage", "add", told)
        elif self.act == "nonsense":
            await child.call("step", 3)
        elif self.act.startswith("limits"):
            limits = {
                "for ever": (math.nan, None),
                "blind": (None, -1.0),
                "one": (1.0,),
            }
            wrong = limits[self.act.removeprefix("limits ")]
            await child.call("perform", child.recipe(Turn("")), False, *wrong)
        elif self.act == "verdict":
            child._at_once["react"] = lambda *_: 7  # no decision and verdict
            await self.perform(Turn(""))
        elif self.act == "stage":
            child.wait("stage", 99)
            child.wait("stage", 99)
            await self.wheels.write(Twist(0.7, 0.0))
        else:
            await self.perform(Turn(self.act))


class Loaded(esair.Behavior):
    """Puts which modules of esair its process had to load, beside what it began with."""

    placement = "process"

    async def run(self) -> None:
        import esair.testing  # noqa: F401

        names = list(sys.modules)
        own = names[names.index(__name__) :]
        await self.put("taker", [each for each in own if each.startswith("esair.")])


class Talker(esair.Behavior):
    placement = "process"

    async def run(self) -> None:
        print("it prints")  # noqa: T201
        logging.getLogger("rover.parts").warning("it logs %d", 3)
        print(f"it was called with {sys.argv!r}", flush=True)  # noqa: T201
        warnings.warn("it warns", stacklevel=1)
        breakpoint()


class Liar(esair.Behavior):
    """Speaks with the robot as no child should."""

    placement = "process"
    wheels = esair.writes(Twist)

    def __init__(self, lie: str) -> None:
        super().__init__()
        self.lie = lie

    async def run(self) -> None:
        child: Any = self._host._child
        wire: Any = child._wire
        bad = {
            "verb": Item(Op.CALL, 9, "__class__", b""),
            "port": Item(Op.CALL, 9, "read :wheels", child.pack("x", ("nonsense",))),
            "time": Item(Op.CALL, 9, "write :wheels", b"", worked=math.nan),
            "early": Item(Op.CALL, 9, "write :wheels", b"", worked=-1.0),
            "method": Item(b"?", 9, "read :wheels", b"nonsense"),
            "private": Item(Op.CALL, 9, "next_order", child.pack("x", 1)),
        }
        if self.lie in bad:
            child.queue.append(bad[self.lie])
        elif self.lie == "garbage":
            wire._end.send(b"\x01garbage")
        elif self.lie == "flood":
            for _ in range(100):
                wire.send(Op.TICK, 0.0)
        elif self.lie == "turn":
            wire.send(Op.IDLE, math.inf)
            wire.send(Op.IDLE, math.inf)
        elif self.lie == "files":
            read, _ = os.pipe()
            socket.send_fds(wire._end, [b"\0"], [read])
        await asyncio.sleep(1.0)


class SmallSonar(emin.Sensor):
    placement = "process"

    def read(self) -> float:
        return 0.2


class SmallAvoid(emin.Reaction):
    """Written for a board; here it has a process."""

    placement = "process"
    sonar = emin.reads(float)
    wheels = emin.writes(float, priority=10)

    def __init__(self, turn: float) -> None:
        self.turn = turn

    def react(self, sonar: float) -> float | None:
        return self.turn if sonar < 0.4 else None
