"""Robots that stay safe whatever happens, and never work again; one mistake in each."""

from __future__ import annotations

import asyncio
import contextlib
import queue
from collections.abc import AsyncIterator, Callable
from typing import Any

import attrs

import esair

LOST = (
    esair.DeviceLostError,
    esair.DeviceFaultError,
    esair.DriverStuckError,
    esair.StaleReadingError,
    esair.ResourceRemovedError,
)


class Sonar(esair.Sensor[float]):
    """The way ahead in metres."""

    rate = 20.0

    async def read(self) -> float:
        return 1.0


class Bumper(esair.Sensor[float]):
    """Says what it feels, again and again."""

    period = 0.3
    initial = 1.0

    async def stream(self) -> AsyncIterator[float]:
        while True:
            yield 1.0
            await asyncio.sleep(0.1)


class Wheels(esair.Actuator[float]):
    """Wheels, in m/s."""

    safe = 0.0
    command_timeout = 0.2

    async def write(self, command: float) -> None: ...


class Arm(Wheels):
    """An arm, in rad/s."""


@attrs.frozen
class Dock(esair.Request[float]):
    """Drive into a dock."""

    number: int


class Drives(esair.Behavior):
    """Looks, and drives."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.drive()

    async def drive(self) -> None:
        with contextlib.suppress(*LOST):
            await self.wheels.write(await self.sonar.read())


class KeepClear(esair.Reaction):
    """Guard the wheels."""

    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels if sonar > 0.3 else None


# The sixteen.


class FailsForGood(Drives):
    """Its setup works once: what it has made is in its way ever after."""

    made: bool = False

    async def setup(self) -> None:
        if self.made:
            raise FileExistsError("/run/rover.lock")
        self.made = True


class ReturnsAtALoss(Drives):
    """Takes the first reading that is not there for its end."""

    async def run(self) -> None:
        with contextlib.suppress(*LOST):
            async for _ in esair.every(0.05):
                await self.wheels.write(await self.sonar.read())


class KeepsItsLock(Drives):
    """Does not release what it has acquired, if something is raised in between."""

    def __init__(self, *, name: str | None = None) -> None:
        super().__init__(name=name)
        self.lock = asyncio.Lock()

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.lock.acquire()
            await self.wheels.write(await self.sonar.read())
            self.lock.release()


class WaitsForNobody(Drives):
    """Leaves its loop at a loss, and waits to be told to go on."""

    async def run(self) -> None:
        go_on = asyncio.Event()
        while True:
            try:
                await self.wheels.write(await self.sonar.read())
                await asyncio.sleep(0.05)
            except LOST:
                await go_on.wait()


class StaysInPanic(Drives):
    """Stops at a loss, and never takes that back."""

    panics = False

    async def drive(self) -> None:
        try:
            metres = await self.sonar.read()
        except LOST:
            self.panics = True
        if not self.panics:
            await self.wheels.write(metres)


class LosesItsTask(Drives):
    """The task that drives ends at an error that nobody looks at."""

    async def run(self) -> None:
        driving = asyncio.ensure_future(self.work())
        driving.add_done_callback(lambda task: task.cancelled() or task.exception())
        async for _ in esair.every(0.5):
            with contextlib.suppress(*LOST):
                await self.sonar.read()

    async def work(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(await self.sonar.read())


class AsksOnce(Drives):
    """Asks no more when it has not had an answer once."""

    async def run(self) -> None:
        friend = True
        async for _ in esair.every(0.2):
            await self.drive()
            try:
                if friend:
                    await self.ask("serves", Dock(1), timeout=0.5)
            except (TimeoutError, esair.EsairError):
                friend = False


class Serves(esair.Behavior):
    """Answers at once."""

    orders = esair.takes(Dock)

    async def run(self) -> None:
        async for order in self.orders:
            async with order:
                order.answer(1.0)


class Asks(Drives):
    """Asks again whatever becomes of it."""

    async def run(self) -> None:
        async for _ in esair.every(0.2):
            await self.drive()
            with contextlib.suppress(TimeoutError, esair.EsairError):
                await self.ask("serves", Dock(1), timeout=0.5)


class StaysBusy(Serves):
    """Forgets to say that it is free, if its work has failed."""

    sonar = esair.reads(float, max_age=0.5)

    def __init__(self) -> None:
        super().__init__(name="serves")
        self.is_busy = False

    async def run(self) -> None:
        async for order in self.orders:
            with contextlib.suppress(*LOST):
                async with order:
                    if self.is_busy:
                        order.refuse("busy")
                        continue
                    self.is_busy = True
                    order.answer(await self.sonar.read())
                    self.is_busy = False


class ReactsNoMore(esair.Reaction):
    """Trusts its sensor no more once it was away for a second."""

    sonar = esair.reads(float, optional=True)
    wheels = esair.writes(float, priority=5, blind="release")
    trusts = True

    def react(self, sonar: float | None) -> float | None:
        self.trusts = self.trusts and sonar is not None
        return sonar if self.trusts else None


class WaitsForever(Drives):
    """Waits longer after each failure, and never less again."""

    async def run(self) -> None:
        pause = 0.05
        while True:
            await asyncio.sleep(pause)
            try:
                await self.wheels.write(await self.sonar.read())
            except LOST:
                pause *= 8


class CountsToTen(Drives):
    """Gives up when it was refused, or let down, ten times."""

    async def run(self) -> None:
        failures = 0
        async for _ in esair.every(0.05):
            try:
                if failures < 10 and not await self.wheels.write(
                    await self.sonar.read()
                ):
                    failures += 1
            except LOST:
                failures += 1


class ThreadThatWaits(esair.ThreadBehavior):
    """Waits in its thread for an order that nobody gives it."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(float)

    def run(self) -> None:
        orders: queue.Queue[float] = queue.Queue(1)
        orders.put(0.5)
        for _ in esair.every(0.05):
            try:
                self.wheels.write(orders.get_nowait())
                self.sonar.read()
                orders.put(0.5)
            except (*LOST, queue.Empty):
                continue


