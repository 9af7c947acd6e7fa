"""The contract of buses, on a CAN bus in memory and on python-can's virtual one."""

from __future__ import annotations

import asyncio
import itertools
import os
from typing import Any

import pytest
from tests.buses.can.asked import ANSWER, QUESTION, Asked

from esair.buses import Bus, CanBus, Frame, LateWire
from esair.buses.can import VirtualCan
from esair.exceptions import DeviceLostError
from esair.testing import BusContract, FakeCan


async def ask(bus: CanBus) -> None:
    """Send a frame and take the answer of the other node."""
    with bus.frames(0x181) as inbox:
        await bus.send(0x101, b"ping")
        try:
            frame = await inbox.take(timeout=1.0)
        except TimeoutError:
            raise DeviceLostError(bus.name, "nobody answered") from None
    assert frame.data == b"pong"


class TestFakeCan(Asked, BusContract):
    """On the virtual clock."""

    def make(self) -> FakeCan:
        bus = FakeCan("drive")
        bus.answer(0x101, Frame(0x181, b"pong"))
        return bus

    async def use(self, bus: Any) -> None:
        await ask(bus)

    async def delay(self, bus: Any, seconds: float) -> None:
        loop = asyncio.get_running_loop()

        def answer(frame: Frame) -> None:
            loop.call_later(seconds, bus.feed, ANSWER, frame.data)

        bus.answer(QUESTION, answer)


class OnVirtualCan(CanBus):
    """A bus on python-can's ``virtual`` interface, with the wire's other end."""

    numbers = itertools.count()

    def __init__(self) -> None:
        channel = f"contract-{os.getpid()}-{next(self.numbers)}"
        self.wire = VirtualCan(channel, self._heard)
        wire = LateWire(self._begin)
        super().__init__(name="drive", wire=wire)
        self.silent = False
        self.latency = 0.0

    async def _begin(self, _bus: Bus) -> VirtualCan:
        await self.wire.start()
        return self.wire

    async def close(self) -> None:
        await super().close()
        await self.wire.stop()

    def _heard(self, frame: Frame) -> None:
        if frame.id == 0x101 and not self.silent:
            self.wire.send(Frame(0x181, b"pong"))
        elif frame.id == QUESTION:
            loop = asyncio.get_running_loop()
            answer = Frame(ANSWER, frame.data)
            loop.call_later(self.latency, self.wire.send, answer)

    def unplug(self) -> None:
        self.wire.unplug()

    def plug(self) -> None:
        self.wire.plug()

    def stall(self) -> None:
        self.silent = True

    def resume(self) -> None:
        self.silent = False


@pytest.mark.real_clock
class TestPythonCan(Asked, BusContract):
    """With a thread that reads and an executor that sends, in real time."""

    def make(self) -> OnVirtualCan:
        return OnVirtualCan()

    async def use(self, bus: Any) -> None:
        await ask(bus)

    async def delay(self, bus: Any, seconds: float) -> None:
        bus.latency = seconds
