"""What every bus must do, fake or real: a suite to be run on yours.

Subclass it in a test module, and say how the bus is made and used::

    class TestTcp(BusContract):
        def make(self):
            return TcpBus(name="tcp", host="127.0.0.1", port=self.server.port)

        async def use(self, bus):
            assert await bus.ask(b"ping") == b"pong"

The tests run on the virtual clock; mark the class ``real_clock`` for a bus that has
descriptors or threads.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
import inspect
import itertools
from collections.abc import AsyncIterator
from typing import Any, ClassVar

import pytest

from esair.buses import Bus
from esair.exceptions import DeviceLostError, EsairError

PATIENCE = 5.0  # How long a suite waits for what has to happen, in seconds


class BusContract(abc.ABC):
    """What all buses have in common, whatever their medium."""

    pytestmark: ClassVar[list[Any]] = [pytest.mark.asyncio, pytest.mark.virtual_clock]

    longest_stall: ClassVar[float] = 0.5
    """How long the event loop may be kept, in seconds; far more than a bus needs."""

    @abc.abstractmethod
    def make(self) -> Bus:
        """Make a bus that is there, closed; a new one for each test."""

    @abc.abstractmethod
    async def use(self, bus: Any) -> None:
        """Use the open bus once, in both directions if it has two."""

    async def unplug(self, bus: Any) -> None:
        """Take the wire away, as a cable that is pulled; skips unless overridden."""
        await tell(getattr(bus, "unplug", None), "unplug")

    async def plug(self, bus: Any) -> None:
        """Bring the wire back; skips unless overridden."""
        await tell(getattr(bus, "plug", None), "plug")

    async def stall(self, bus: Any) -> None:
        """Let the other end take and give nothing; skips unless overridden."""
        await tell(getattr(bus, "stall", None), "stall")

    async def resume(self, bus: Any) -> None:
        """Let the other end go on; skips unless overridden."""
        await tell(getattr(bus, "resume", None), "resume")

    async def ask(self, bus: Any, number: int) -> int:
        """Ask for a number and return the one that was answered; skips unless overridden.

        The other end answers with the number that it was asked for.
        """
        pytest.skip("override ask() and delay() to test whose an answer is")

    async def delay(self, bus: Any, seconds: float) -> None:
        """Let the other end answer so much later from now on; skips unless overridden."""
        pytest.skip("override ask() and delay() to test whose an answer is")

    async def test_cancel_then_ask(self) -> None:
        """An answer to a request that was given up is never that to another."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.delay(bus, 0.05)
            for number, given_up in enumerate((0.0, 0.02, 0.04) * 2, 1):
                asking = asyncio.ensure_future(self.ask(bus, number))
                await asyncio.sleep(given_up)
                asking.cancel()
                await asyncio.wait({asking})
                for other in (10 * number, 10 * number + 1):
                    assert await self.ask(bus, other) == other

    async def test_it_opens_and_closes_again_and_again(self) -> None:
        """A bus is opened after each loss, by the same object."""
        async with _closing(self.make()) as bus:
            for n in range(1, 4):
                await bus.open()
                assert bus.is_open
                await self.use(bus)
                await bus.close()
                assert not bus.is_open
                assert bus.stats.opened == n

    async def test_it_can_be_closed_twice(self) -> None:
        """A close that follows another one, or no opening at all, does no harm."""
        async with _closing(self.make()) as bus:
            await bus.close()
            await bus.open()
            await bus.close()
            await bus.close()

    async def test_all_who_open_it_share_one_opening(self) -> None:
        """A bus has one owner, however many devices are on it."""
        async with _closing(self.make()) as bus:
            await asyncio.gather(*(bus.open() for _ in range(5)))
            assert bus.stats.opened == 1
            await self.use(bus)

    async def test_it_counts_what_it_does(self) -> None:
        """What is sent or received shows in its statistics, and no error does."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.use(bus)
            assert bus.stats.sent + bus.stats.received > 0
            assert bus.stats.errors == 0

    async def test_it_cannot_be_used_closed(self) -> None:
        """The error names the bus, at once."""
        async with _closing(self.make()) as bus:
            with pytest.raises(DeviceLostError, match=bus.name):
                await self.use(bus)

    async def test_its_loss_is_told_once(self) -> None:
        """Whoever listens hears it, whoever uses it gets the error."""
        async with _closing(self.make()) as bus:
            told: list[BaseException] = []
            bus.on_lost(told.append)
            await bus.open()
            await self.use(bus)
            await self.unplug(bus)
            for _ in range(3):
                with pytest.raises(DeviceLostError):
                    await _until_lost(self, bus)
            assert len(told) == 1
            assert bus.stats.lost == 1
            assert bus.stats.last_error

    async def test_it_comes_back(self) -> None:
        """After a loss the same object is opened again and works as before."""
        async with _closing(self.make()) as bus:
            await bus.open()
            for _ in range(3):
                await self.unplug(bus)
                with pytest.raises(DeviceLostError):
                    await _until_lost(self, bus)
                with pytest.raises(EsairError):
                    await bus.open()
                await self.plug(bus)
                await bus.open()
                await self.use(bus)

    async def test_a_stalled_wire_costs_only_its_user(self) -> None:
        """The use ends with an error in time; the loop turns, the close is quick."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.stall(bus)
            async with _heart() as beats, asyncio.timeout(PATIENCE):
                with pytest.raises(EsairError):
                    await _until_error(self, bus)
            assert max(beats) < self.longest_stall
            async with _heart() as beats, asyncio.timeout(PATIENCE):
                await bus.close()
            assert max(beats) < self.longest_stall
            await self.resume(bus)

    async def test_it_works_after_a_stall(self) -> None:
        """A bus that was stuck, closed and opened again is as good as new."""
        async with _closing(self.make()) as bus:
            await bus.open()
            await self.stall(bus)
            async with asyncio.timeout(PATIENCE):
                with pytest.raises(EsairError):
                    await _until_error(self, bus)
            await bus.close()
            await self.resume(bus)
            await bus.open()
            await self.use(bus)


