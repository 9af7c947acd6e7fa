"""Driving with a pad that a test moves, and drives without motors."""

import asyncio

import pad_drive
import pytest

from esair.drivers.canopen.fake_drive import FakeDrive
from esair.drivers.gamepad import Gamepad
from esair.drivers.gamepad.fake import FakeGamepad
from esair.testing import FakeCan

pytestmark = pytest.mark.virtual_clock


@pytest.mark.long
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


async def test_start_goes_to_the_other_mode_and_back() -> None:
    """One press, one switch; the stick has no say while the robot turns by itself."""
    can = FakeCan("drive")
    left, right = FakeDrive(can, node=5), FakeDrive(can, node=6)
    hands = FakeGamepad()
    pad = Gamepad(name="pad", opener=hands.open, dead_man="tl")
    async with pad_drive.make_robot(can, pad) as robot:
        hands.press("start")
        await asyncio.sleep(2.0)
        hands.release("start")
        await asyncio.sleep(1.0)
        assert robot.behaviors.mode == "turn"
        assert left.velocity == right.velocity == 2_000
        hands.press("start")
        await asyncio.sleep(2.0)
        assert robot.behaviors.mode == "drive"
        assert left.velocity == right.velocity == 0
    left.stop()
    right.stop()
