"""Components that do what those of `tests.placement.roamers` leave out.

They have operations and settings, report losses, push bursts, give up what they ask for,
write what expires, and prepare and clear up.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import attrs
from tests.placement.roamers import (
    ACTS,
    EXPECTED,
    INITIAL,
    Counts,
    Guard,
    Ports,
    Roams,
    WorldError,
    said,
)

import esair


class Operated(Counts):
    """Polled; it has a setting, and operations that may fail and report a loss."""

    gain = esair.setting(0.4, min=0.1, max=0.9)

    async def read(self) -> float:
        await asyncio.sleep(0.00171)
        return INITIAL + (self.next() - INITIAL) * self.gain

    @esair.operation(deadline=0.1913)
    async def turn(self, seconds: float, fails: bool = False) -> float:
        """Take a while."""
        await asyncio.sleep(seconds)
        if fails:
            raise OSError(5, "it does not turn")
        return round(seconds * self.gain, 6)

    @esair.operation
    async def drop(self) -> float:
        """Notice that it is gone, but go on."""
        self.report_lost(esair.DeviceLostError(self.name, "it was dropped"))
        await asyncio.sleep(0.0217)
        return 1.0


class PlainOperated(Counts):
    """The same in a thread."""

    gain = esair.setting(0.4, min=0.1, max=0.9)

    def read(self) -> float:
        return INITIAL + (self.next() - INITIAL) * self.gain

    @esair.operation(deadline=0.1913)
    def turn(self, seconds: float, fails: bool = False) -> float:
        """Do nothing else."""
        if fails:
            raise OSError(5, "it does not turn")
        return round(seconds * self.gain, 6)

    @esair.operation
    def drop(self) -> float:
        """Notice that it is gone."""
        raise esair.DeviceLostError(self.name, "it was dropped")


class Bursts(Counts):
    """Pushes several values at once, and is silent then."""

    def __init__(self, fails: tuple[int, int], pause: float, **settings: Any) -> None:
        super().__init__(fails, **settings)
        self.pause = pause

    async def stream(self) -> AsyncIterator[float]:
        await asyncio.sleep(0.00211)
        yield INITIAL
        while True:
            await asyncio.sleep(self.pause * 3)
            for _ in range(1 + self.reads % 4):
                yield self.next()
                await asyncio.sleep(0.00013)


class LatchGuard(Guard):
    """Lets nothing pass any more after it has refused."""

    wheel = esair.guards(float, latch=True)

    def react(self, eye: float, wheel: float) -> float | None:
        return wheel if abs(wheel) < 1.9 else None


class Slows(esair.Reaction):
    """Decides at its own pace, by how long that was."""

    restart = esair.Restart(max=2, within=0.4, delay=0.1347)
    eye = esair.reads(float)
    wheel = esair.writes(float)

    def __init__(self, name: str, ports: Ports) -> None:
        super().__init__(name=name, **ports.needs)

    def react(self, eye: float) -> float | None:
        if eye < INITIAL - 0.33:
            raise WorldError("eye")
        return round(eye + self.elapsed_ms % 5, 6)


@attrs.frozen
class Errand(esair.Request[float]):
    """Go somewhere."""

    seconds: float


HALF = (
    *("reads_anew", "asks", "gets", "receives", "operates", "performs"),
    *("reacts", "drives", "sends", "puts"),
)


class Wanders(Roams):
    """Does one thing after the other, and leaves some half done."""

    acts = (
        *ACTS,
        *("operates", "operates", "configures", "drops", "expires", "expires"),
        *("gives_up", "gives_up", "sends", "sends", "in_time", "floods", "looks_back"),
    )

    async def setup(self) -> None:
        await asyncio.sleep(0.0131)

    async def teardown(self) -> None:
        await asyncio.sleep(0.0117)
        if self.seed % 4 == 0:
            raise WorldError("teardown")

    async def provide(self) -> float:
        await asyncio.sleep(0.0173)
        return 7.0

    @esair.answers
    async def errand(self, request: Errand) -> float:
        await asyncio.sleep(request.seconds)
        if request.seconds > 0.15:
            raise esair.RefusedError(self.name, "too far")
        if request.seconds < 0.03:
            raise WorldError("errand")
        return request.seconds

    async def look(self) -> None:
        await asyncio.sleep(0.00419)  # the first act begins now, too
        await super().look()

    async def operates(self) -> Any:
        seconds = self.dice.uniform(0.01, 0.25)
        return await self.eye.operate(
            "turn", seconds=seconds, fails=self.dice.random() < 0.2
        )

    async def configures(self) -> Any:
        await self.eye.configure(gain=self.dice.uniform(0.05, 0.95))
        return dict(self.eye.settings)

    async def drops(self) -> Any:
        if self.dice.random() < 0.5:
            return None
        return await self.eye.operate("drop")

    async def expires(self) -> Any:
        moment = esair.now() + self.dice.uniform(-0.004, 0.02)
        told = await self.wheel.write(self.dice.uniform(-2.0, 2.0), expires=moment)
        return bool(told)

    async def gives_up(self) -> Any:
        """Cancel what it has begun."""
        what = self.dice.choice(HALF)
        task = asyncio.create_task(getattr(self, what)())
        await asyncio.sleep(self.dice.uniform(0.001, 0.1))
        task.cancel()
        try:
            return what, await task
        except asyncio.CancelledError:
            return what, "given up"
        except EXPECTED as error:
            return what, said(error)

    async def in_time(self) -> Any:
        async with asyncio.timeout(self.dice.uniform(0.01, 0.1)):
            return await self.asks()

    async def sends(self) -> Any:
        errand = Errand(self.dice.uniform(0.01, 0.2))
        return await self.ask(self.friend, errand, timeout=0.1917)

    async def floods(self) -> Any:
        for number in range(self.dice.randint(2, 20)):
            await self.put(self.friend, number, 0.0019)
            await asyncio.sleep(0.00019)

    async def looks_back(self) -> Any:
        return [round(each.time, 6) for each in self.eye.history(3)]
