"""The contract suite of buses finds the mistakes that it is there for."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from esair.buses import Bus
from esair.exceptions import DeviceLostError, DriverStuckError
from esair.testing import BusContract


class Plain(Bus):
    """A bus on which nothing goes wrong."""

    unplugged = False
    stalled = False
    latency = 0.0

    async def _open(self) -> None:
        if self.unplugged:
            raise DeviceLostError(self.name, "it is unplugged")

    async def _close(self) -> None: ...

    async def use(self) -> None:
        if not self.is_open:
            raise DeviceLostError(self.name, "the bus is not open")
        if self.stalled:
            await self.wait()
        self.stats.sent += 1

    async def wait(self) -> None:
        await asyncio.sleep(0.1)
        raise DriverStuckError(self.name, "use", 0.1)

    async def ask(self, number: int) -> int:
        await asyncio.sleep(self.latency)
        return number


class MixesAnswers(Plain):
    """Who asks gets what comes next, whoever has asked for it."""

    last: asyncio.Future[int] | None = None

    async def ask(self, number: int) -> int:
        loop = asyncio.get_running_loop()
        if self.last is None or self.last.done():
            self.last = loop.create_future()
        answer = self.last
        loop.call_later(self.latency, _settle, answer, number)
        return await asyncio.shield(answer)


def _settle(answer: asyncio.Future[int], number: int) -> None:
    if not answer.done():
        answer.set_result(number)


class KeepsTheLoop(Plain):
    async def wait(self) -> None:
        time.sleep(0.8)  # noqa: ASYNC251 - that is its mistake
        raise DriverStuckError(self.name, "use", 0.8)


class NeverEnds(Plain):
    async def wait(self) -> None:
        await asyncio.sleep(1e6)


class NeverFails(Plain):
    async def wait(self) -> None: ...


class ClosesSlowly(Plain):
    async def _close(self) -> None:
        await asyncio.sleep(60.0 if self.stalled else 0.0)


class CountsNothing(Plain):
    async def use(self) -> None:
        await super().use()
        self.stats.sent = 0


class IsUsedClosed(Plain):
    async def use(self) -> None: ...


class TellsNoLoss(Plain):
    def lost(self, error: BaseException) -> None: ...


def suite_of(kind: type[Plain]) -> BusContract:
    class Suite(BusContract):
        def make(self) -> Plain:
            return kind(name="wire")

        async def use(self, bus: Plain) -> None:
            await bus.use()

        async def unplug(self, bus: Plain) -> None:
            bus.unplugged = True
            bus.lost(ConnectionError("it is unplugged"))

        async def plug(self, bus: Plain) -> None:
            bus.unplugged = False

        async def stall(self, bus: Plain) -> None:
            bus.stalled = True

        async def resume(self, bus: Plain) -> None:
            bus.stalled = False

        async def ask(self, bus: Plain, number: int) -> int:
            return await bus.ask(number)

        async def delay(self, bus: Plain, seconds: float) -> None:
            bus.latency = seconds

    return Suite()


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    "test", [name for name in dir(BusContract) if name.startswith("test_")]
)
async def test_a_bus_without_a_mistake_passes(test: str) -> None:
    """Each test of the suite."""
    await getattr(suite_of(Plain), test)()


@pytest.mark.long
@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("kind", "test"),
    [
        (NeverEnds, "test_a_stalled_wire_costs_only_its_user"),
        (NeverFails, "test_a_stalled_wire_costs_only_its_user"),
        (ClosesSlowly, "test_a_stalled_wire_costs_only_its_user"),
        (CountsNothing, "test_it_counts_what_it_does"),
        (IsUsedClosed, "test_it_cannot_be_used_closed"),
        (TellsNoLoss, "test_its_loss_is_told_once"),
        (MixesAnswers, "test_cancel_then_ask"),
    ],
)
async def test_a_bus_with_a_mistake_does_not_pass(kind: Any, test: str) -> None:
    """And the suite comes to its end."""
    with pytest.raises((AssertionError, TimeoutError, pytest.fail.Exception)):
        await getattr(suite_of(kind), test)()


@pytest.mark.real_clock
async def test_a_bus_that_keeps_the_event_loop_does_not_pass() -> None:
    """Also if it is the first thing that it does."""
    with pytest.raises(AssertionError):
        await suite_of(KeepsTheLoop).test_a_stalled_wire_costs_only_its_user()
