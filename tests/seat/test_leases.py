"""A lease, and the input that renews it, at the very moment when they are over."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

import esair
from esair.seat._leases import LONGEST, Lease, Leases
from esair.testing import FakeActuator

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("OPS-4")]

HAIR = 2.0**-20


class Hand:
    """Somebody who drives, and notes which leases are over."""

    def __init__(self) -> None:
        self.over: list[int] = []

    def beat(self, number: int) -> None: ...

    def lapsed(self, lease: Lease) -> None:
        self.over.append(lease.number)


async def fast(leases: Leases, lease: Lease, hand: Hand, beat: int) -> Any:
    return await leases.drive(lease.number, hand, beat, lambda _resource: 0.5)


@contextlib.asynccontextmanager
async def leased(wheels: FakeActuator[float]) -> AsyncIterator[Leases]:
    """Begin at a moment from which sums of such fractions are exact."""
    async with esair.Robot(resources=[wheels]) as robot:
        leases = Leases(robot.resources, robot.actuators, "operator", 1000)
        await asyncio.sleep(-asyncio.get_running_loop().time() % 1.0 + 1.0)
        yield leases
        leases.close()


@pytest.mark.parametrize("early", [HAIR, 0.0])
async def test_a_lease_is_over_in_the_moment_until_which_it_lasts(early: float) -> None:
    """A hair before, input drives; in the moment itself it does not any more."""
    wheels, hand = FakeActuator("wheels", safe=0.0, command_timeout=5.0), Hand()
    async with leased(wheels) as leases:
        lease, beat = leases.take("wheels", 0.5, hand), leases.beats.next()
        await asyncio.sleep(0.5 - early)
        if early:
            assert await fast(leases, lease, hand, beat)
        else:
            with pytest.raises(esair.BadValueError, match="lapsed"):
                await fast(leases, lease, hand, beat)
        await asyncio.sleep(0.01)
        assert (leases.lapses, hand.over) == (1, [lease.number])
        assert (0.5 in wheels.commands) is bool(early)
        assert wheels.commands[-1] == 0.0


@pytest.mark.parametrize("early", [HAIR, 0.0])
async def test_input_is_as_old_as_the_beat_that_it_answers(early: float) -> None:
    """With the time of a lease it is too old, however long that one lasts still."""
    wheels, hand = FakeActuator("wheels", safe=0.0, command_timeout=5.0), Hand()
    async with leased(wheels) as leases:
        lease, old = leases.take("wheels", 0.5, hand), leases.beats.next()
        await asyncio.sleep(0.25)
        assert await fast(leases, lease, hand, leases.beats.next())
        await asyncio.sleep(0.25 - early)
        wheels.commands.clear()
        if early:
            assert await fast(leases, lease, hand, old)
        else:
            with pytest.raises(esair.BadValueError, match="older than"):
                await fast(leases, lease, hand, old)
        assert (leases.stale, 0.5 in wheels.commands) == (not early, bool(early))


async def test_a_lease_may_last_as_long_as_the_longest() -> None:
    """And no longer, without fresh input."""
    async with leased(FakeActuator("wheels", safe=0.0)) as leases:
        assert leases.take("wheels", LONGEST, Hand()).seconds == LONGEST
        with pytest.raises(esair.BadValueError, match="at most 2"):
            leases.take("wheels", LONGEST + HAIR, Hand())
