"""The rover of examples/wander_and_avoid.py, with one mistake in each."""

from __future__ import annotations

import asyncio
import os
import tempfile
from typing import ClassVar

import attrs

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


class Sonar(esair.Sensor[float]):
    """The way ahead in metres."""

    rate = 20.0

    async def read(self) -> float:
        return 1.0


class Wheels(esair.Actuator[Twist]):
    """Wheels."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2

    async def write(self, command: Twist) -> None: ...


class KeepClear(esair.Reaction):
    """Guard the wheels."""

    sonar = esair.reads(float)
    wheels = esair.guards(Twist)

    def react(self, sonar: float, wheels: Twist) -> Twist | None:
        return None if sonar < 0.3 and wheels.linear > 0.0 else wheels


class Avoid(esair.Reaction):
    """Turn away from anything closer than 0.4 m."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(Twist, priority=10, blind="release")

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.2) if sonar < 0.4 else None


class Wander(esair.Behavior):
    """Drive on, whatever happens."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(Twist(0.3, 0.0))


class PatientWheels(Wheels):
    """A driver without a deadline: it waits for its device for a minute."""

    deadline = 60.0


class UnsafeWheels(esair.Actuator[Twist]):
    """A driver that does not say what is safe."""

    command_timeout = 0.2

    async def write(self, command: Twist) -> None: ...


class ForgetfulWheels(Wheels):
    """A driver whose table has no row for the safe command."""

    words: ClassVar[dict[Twist, bytes]] = {Twist(0.3, 0.0): b"F", Twist(0.0, 1.2): b"L"}

    async def write(self, command: Twist) -> None:
        self.words[command]


class Diary(esair.Behavior):
    """Keeps every reading until it is written down, which takes long."""

    sonar = esair.reads(float)

    def __init__(self) -> None:
        super().__init__()
        self.pages: asyncio.Queue[float] = asyncio.Queue()

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.write_down())
            async for metres in self.sonar:
                self.pages.put_nowait(metres)

    async def write_down(self) -> None:
        while True:
            await self.pages.get()
            await asyncio.sleep(0.5)


class HoardingSonar(Sonar):
    """A driver that keeps all that it has seen."""

    def __init__(self, *, name: str | None = None) -> None:
        super().__init__(name=name)
        self.seen: list[float] = []

    async def read(self) -> float:
        self.seen.append(1.0)
        return 1.0


@attrs.frozen
class Dock(esair.Request[float]):
    """Drive into a dock."""

    number: int


class Forgetful(esair.Behavior):
    """Takes more orders than it answers."""

    orders = esair.takes(Dock)

    async def run(self) -> None:
        async for order in self.orders:
            async with order:
                await asyncio.sleep(0.1)
                if order.data.number > 0:
                    order.answer(1.0)


class Stubborn(esair.Behavior):
    """Takes its own end for a loss of its sensor."""

    sonar = esair.reads(float)

    async def run(self) -> None:
        while True:
            try:
                await asyncio.sleep(0.05)
                await self.sonar.read()
            except (esair.EsairError, asyncio.CancelledError):
                continue


class Locks(esair.Behavior):
    """Keeps others away with a folder: what is killed cannot take that back."""

    placement = "process"
    arm = esair.writes(Twist)

    def __init__(self, folder: str) -> None:
        super().__init__()
        self.folder = folder
        self.has_made_it = False

    async def setup(self) -> None:
        if self.folder:
            os.mkdir(self.folder)
            self.has_made_it = True

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.arm.write(Twist(0.2, 0.0))

    async def teardown(self) -> None:
        if self.has_made_it:
            os.rmdir(self.folder)


class Exits(esair.Behavior):
    """Drives in a process of its own, and ends that where it sees nothing."""

    placement = "process"
    restart = esair.Restart(max=1, within=60.0, delay=0.1)
    sonar = esair.reads(float)
    arm = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            try:
                await self.sonar.read()
            except esair.EsairError:
                os._exit(3)
            await self.arm.write(Twist(0.2, 0.0))


class Turns(esair.Reaction):
    """Turns when something is near, in a process of its own."""

    placement = "process"
    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(Twist, priority=5)

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.0) if sonar < 2.0 else None


class Endless(esair.Behavior):
    """Never lets anybody else."""

    async def run(self) -> None:
        await asyncio.sleep(1.0)
        while True:
            pass


def make(
    wheels: esair.Actuator[Twist] | None = None,
    *others: esair.Behavior,
    guard: bool = True,
    sonar: Sonar | None = None,
) -> esair.Robot:
    """Return a rover."""
    guards = [KeepClear()] if guard else []
    return esair.Robot(
        resources=[sonar or Sonar(), wheels or Wheels()],
        behaviors=[*guards, Avoid(), Wander(), *others],
    )


sound = make()
no_deadline = make(PatientWheels(name="wheels"))
no_safe = make(UnsafeWheels(name="wheels"))
no_word_for_safe = make(ForgetfulWheels(name="wheels"))
blind = make(guard=False)
no_bound = make(None, Diary())
endless = make(None, Endless())
stubborn = make(None, Stubborn())
forgetful = make(None, Forgetful())
hoard = make(sonar=HoardingSonar(name="sonar"))


def children(folder: str = "") -> esair.Robot:
    """Return a rover that decides in processes of their own."""
    return esair.Robot(
        resources=[Sonar(), Wheels(), Wheels(name="arm")],
        behaviors=[KeepClear(), Turns(), Locks(folder)],
    )


def exits() -> esair.Robot:
    """Return one that cannot live without its sonar."""
    return esair.Robot(
        resources=[Sonar(), Wheels(), Wheels(name="arm")],
        behaviors=[KeepClear(), Turns(), Exits()],
    )


def locked() -> esair.Robot:
    """Return one with the lock."""
    return children(os.path.join(tempfile.mkdtemp(), "lock"))
