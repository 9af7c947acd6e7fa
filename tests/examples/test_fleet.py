"""Three carriers ask each other, and two of them never charge at a time."""

from __future__ import annotations

import asyncio

import pytest
from fleet import fleet

import esair

pytestmark = pytest.mark.virtual_clock


@pytest.mark.long
@pytest.mark.promise("NET-2")
async def test_they_take_turns_at_the_charger() -> None:
    """Each of them is charged, and one at a time, also when one of them is cut off."""
    network, robots = fleet.fleet()
    ada, ben, cy = robots
    carries = []
    async with ada, ben, cy:
        for robot in robots:
            carry = robot.behaviors.action("carry")
            assert isinstance(carry, fleet.Carry)
            carries.append(carry)
        for step in range(260):
            await asyncio.sleep(0.1)
            assert sum(each.cell.is_charging for each in carries) <= 1
            if step == 120:
                before = [each.charged for each in carries]
                network.cut("ada")
            elif step == 160:
                network.heal()
        assert all(
            each.charged > once for each, once in zip(carries, before, strict=True)
        )
        state = ben.resources.query("ada_battery").state
        assert state is esair.ResourceState.READY
