"""Robots of all kinds, made from a number."""

from __future__ import annotations

import asyncio
import random
import sys
from ast import literal_eval
from collections.abc import AsyncIterator, Callable
from typing import Any

import attrs

import esair


@attrs.frozen
class Job(esair.Request[float]):
    """Work for a while."""

    seconds: float


class Polled(esair.Sensor[float]):
    rate = 20.0

    async def read(self) -> float:
        return 1.0


class Blocking(esair.Sensor[float]):
    rate = 10.0

    def read(self) -> float:
        return 1.0


class Pushing(esair.Sensor[float]):
    period = 0.3
    initial = 1.0

    async def stream(self) -> AsyncIterator[float]:
        while True:
            await asyncio.sleep(0.1)
            yield 1.0


class Motor(esair.Actuator[float]):
    safe = 0.0
    set_up_period = 0.5

    async def write(self, command: float) -> None: ...

    async def is_set_up(self) -> bool:
        return True


class SlowMotor(Motor):
    async def write(self, command: float) -> None:
        await asyncio.sleep(0.03)


class BlockingMotor(esair.Actuator[float]):
    safe = 0.0
    command_timeout = 0.3

    def write(self, command: float) -> None: ...


class Servo(esair.Actuator[float]):
    safe = esair.HOLD

    async def write(self, command: float) -> None: ...


SENSORS = (Polled, Blocking, Pushing)
ACTUATORS = (Motor, SlowMotor, BlockingMotor, Servo)


ANSWERS = (
    esair.BehaviorUnavailableError,
    esair.BehaviorFailedError,
    esair.BusyError,
    esair.CircularRequestError,
    esair.RefusedError,
    esair.UnknownNameError,
)
"""What a peer may answer, or what becomes of it: no reason to end."""


class Reflex(esair.Reaction):
    """Lets others drive, or turns away; which is in its profile."""

    def react(self, eye: float) -> float | None:
        return -0.5 if eye < 0.5 else None


class Guard(esair.Reaction):
    """Lets nothing pass while something is near."""

    def react(self, eye: float, wheel: float) -> float | None:
        return wheel if eye > 0.5 else None


class Driver(esair.Behavior):
    """Writes in bursts, puts, gets and asks the next one."""

    jobs = esair.takes(Job, queue=4)
    inbox_size = 4
    inbox_policy = "drop_oldest"

    def __init__(self, name: str, peer: str, seed: int) -> None:
        super().__init__(name=name)
        self.peer = peer
        self.dice = random.Random(seed)

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.serve())
            tasks.create_task(self.talk())
            while True:
                for _ in range(self.dice.randint(1, 20)):
                    for attribute in self.needs:
                        await getattr(self, attribute).write(
                            self.dice.uniform(-1.0, 1.0)
                        )
                    await asyncio.sleep(0.04)
                await asyncio.sleep(self.dice.choice((0.1, 0.6)))

    async def serve(self) -> None:
        async for job in self.jobs:
            async with job:
                await asyncio.sleep(job.seconds / 4)
                job.answer(job.seconds)

    async def talk(self) -> None:
        while True:
            await asyncio.sleep(self.dice.uniform(0.05, 0.3))
            try:
                if self.dice.random() < 0.5:
                    await self.put(self.peer, 1, interval=0.2)
                else:
                    await self.ask(self.peer, Job(0.2), timeout=0.5)
            except ANSWERS:
                continue
            except esair.BehaviorRemovedError as error:
                if error.behavior != self.peer:
                    raise  # its own end has come


KINDS = {"Guards": Guard, "Acts": Reflex, "Drives": Driver}


def __getattr__(name: str) -> Any:
    """Make the class of an action of its name, which says its ports: a child asks, too."""
    kind, is_one, told = name.partition(":")
    if not is_one:
        raise AttributeError(name)
    fields = dict[str, Any](
        (attribute, value if access == "is" else getattr(esair, access)(float, **value))
        for attribute, (access, value) in literal_eval(told).items()
    )
    made = type(name, (KINDS[kind],), {**fields, "__module__": __name__})
    return globals().setdefault(name, made)


def action_of(kind: str, **ports: tuple[str, Any]) -> Any:
    """Return the class of an action that has these ports."""
    return getattr(sys.modules[__name__], f"{kind}:{ports}")


def names(kinds: tuple[type[Any], ...], dice: random.Random) -> dict[str, type[Any]]:
    """Choose one to three kinds, by name."""
    chosen = [dice.choice(kinds) for _ in range(dice.randint(1, 3))]
    return {f"{each.__name__.lower()}_{n}": each for n, each in enumerate(chosen)}


def maker(seed: int, *, placed: bool = False) -> Callable[[], esair.Robot]:
    """Return what makes the robot of a number, as often as it is called.

    Args:
        seed: The number.
        placed: Whether every second action that can has a process of its own.
    """

    def make() -> esair.Robot:
        dice = random.Random(seed)
        sensors, actuators = names(SENSORS, dice), names(ACTUATORS, dice)
        actions: list[Any] = []
        ports: dict[str, Any]
        for n, wheel in enumerate(actuators):
            ports = {"eye": ("reads", {"name": dice.choice(list(sensors))})}
            match dice.randrange(4):
                case 0:
                    ports["wheel"] = ("guards", {"name": wheel})
                    actions.append(action_of("Guards", **ports)(name=f"guard_{n}"))
                case 1 | 2:
                    priority = dice.choice((0, 5))
                    ports["wheel"] = ("writes", {"name": wheel, "priority": priority})
                    if dice.random() < 0.5:
                        ports["rate"] = ("is", 10)
                    actions.append(action_of("Acts", **ports)(name=f"reflex_{n}"))
        drivers = [f"driver_{n}" for n in range(dice.randint(1, 3))]
        for n, name in enumerate(drivers):
            ports = {each: ("writes", {}) for each in actuators if dice.random() < 0.7}
            if not ports:  # deaf when its end comes, it would never hear of it
                ports = {next(iter(actuators)): ("writes", {})}
            peer = drivers[(n + 1) % len(drivers)]
            kind = action_of("Drives", **ports)
            actions.append(kind(name, peer, dice.randrange(1000)))
        for action in actions[::2] if placed else ():
            if not isinstance(action, Guard):
                action.placement = "process"
        devices = {**sensors, **actuators}
        return esair.Robot(
            resources=[kind(name=name) for name, kind in devices.items()],
            behaviors=actions,
            grace=0.5,
        )

    return make
