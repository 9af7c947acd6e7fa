"""Random robots that live twice: as tasks alone, and with some of them in processes.

A robot, what it does and what is done to it follow from a number.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from typing import Any

from tests.placement.roamers import (
    EXPECTED,
    Effect,
    Follows,
    Guard,
    Job,
    Listens,
    PlainRoams,
    PlainWaves,
    Ports,
    Pushes,
    Roams,
    Waves,
    Wheel,
    said,
)
from tests.placement.wanderers import (
    Bursts,
    Errand,
    LatchGuard,
    Operated,
    PlainOperated,
    Slows,
    Wanders,
)

import esair
from esair.testing import VirtualLoop
from esair.torture._patience import virtual_sleep

LASTS = 1.5
"""How long a robot lives, in seconds."""


class World:
    """One robot of a number, and what is done to it."""

    def __init__(self, seed: int, *, placed: bool) -> None:
        self.dice = random.Random(seed)
        self.seed = seed
        self.placed = placed
        self.effects: list[Effect] = []
        self._places = random.Random(f"{seed} places")
        self._makers: dict[str, Callable[[], Any]] = {}
        self._where: dict[str, bool] = {}
        self._design()

    def _design(self) -> None:
        dice = self.dice
        self.wheels = [f"wheel_{n}" for n in range(dice.randint(2, 3))]
        self.eyes = [f"eye_{n}" for n in range(dice.randint(2, 3))]
        # Who moves the same by the same reading does so in one moment.
        self._pairs = [(eye, wheel) for eye in self.eyes for wheel in self.wheels]
        dice.shuffle(self._pairs)
        self.roams = [f"roams_{n}" for n in range(dice.randint(2, 3))]
        most = min(2, len(self._pairs) - len(self.roams))
        self.follows = [f"follows_{n}" for n in range(dice.randint(0, most))]
        for name in self.wheels:
            self._makers[name] = self._wheel(name)
        for name in self.eyes:
            self._makers[name] = self._eye(name)
        for name in self.follows:
            self._makers[name] = self._reaction(name)
        for number, name in enumerate(self.roams):
            friend = self.roams[(number + 1) % len(self.roams)]
            self._makers[name] = self._behavior(name, friend)
        self.guards = ["guard"] if dice.random() < 0.4 else []
        if self.guards:
            self._makers["guard"] = self._guard()
        self._makers["listens"] = lambda: Listens(self.effects)
        may = [*self.eyes, *self.follows, *self.roams]
        self._where = {name: self._places.random() < 0.5 for name in may}
        self._where[self._places.choice(may)] = True

    @property
    def places(self) -> list[str]:
        """Who has a process in the second life."""
        return [name for name, has in self._where.items() if has]

    def make(self, name: str) -> Any:
        """Return a new component of a name."""
        made = self._makers[name]()
        if self.placed and self._where.get(name):
            made.placement = "process"
        return made

    def _wheel(self, name: str) -> Callable[[], Any]:
        slow = self.dice.choice([0.0, 0.0, self.dice.uniform(0.002, 0.02)])

        def make() -> Any:
            made = Wheel(name=name)
            made.effects, made.takes_seconds = self.effects, slow
            return made

        return make

    def _eye(self, name: str) -> Callable[[], Any]:
        dice = self.dice
        kind: Any = dice.choice([Waves, PlainWaves, Pushes])
        begin = dice.randint(5, 40)
        fails = (begin, begin + 3) if dice.random() < 0.3 else (0, 0)
        pace = dice.uniform(11.0, 31.0)  # its own: two devices never fall on one moment
        terms = {"pause": 1.0 / pace} if kind is Pushes else {"rate": pace}
        return lambda: kind(fails, name=name, **terms)

    def _reaction(self, name: str) -> Callable[[], Any]:
        dice = self.dice
        ports = self._ports(blind=dice.choice(["safe", "release"]))
        fails_at = dice.choice([9.0, 9.0, dice.uniform(0.1, 0.9)])
        rate = dice.choice([None, dice.uniform(9.0, 23.0)])

        def make() -> Any:
            made = Follows(name, ports, fails_at)
            if rate is not None:
                made.rate = rate
            return made

        return make

    def _behavior(self, name: str, friend: str) -> Callable[[], Any]:
        kind: Any = self.dice.choice([Roams, Roams, Roams, PlainRoams])
        ports, seed = self._ports(), self.dice.randrange(1000)
        return lambda: kind(name, ports, seed, friend)

    def _ports(self, **terms: Any) -> Ports:
        eye, wheel = self._pairs.pop()
        return Ports(eye, wheel, self.dice.randrange(6), **terms)

    def _guard(self) -> Callable[[], Any]:
        eye, wheel = self.dice.choice(self.eyes), self.dice.choice(self.wheels)
        reads = {"eye": esair.reads(float, name=eye, max_age=0.5)}
        guards = {"wheel": esair.guards(float, name=wheel)}
        return lambda: Guard(name="guard", reads=reads, guards=guards)

    async def live(self) -> list[Effect]:
        """Let it live; return all that was seen of it."""
        dice = self.dice
        actions = ["listens", *self.guards, *self.follows, *self.roams]
        modes: dict[str, list[str]] = {}
        if dice.random() < 0.5:
            always = ["listens", *self.guards]
            for mode in ("one", "two"):
                some = [n for n in self.roams + self.follows if dice.random() < 0.6]
                modes[mode] = [*always, *some]
        robot = esair.Robot(
            resources=[self.make(name) for name in [*self.wheels, *self.eyes]],
            behaviors=[self.make(name) for name in actions],
            seed=self.seed,
            grace=0.5,
            modes=modes or None,
            mode="one" if modes else None,
        )
        async with asyncio.TaskGroup() as group, robot:
            end = esair.now() + LASTS
            while esair.now() < end:
                await asyncio.sleep(dice.uniform(0.05, 0.5))
                act = dice.choice(self._acts(bool(modes)))
                group.create_task(self._done(act, robot))
            self._look(robot)
        return sorted(self.effects, key=self._order)

    def _order(self, effect: Effect) -> tuple[float, str, str]:
        """Sort by time and place; two tasks of one behavior tell what they do in any order."""
        when, where, what = effect
        return round(when, 4), where, repr(what) if where in self.roams else ""

    def _look(self, robot: esair.Robot) -> None:
        """Note how each component is at the end."""
        for supervisor in (robot.behaviors, robot.resources):
            for name in supervisor.names():
                status: Any = supervisor.query(name)
                error = None if status.error is None else said(status.error)
                counts = getattr(status, "restarts", None), getattr(status, "losses", 0)
                told = name, status.state.value, error, counts
                self.effects.append((esair.now(), "status", told))

    def _acts(self, has_modes: bool) -> list[str]:
        acts = ["restart", "remove", "replace", "ask", "ask", "put", "halt"]
        return acts + ["mute"] * len(self.guards) + ["switch"] * has_modes

    async def _done(self, act: str, robot: esair.Robot) -> None:
        """Do something to the robot, and note what came of it."""
        dice = random.Random(self.dice.random())
        try:
            told = await getattr(self, f"_{act}")(robot, dice)
        except EXPECTED as error:
            told = said(error)
        self.effects.append((asyncio.get_running_loop().time(), "user", (act, told)))

    def _one(self, robot: esair.Robot, dice: random.Random) -> tuple[Any, str]:
        name = dice.choice([*self.eyes, *self.follows, *self.roams])
        return robot.resources if name in self.eyes else robot.behaviors, name

    async def _restart(self, robot: esair.Robot, dice: random.Random) -> Any:
        supervisor, name = self._one(robot, dice)
        return name, await supervisor.restart(name)

    async def _remove(self, robot: esair.Robot, dice: random.Random) -> Any:
        supervisor, name = self._one(robot, dice)
        left = await supervisor.remove(name)
        await asyncio.sleep(dice.uniform(0.05, 0.2))
        await supervisor.add(self.make(name))
        return name, left

    async def _replace(self, robot: esair.Robot, dice: random.Random) -> Any:
        supervisor, name = self._one(robot, dice)
        return name, await supervisor.replace(name, self.make(name))

    async def _ask(self, robot: esair.Robot, dice: random.Random) -> Any:
        name, job = dice.choice(self.roams), Job(dice.uniform(0.01, 0.2))
        return await robot.behaviors.ask(
            job, sender="user", receiver=name, timeout=dice.uniform(0.05, 0.5)
        )

    async def _put(self, robot: esair.Robot, dice: random.Random) -> Any:
        name = dice.choice(self.roams)
        await robot.behaviors.put(dice.random(), sender="user", receiver=name)

    async def _halt(self, robot: esair.Robot, dice: random.Random) -> Any:
        await robot.halt("by the user")
        await asyncio.sleep(dice.uniform(0.05, 0.2))
        robot.resume()

    async def _mute(self, robot: esair.Robot, dice: random.Random) -> Any:
        robot.behaviors.mute("guard", dice.uniform(0.05, 0.5), "by the user")

    async def _switch(self, robot: esair.Robot, dice: random.Random) -> Any:
        mode = dice.choice(["one", "two"])
        await robot.behaviors.switch(mode)
        return mode


class WideWorld(World):
    """A robot that does more of what a robot may do, half of it at once."""

    def _eye(self, name: str) -> Callable[[], Any]:
        dice = self.dice
        kind: Any = dice.choice([Operated, Operated, PlainOperated, Bursts])
        begin = dice.randint(5, 40)
        fails = (begin, begin + 3) if dice.random() < 0.3 else (0, 0)
        pace = dice.uniform(11.0, 31.0)
        terms = {"pause": 1.0 / pace} if kind is Bursts else {"rate": pace}
        return lambda: kind(fails, name=name, **terms)

    def _reaction(self, name: str) -> Callable[[], Any]:
        dice = self.dice
        ports = self._ports(blind=dice.choice(["safe", "release"]))
        rate = dice.uniform(9.0, 23.0)

        def make() -> Any:
            made = Slows(name, ports)
            made.rate = rate
            return made

        return make

    def _behavior(self, name: str, friend: str) -> Callable[[], Any]:
        ports, seed = self._ports(sets=True), self.dice.randrange(1000)
        return lambda: Wanders(name, ports, seed, friend)

    def _guard(self) -> Callable[[], Any]:
        eye, wheel = self.dice.choice(self.eyes), self.dice.choice(self.wheels)
        reads = {"eye": esair.reads(float, name=eye, max_age=0.5)}
        guards = {"wheel": esair.guards(float, name=wheel, latch=True)}
        return lambda: LatchGuard(name="guard", reads=reads, guards=guards)

    def _acts(self, has_modes: bool) -> list[str]:
        return [*super()._acts(has_modes), "withdraw", "errand"]

    async def _withdraw(self, robot: esair.Robot, dice: random.Random) -> Any:
        """Ask, and cancel that."""
        news: list[Any] = []
        asked = robot.behaviors.ask(
            Job(dice.uniform(0.01, 0.2)),
            sender="user",
            receiver=dice.choice(self.roams),
            timeout=0.5,
            progress=news.append,
        )
        task = asyncio.ensure_future(asked)
        await asyncio.sleep(dice.choice([0.0, dice.uniform(0.0, 0.1)]))
        task.cancel()
        try:
            return await task, news
        except asyncio.CancelledError:
            return "given up", news

    async def _errand(self, robot: esair.Robot, dice: random.Random) -> Any:
        errand = Errand(dice.uniform(0.01, 0.2))
        name = dice.choice(self.roams)
        return await robot.behaviors.ask(
            errand, sender="user", receiver=name, timeout=0.3
        )


def lived(world: World) -> list[Effect]:
    """Return all that was seen of a robot, in order of time."""
    loop = VirtualLoop()
    with asyncio.Runner(loop_factory=lambda: loop) as runner, virtual_sleep(loop):
        effects = runner.run(world.live())
    return [(round(when, 6), where, what) for when, where, what in effects]


def same(one: Any, other: Any) -> bool:
    """Tell whether two effects are: their times are sums of floats, in another order."""
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) < 1e-5
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def first_difference(one: list[Any], other: list[Any]) -> str:
    """Say where two lives differ first; empty if they are equal."""
    for number in range(max(len(one), len(other))):
        a, b = one[number : number + 3], other[number : number + 3]
        if not (a and b and same(a[0], b[0])):
            return f"effect {number}: as tasks {a}, placed {b}"
    return ""