async def tell(method: Any, what: str) -> None:
    """Call what a test needs of a device or bus; skip where there is none."""
    if method is None:
        pytest.skip(f"override {what}() to test this")
    result = method()
    if inspect.isawaitable(result):
        await result


async def _until_lost(suite: BusContract, bus: Bus) -> None:
    """Use a bus until its loss is noticed, which a reader does on its own."""
    async with asyncio.timeout(PATIENCE):
        while True:
            await suite.use(bus)
            await asyncio.sleep(0.001)


async def _until_error(suite: BusContract, bus: Bus) -> None:
    """Use a bus that is stalled; buffers on the way take something first.

    Now and then time passes, or a use that never waits would go on for ever.
    """
    for n in itertools.count(1):
        await suite.use(bus)
        await asyncio.sleep(0.0 if n % 16 else 0.001)


@contextlib.asynccontextmanager
async def _closing(bus: Bus) -> AsyncIterator[Bus]:
    try:
        yield bus
    finally:
        await bus.close()


@contextlib.asynccontextmanager
async def _heart() -> AsyncIterator[list[float]]:
    """Measure how long the event loop was kept at most, in seconds."""
    loop = asyncio.get_running_loop()
    beats = [0.0]

    async def beat() -> None:
        before = loop.time()
        try:
            while True:
                await asyncio.sleep(0.005)
                now = loop.time()
                beats.append(now - before - 0.005)
                before = now
        finally:  # what kept the loop may be just over
            beats.append(loop.time() - before - 0.005)

    beating = loop.create_task(beat())
    await asyncio.sleep(0)  # it begins before what may keep the loop
    try:
        yield beats
    finally:
        beating.cancel()
        await asyncio.wait({beating})
