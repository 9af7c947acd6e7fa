"""What every bus promises, kept by the I²C bus on fakes."""

from __future__ import annotations

from typing import Any

import pytest

from esair.testing import BusContract, FakeI2c


class TestFakeI2c(BusContract):
    """On the virtual clock, in the event loop."""

    timeout = 0.1

    def make(self) -> FakeI2c:
        numbers = bytes(range(256))
        return FakeI2c(
            chips={0x68: {0x75: 0x68}, 0x40: b"", 0x41: numbers}, timeout=self.timeout
        )

    async def ask(self, bus: Any, number: int) -> int:
        return int((await bus.read(0x41, number))[0])

    async def delay(self, bus: Any, seconds: float) -> None:
        bus.stretch(seconds)

    async def use(self, bus: Any) -> None:
        await bus.write(0x40, 0x06, b"\x12\x34")
        assert await bus.read(0x40, 0x06, 2) == b"\x12\x34"
        assert await bus.transfer(0x68, b"\x75", read=1) == b"\x68"


class TestUnnoticedLoss(TestFakeI2c):
    """Nobody tells that the adapter has gone: the next transfer finds out."""

    async def unplug(self, bus: Any) -> None:
        bus.unplug(noticed=False)


@pytest.mark.real_clock
class TestFakeI2cOnItsThread(TestFakeI2c):
    """On the real clock, through the bus's thread."""

    timeout = 0.5  # ten times the longest delay: the computer may be busy
