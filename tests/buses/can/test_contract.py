"""The contract of buses, on a CAN bus in memory and on python-can's virtual one."""

from __future__ import annotations

import asyncio
import itertools
import os
from collections.abc import Callable
from typing import Any

import can
import pytest
from tests.buses.can.asked import ANSWER, QUESTION, Asked

from esair.buses import CanBus, Frame, python_can
from esair.buses.can import CanWire, FrameLink
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


class Plug(CanWire):
    """Where the bus is plugged into python-can's ``virtual`` interface."""

    def __init__(self, channel: str) -> None:
        super().__init__()
        self.channel = channel
        self.plugged = True
        self.bus: CanBus
        self.gone: Callable[[Exception], None]

    async def open(
        self, received: Callable[[Frame], None], gone: Callable[[Exception], None]
    ) -> FrameLink:
        if not self.plugged:
            raise ConnectionError("it is unplugged")
        self.gone = gone
        opener = python_can("virtual", self.channel, executor=self.bus.executor)
        return await opener(received, gone)


class OnVirtualCan(CanBus):
    """A bus on python-can's ``virtual`` interface; python-can is its other end too."""

    numbers = itertools.count()

    def __init__(self) -> None:
        self.plug_ = Plug(f"contract-{os.getpid()}-{next(self.numbers)}")
        super().__init__(name="drive", wire=self.plug_)
        self.plug_.bus = self
        self.silent = False
        self.latency = 0.0
        self.peer: can.BusABC | None = None

    async def _open(self) -> None:
        if self.peer is None:
            self.peer = can.Bus(interface="virtual", channel=self.plug_.channel)
            loop = asyncio.get_running_loop()
            self.notifier = can.Notifier(self.peer, [self._heard], loop=loop)
        await super()._open()

    async def close(self) -> None:
        await super().close()
        if self.peer is not None:
            await asyncio.to_thread(self.notifier.stop)
            self.peer.shutdown()
            self.peer = None

    def _heard(self, message: can.Message) -> None:
        if message.arbitration_id == 0x101 and not self.silent:
            self._answer(0x181, b"pong")
        elif message.arbitration_id == QUESTION:
            loop = asyncio.get_running_loop()
            loop.call_later(self.latency, self._answer, ANSWER, bytes(message.data))

    def _answer(self, number: int, data: bytes) -> None:
        if self.peer is not None:
            self.peer.send(
                can.Message(arbitration_id=number, data=data, is_extended_id=False)
            )

    def unplug(self) -> None:
        self.plug_.plugged = False
        self.plug_.gone(ConnectionError("it was unplugged"))

    def plug(self) -> None:
        self.plug_.plugged = True

    def stall(self) -> None:
        self.silent = True

    def resume(self) -> None:
        self.silent = False


@pytest.mark.long
@pytest.mark.real_clock
class TestPythonCan(Asked, BusContract):
    """With a thread that reads and an executor that sends, in real time."""

    def make(self) -> OnVirtualCan:
        return OnVirtualCan()

    async def use(self, bus: Any) -> None:
        await ask(bus)

    async def delay(self, bus: Any, seconds: float) -> None:
        bus.latency = seconds
