"""What every bus promises, kept by the SPI bus on fakes."""

from __future__ import annotations

from typing import Any

import pytest

from esair.buses.spi import FakeSpi
from esair.testing import BusContract


class TestFakeSpi(BusContract):
    """On the virtual clock, in the event loop."""

    timeout = 0.1

    def make(self) -> FakeSpi:
        return FakeSpi(
            chips={0: {0x0F: 0x33}, 1: b"", 2: bytes(range(128))}, timeout=self.timeout
        )

    async def ask(self, bus: Any, number: int) -> int:
        return int((await bus.transfer(2, bytes((0x80 | number,)), read=1))[0])

    async def delay(self, bus: Any, seconds: float) -> None:
        bus.stretch(seconds)

    async def use(self, bus: Any) -> None:
        await bus.exchange(1, b"\x06\x12\x34")
        assert await bus.transfer(1, b"\x86", read=2) == b"\x12\x34"
        assert await bus.transfer(0, b"\x8f", read=1) == b"\x33"


class TestUnnoticedLoss(TestFakeSpi):
    """Nobody tells that the adapter has gone: the next transfer finds out."""

    async def unplug(self, bus: Any) -> None:
        bus.unplug(noticed=False)


@pytest.mark.real_clock
class TestFakeSpiOnItsThread(TestFakeSpi):
    """On the real clock, through the bus's thread."""

    timeout = 0.5  # ten times the longest delay: the computer may be busy
