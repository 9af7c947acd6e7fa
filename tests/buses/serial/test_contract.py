"""The serial bus keeps the published contract: in memory, on a terminal, on a URL."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from esair.buses import SerialBus
from esair.testing import BusContract, FakeSerial


class OnFakes(BusContract):
    """Asks a far end that echoes."""

    def make(self) -> FakeSerial:
        line = FakeSerial("front", write_timeout=0.2)
        line.on_frame = lambda message: b"echo " + message
        return line

    async def use(self, bus: Any) -> None:
        assert await bus.ask(b"hello", prefix=b"echo") == b"echo hello"

    async def ask(self, bus: Any, number: int) -> int:
        return int((await bus.ask(b"%d" % number, timeout=1.0)).removeprefix(b"echo "))

    async def delay(self, bus: Any, seconds: float) -> None:
        def answer(message: bytes) -> None:
            loop.call_later(seconds, bus.say, b"echo " + message)

        loop = asyncio.get_running_loop()
        bus.on_frame = answer


class TestInMemory(OnFakes):
    """On the virtual clock."""


@pytest.mark.real_clock
class TestOnATerminal(OnFakes):
    """On a pseudo-terminal, with the kernel, descriptors and a thread."""


@pytest.mark.real_clock
class TestOnAUrl(BusContract):
    """On pyserial's own loop, which has no descriptor: threads wait for it."""

    def make(self) -> SerialBus:
        return SerialBus(name="loop", port="loop://")

    async def use(self, bus: Any) -> None:
        assert await bus.ask(b"hello") == b"hello"
