"""Components of random robots, which do what their dice say; a process imports only these.

What they know begins with each life, as that of a process does. They and their devices
take their time, each its own: nothing falls on one moment by chance.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
from collections.abc import AsyncIterator
from typing import Any

import attrs

import esair

Effect = tuple[float, str, Any]
"""When something was seen, in seconds, where, and what."""

EXPECTED = (esair.EsairError, TimeoutError, ExceptionGroup)
"""What an act may end with; the behavior goes on with the next."""

INITIAL = 0.5


@attrs.frozen
class Job(esair.Request[float]):
    """Work for a while."""

    seconds: float


class WorldError(Exception):
    """Code of a component has failed."""


@attrs.frozen
class Ports:
    """What an action reads and writes, as plain data: a process is made of that."""

    eye: str
    wheel: str
    priority: int = 0
    blind: str | None = None
    sets: bool = False

    @property
    def needs(self) -> dict[str, Any]:
        """What its class declares, for this one."""
        eye = esair.reads(float, name=self.eye, max_age=0.43, configure=self.sets)
        terms: Any = {"priority": self.priority, "blind": self.blind}
        wheel = esair.writes(float, name=self.wheel, **terms)
        return {"reads": {"eye": eye}, "writes": {"wheel": wheel}}


# Devices.


class Wheel(esair.Actuator[float]):
    """Notes what it is told, and when; one may be slow."""

    safe = 0.0
    command_timeout = 0.31
    takes_seconds = 0.0
    effects: list[Effect]

    async def write(self, command: float) -> None:
        if self.takes_seconds:
            await asyncio.sleep(self.takes_seconds)
        self.effects.append((esair.now(), self.name, command))


class Counts(esair.Sensor[float]):
    """Its values follow from their number; it may fail for some."""

    def __init__(self, fails: tuple[int, int], **settings: Any) -> None:
        super().__init__(**settings)
        self.fails = fails

    async def open(self) -> None:
        self.reads = 0  # a process that is new knows of nothing

    def next(self) -> float:
        self.reads += 1
        if self.fails[0] <= self.reads < self.fails[1]:
            raise OSError(5, "it says nothing")
        return INITIAL + 0.4 * math.sin(self.reads * 0.7071)


class Waves(Counts):
    """Polled."""

    async def read(self) -> float:
        await asyncio.sleep(0.00137)
        return self.next()


class PlainWaves(Counts):
    """Read in a thread of its own, or in its process."""

    def read(self) -> float:
        return self.next()


class Pushes(Counts):
    """Pushes each value."""

    def __init__(self, fails: tuple[int, int], pause: float, **settings: Any) -> None:
        super().__init__(fails, **settings)
        self.pause = pause

    async def stream(self) -> AsyncIterator[float]:
        while True:
            await asyncio.sleep(self.pause)
            yield self.next()


# Actions.


class Follows(esair.Reaction):
    """Decides by what it sees, its clock and its dice; some readings make it fail."""

    restart = esair.Restart(max=2, within=0.4, delay=0.1234)
    eye = esair.reads(float)
    wheel = esair.writes(float)

    def __init__(self, name: str, ports: Ports, fails_at: float) -> None:
        super().__init__(name=name, **ports.needs)
        self.fails_at = fails_at

    def react(self, eye: float) -> float | None:
        if abs(eye - self.fails_at) < 0.01:
            raise WorldError("step")
        if eye < INITIAL - 0.2:
            return None
        return round(eye + esair.random.uniform(0.1, 0.2) + self.now_ms % 7, 6)


class Guard(esair.Reaction):
    """Never placed; lets half of it pass while something is near."""

    eye = esair.reads(float)
    wheel = esair.guards(float)

    def react(self, eye: float, wheel: float) -> float | None:
        return wheel if eye > INITIAL else wheel / 2


class Listens(esair.Behavior):
    """Never placed: notes what others tell it, and when."""

    inbox_size = 1000

    def __init__(self, effects: list[Effect]) -> None:
        super().__init__()
        self.effects = effects

    async def run(self) -> None:
        while True:
            sender, data = await self.receive_from()
            self.effects.append((esair.now(), sender, data))


class Step(esair.Behavior):
    """What others perform: it drives for a while, and may fail."""

    wheel = esair.writes(float)

    def __init__(self, ports: Ports, seconds: float, fails: bool) -> None:
        super().__init__(writes=ports.needs["writes"])
        self.seconds, self.fails = seconds, fails

    async def run(self) -> float:
        await self.wheel.write(self.seconds)
        await asyncio.sleep(self.seconds)
        if self.fails:
            raise WorldError("performed")
        return self.seconds


class StepReaction(esair.Reaction):
    """A reaction that others perform."""

    eye = esair.reads(float)
    wheel = esair.writes(float)

    def __init__(self, ports: Ports) -> None:
        super().__init__(**ports.needs)

    def react(self, eye: float) -> float:
        return eye


ACTS = (
    *("drives", "drives", "drives", "writes", "writes", "reads", "reads_anew"),
    *("looks", "releases", "asks", "asks", "puts", "receives", "gets", "offers"),
    *("performs", "reacts", "waits", "fails"),
)


class Roams(esair.Behavior):
    """Does one thing after the other, as its dice say; tells what came of it."""

    restart = esair.Restart(max=3, within=0.4, delay=0.0873)
    inbox_size = 3
    inbox_policy = "drop_oldest"
    eye = esair.reads(float)
    wheel = esair.writes(float)
    jobs = esair.takes(Job, queue=2)
    acts: tuple[str, ...] = ACTS

    def __init__(self, name: str, ports: Ports, seed: int, friend: str) -> None:
        super().__init__(name=name, **ports.needs)
        self.ports, self.seed, self.friend = ports, seed, friend

    async def run(self) -> None:
        self.dice = random.Random(self.seed)  # a process that is new knows of nothing
        await asyncio.sleep(self.dice.uniform(0.0, 0.05))  # others begin now, too
        async with asyncio.TaskGroup() as group:
            if self.seed % 3:
                group.create_task(self.serve())
            if self.seed % 5 == 0:
                group.create_task(self.look())
            while True:
                act = self.dice.choice(self.acts)
                try:
                    told = await getattr(self, act)()
                except EXPECTED as error:
                    told = said(error)
                await self.tell(act, told)
                await asyncio.sleep(esair.random.uniform(0.01, 0.07))

    async def tell(self, act: str, told: Any) -> None:
        with contextlib.suppress(esair.UnknownNameError):  # it stops first
            await self.put("listens", (act, round(esair.now(), 6), told), 0.5)

    async def serve(self) -> None:
        async for job in self.jobs:
            with contextlib.suppress(WorldError):
                async with job:
                    job.progress(esair.random.uniform(0.0, 1.0))
                    await asyncio.sleep(job.data.seconds)
                    mood = self.dice.random()
                    if mood < 0.6:
                        job.answer(round(job.data.seconds + mood, 6))
                    elif mood < 0.8:
                        job.refuse("not now")
                    else:
                        raise WorldError("work")

    async def look(self) -> None:
        while True:
            try:
                async for value in self.eye:
                    if value > INITIAL + 0.35:
                        await self.tell("look", value)
            except EXPECTED as error:
                await self.tell("look", said(error))
            await asyncio.sleep(0.1571)

    # Acts.

    async def drives(self) -> Any:
        steps = self.dice.randint(2, 6)
        taken = 0
        async for tick in esair.every(self.dice.uniform(0.02, 0.06)):
            steps -= 1
            taken += bool(await self.wheel.write(round(tick + self.dice.random(), 6)))
            if not steps:
                break
        return taken

    async def writes(self) -> Any:
        told = await self.wheel.write(esair.random.uniform(-1.0, 1.0))
        return bool(told)

    async def reads(self) -> Any:
        return await self.eye.read()

    async def reads_anew(self) -> Any:
        return await self.eye.read(fresh=True, timeout=0.2113)

    async def looks(self) -> Any:
        newest = self.eye.newest
        return None if newest is None else (newest.value, round(newest.time, 6))

    async def releases(self) -> Any:
        self.wheel.release()
        return self.wheel.why().holder

    async def asks(self) -> Any:
        news: list[Any] = []
        job = Job(self.dice.uniform(0.01, 0.2))
        limit = self.dice.uniform(0.05, 0.4)
        answer = await self.ask(
            self.friend, job, timeout=limit, progress=lambda each: news.append(each)
        )
        return answer, news

    async def puts(self) -> Any:
        return await self.put(self.friend, self.dice.random(), 0.1)

    async def receives(self) -> Any:
        return list(await self.receive_from(timeout=0.1173))

    async def gets(self) -> Any:
        return await self.get(self.friend, 0.0937)

    async def offers(self) -> Any:
        return self.offer(self.dice.random(), latest=True)

    async def performs(self) -> Any:
        seconds, fails = self.dice.uniform(0.01, 0.2), self.dice.random() < 0.3
        step = Step(self.ports, seconds, fails)
        try:
            return await self.perform(step, timeout=0.1511)
        except WorldError as error:
            return said(error)

    async def reacts(self) -> Any:
        step = StepReaction(self.ports)
        limit = self.dice.uniform(0.05, 0.3)
        high = self.dice.uniform(INITIAL, INITIAL + 0.5)
        return await self.perform(
            step, until=lambda eye: eye > high, timeout=limit, blind_timeout=0.3
        )

    async def waits(self) -> Any:
        await asyncio.sleep(esair.random.uniform(0.05, 0.3))

    async def fails(self) -> Any:
        if self.dice.random() < 0.3:
            raise WorldError("act")


class PlainRoams(esair.ThreadBehavior):
    """The same in a thread, with what it has."""

    restart = esair.Restart(max=3, within=0.4, delay=0.0773)
    eye = esair.reads(float)
    wheel = esair.writes(float)

    def __init__(self, name: str, ports: Ports, seed: int, friend: str) -> None:
        super().__init__(name=name, **ports.needs)
        self.ports, self.seed, self.friend = ports, seed, friend

    def run(self) -> None:
        self.dice = random.Random(self.seed)
        for tick in esair.every(self.dice.uniform(0.03, 0.08)):
            if not tick:
                continue  # others begin now, too
            act = self.dice.choice(PLAIN_ACTS)
            try:
                told = getattr(self, act)(tick)
            except EXPECTED as error:
                told = said(error)
            with contextlib.suppress(esair.UnknownNameError):
                self.put("listens", (act, round(esair.now(), 6), told), 0.5)

    def drives(self, tick: float) -> Any:
        return bool(self.wheel.write(round(tick + esair.random.random(), 6)))

    def reads(self, _: float) -> Any:
        return self.eye.read()

    def asks(self, _: float) -> Any:
        job = Job(self.dice.uniform(0.01, 0.2))
        return self.ask(self.friend, job, timeout=self.dice.uniform(0.05, 0.4))

    def performs(self, _: float) -> Any:
        return self.perform(Step(self.ports, 0.0619, False))

    def fails(self, _: float) -> Any:
        if self.dice.random() < 0.3:
            raise WorldError("act")


PLAIN_ACTS = ["drives", "drives", "drives", "reads", "asks", "performs", "fails"]


def said(error: BaseException) -> Any:
    """Return what is told of an error: its class and its words."""
    if isinstance(error, BaseExceptionGroup):
        return [said(each) for each in error.exceptions]
    return type(error).__name__, str(error)
