"""What drives by hand over a gap: only input from after it moves the wheels again."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair.seat._operator import Console
from esair.testing import FakeActuator

pytestmark = pytest.mark.virtual_clock


class Hand:
    """Hears beats, and that its lease is over."""

    def __init__(self) -> None:
        self.newest = 0
        self.over = False

    def beat(self, number: int) -> None:
        self.newest = number

    def lapsed(self, _lease: Any) -> None:
        self.over = True


@pytest.mark.promise("OPS-4", "ROB-4", "RES-2")
@pytest.mark.fault("T02")
@pytest.mark.parametrize("gap", ["halted", "lost", "replaced", "slept"])
async def test_what_was_pressed_before_a_gap_moves_nothing_after_it(gap: str) -> None:
    """The lease goes on, unless the computer slept; what it repeats does not."""
    loop: Any = asyncio.get_running_loop()
    hand, wheels = Hand(), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        leases = Console(robot).leases
        lease = leases.take("wheels", 0.5, hand)
        await asyncio.sleep(0.11)

        async def press(beat: int) -> object:
            return await leases.drive(lease.number, hand, beat, lambda _wheels: 1.0)

        assert await press(hand.newest)
        before = hand.newest
        await asyncio.sleep(0.05)
        if gap == "halted":
            robot.halt("a cat")
            await asyncio.sleep(0.02)
            robot.resume()
        elif gap == "lost":
            wheels.unplug()
            await asyncio.sleep(0.02)
            wheels.plug()
        elif gap == "replaced":
            wheels = FakeActuator("wheels", safe=0.0)
            await robot.resources.replace("wheels", wheels)
        else:
            loop.suspend(60.0)
        await asyncio.sleep(0.07)  # of a sleep one hears at the next step
        assert wheels.commands[-1] == 0.0
        count = len(wheels.commands)
        await asyncio.sleep(0.2)
        assert 1.0 not in wheels.commands[count:]
        if gap == "slept":
            assert hand.over
            lease = leases.take("wheels", 0.5, hand)
            with pytest.raises(esair.BadValueError, match="older than"):
                await press(before)
            await asyncio.sleep(0.11)
        assert await press(hand.newest)
        assert wheels.commands[-1] == 1.0
        leases.close()


@pytest.mark.promise("OPS-4", "ROB-4")
async def test_what_waited_for_a_slow_device_is_not_sent_after_a_halt() -> None:
    """Resume is the start button: nothing from before leaves, however soon it comes."""
    hand, wheels = Hand(), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        leases = Console(robot).leases
        lease = leases.take("wheels", 2.0, hand)
        await asyncio.sleep(0.11)
        wheels.slow(0.1)

        async def press(speed: float) -> object:
            return await leases.drive(
                lease.number, hand, hand.newest, lambda _wheels: speed
            )

        first = asyncio.create_task(press(1.0))
        await asyncio.sleep(0.01)
        second = asyncio.create_task(press(2.0))
        await asyncio.sleep(0.05)
        robot.halt("a cat")
        robot.resume()
        await asyncio.sleep(1.0)
        assert 2.0 not in wheels.commands
        assert not second.result()
        assert first.result()
        leases.close()
