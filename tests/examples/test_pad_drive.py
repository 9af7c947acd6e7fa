"""Driving with a pad that a test moves, and drives without motors."""

import asyncio

import pad_drive
import pytest

from esair.drivers.canopen.fake_drive import FakeDrive
from esair.drivers.gamepad import Gamepad
from esair.drivers.gamepad.fake import FakeGamepad
from esair.testing import FakeCan

pytestmark = pytest.mark.virtual_clock


async def test_it_drives_while_the_shoulder_is_held() -> None:
    """And stands when it is let go, or the pad is pulled."""
    can = FakeCan("drive")
    left, right = FakeDrive(can, node=5), FakeDrive(can, node=6)
    hands = FakeGamepad()
    pad = Gamepad(name="pad", opener=hands.open, dead_man="tl")
    async with pad_drive.make_robot(can, pad):
        hands.move("y", 1.0)
        await asyncio.sleep(1.0)
        assert left.velocity == right.velocity == 0
        hands.press("tl")
        await asyncio.sleep(2.5)
        assert (left.velocity, right.velocity) == (10_000, -10_000)
        hands.release("tl")
        await asyncio.sleep(1.0)
        assert left.velocity == right.velocity == 0
        hands.press("tl")
        hands.move("y", 0.0)
        hands.move("x", 1.0)
        await asyncio.sleep(2.5)
        assert (left.velocity, right.velocity) == (5_000, 5_000)
        hands.unplug()
        await asyncio.sleep(1.0)
        assert left.velocity == right.velocity == 0
    left.stop()
    right.stop()
