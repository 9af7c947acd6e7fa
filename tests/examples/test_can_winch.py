"""The winch, with a drive that has no motor."""

import asyncio

import can_winch
import pytest

from esair.drivers.canopen.drive import State
from esair.drivers.canopen.fake_drive import FakeDrive
from esair.testing import FakeCan

pytestmark = pytest.mark.virtual_clock


@pytest.mark.long
async def test_it_lifts_to_the_top_and_lowers_to_the_bottom() -> None:
    """And stands without torque once it is over."""
    can = FakeCan("drive")
    drive = FakeDrive(can)
    seen = []
    async with can_winch.make_robot(can):
        for _ in range(300):
            await asyncio.sleep(0.1)
            seen.append(drive.position * can_winch.UNIT)
            if len(seen) == 10:
                assert drive.drive_state is State.ENABLED
    await asyncio.sleep(0.5)

    assert can_winch.TOP <= max(seen) < can_winch.TOP + 3
    assert can_winch.BOTTOM - 3 < min(seen[150:]) <= can_winch.BOTTOM + 2
    assert (drive.velocity, drive.drive_state) == (0, State.DISABLED)
    drive.stop()