class PutsNoMore(Drives):
    """Tells its friend nothing more when that was busy once."""

    async def run(self) -> None:
        told: set[str] = {"hears"}
        async for _ in esair.every(0.1):
            await self.drive()
            for each in tuple(told):
                try:
                    await self.put(each, 1.0, interval=0.3)
                except esair.EsairError:
                    told.discard(each)


class Hears(esair.Behavior):
    """Takes what it is told."""

    async def run(self) -> None:
        while True:
            await self.receive()


class SpeaksOnce(Bumper):
    """A driver that says nothing more after a second opening."""

    max_age = 60.0
    opened = 0

    async def open(self) -> None:
        self.opened += 1

    async def stream(self) -> AsyncIterator[float]:
        while True:
            yield 1.0
            await asyncio.sleep(0.1 if self.opened == 1 else 3600.0)


class Follows(esair.Behavior):
    """Drives by each value that comes."""

    bumper = esair.reads(float)
    wheels = esair.writes(float)

    async def run(self) -> None:
        while True:
            with contextlib.suppress(*LOST):
                async for value in self.bumper:
                    await self.wheels.write(value)
            await asyncio.sleep(0.1)


class DrivesByPlan(Drives):
    """Is through with its plan when a part of it took too long."""

    async def run(self) -> None:
        late = 0.0
        last = esair.now()
        async for _ in esair.every(0.05):
            late += max(0.0, esair.now() - last - 0.5)
            last = esair.now()
            if late < 0.3:
                await self.drive()


class TurnsTheArm(esair.Behavior):
    """Moves an arm with what others tell it, as long as they do not pause."""

    inbox_policy = "drop_oldest"
    arm = esair.writes(float)

    async def run(self) -> None:
        await self.receive()
        while True:
            try:
                speed = await self.receive(timeout=1.0)
            except TimeoutError:
                break
            await self.arm.write(float(speed))
        await asyncio.Event().wait()


class TellsTheArm(Drives):
    """Tells another one how fast it drives."""

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.drive()
            with contextlib.suppress(esair.EsairError):
                await self.put("turns_the_arm", 0.5, interval=0.2)


def _robot(
    *behaviors: Callable[[], Any], bumper: type[Bumper] = Bumper
) -> Callable[[], esair.Robot]:
    def make() -> esair.Robot:
        devices = [Sonar(), bumper(name="bumper"), Wheels(), Arm()]
        return esair.Robot(
            resources=devices, behaviors=[each() for each in behaviors], grace=0.5
        )

    return make


PLANTS: dict[str, tuple[Callable[[], esair.Robot], str]] = {
    "fails for good": (_robot(FailsForGood), "fails_for_good"),
    "returns at a loss": (_robot(ReturnsAtALoss), "returns_at_a_loss"),
    "keeps its lock": (_robot(KeepsItsLock), "keeps_its_lock"),
    "waits for nobody": (_robot(WaitsForNobody), "waits_for_nobody"),
    "stays in panic": (_robot(StaysInPanic), "stays_in_panic"),
    "loses its task": (_robot(LosesItsTask), "loses_its_task"),
    "asks once": (_robot(AsksOnce, Serves), "asks_once"),
    "stays busy": (_robot(Asks, StaysBusy), "asks"),
    "reacts no more": (_robot(Drives, KeepClear, ReactsNoMore), "reacts_no_more"),
    "waits for ever": (_robot(WaitsForever), "waits_forever"),
    "counts to ten": (_robot(CountsToTen), "counts_to_ten"),
    "a thread that waits": (_robot(ThreadThatWaits), "thread_that_waits"),
    "puts no more": (_robot(PutsNoMore, Hears), "puts_no_more"),
    "speaks once": (_robot(Follows, bumper=SpeaksOnce), "follows"),
    "drives by plan": (_robot(DrivesByPlan), "drives_by_plan"),
    "turns the arm": (_robot(TellsTheArm, TurnsTheArm), "turns_the_arm"),
}
"""Each robot, and who does nothing any more in the end."""

SOUND: dict[str, Callable[[], esair.Robot]] = {
    "drives": _robot(Drives),
    "asks": _robot(Asks, Serves),
    "follows": _robot(Follows),
    "reacts": _robot(Drives, KeepClear, Hears),
}
"""The same without the mistake."""


class Patrol(Drives):
    """Drives once in ten seconds, and owes it; after a loss never again."""

    rounds = esair.works("wheels", within=12.0)
    lost = False

    async def run(self) -> None:
        async for _ in esair.every(10.0):
            self.lost = self.lost or await self.is_lost()
            if not self.lost:
                await self.wheels.write(0.5)

    async def is_lost(self) -> bool:
        try:
            await self.sonar.read()
        except LOST:
            return True
        return False


class Rests(ReturnsAtALoss):
    """May end whenever it likes."""

    rest = esair.works(idle=True)


class MayPanic(StaysInPanic):
    """May leave the wheels alone for good."""

    rest = esair.works("wheels", idle=True)


class Mission(Drives):
    """Is through with its work after 32 seconds."""

    async def run(self) -> None:
        async for seconds in esair.every(0.05):
            if seconds > 32.0:
                return
            await self.drive()


patrol, rests, may_panic = _robot(Patrol), _robot(Rests), _robot(MayPanic)
mission = _robot(Mission)
