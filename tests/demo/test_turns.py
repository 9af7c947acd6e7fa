"""The rover of the demo explores, docks and charges, in turns."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

import pytest

import esair
from esair.config import build, load
from esair.demo import Charge, Home
from esair.demo._show import _robot_file
from esair.drivers.wheel_motor import LEFT, RIGHT, command_id, decode_command
from esair.journal import Event, Kind
from esair.sim import Simulation

SIDES = {command_id(side): side for side in (LEFT, RIGHT)}


@pytest.mark.long
@pytest.mark.virtual_clock
@pytest.mark.promise("MODE-1", "MODE-3")
async def test_the_rover_explores_docks_and_charges_by_modes() -> None:
    """Sent to the dock it goes there, charges standing still, and explores again."""
    async with Simulation(seed=3) as simulation:
        robot = build(load(_robot_file(), simulated=True))
        changes: list[Event] = []
        robot.journal.listen(changes.append, kinds=(Kind.MODE,))

        def moving(since: float, until: float = math.inf) -> bool:
            return any(
                since <= when < until
                and frame.id in SIDES
                and decode_command(SIDES[frame.id], frame.data).enable
                and decode_command(SIDES[frame.id], frame.data).speed
                for when, frame in simulation.frames
            )

        async def until(condition: Callable[[], bool], seconds: float) -> None:
            async with asyncio.timeout(seconds):
                while not condition():  # noqa: ASYNC110 - the clock is virtual
                    await asyncio.sleep(0.05)

        async with robot:
            assert robot.behaviors.mode == "explore"
            await asyncio.sleep(8.0)
            assert moving(4.0)
            await robot.behaviors.command("mode dock")
            home, charge = map(robot.behaviors.action, ("dock", "charge"))
            assert isinstance(home, Home)
            assert isinstance(charge, Charge)
            await until(lambda: robot.behaviors.mode == "charge", 60.0)
            assert home.arrived
            x, y, _ = simulation.world.arena.start
            assert (
                math.dist((simulation.world.pose.x, simulation.world.pose.y), (x, y))
                < 0.5
            )
            began = simulation.time
            await until(lambda: robot.behaviors.mode == "explore", 25.0)
            assert charge.level >= 1.0
            assert not moving(began + 0.2, simulation.time - 0.1)
            states = {n: robot.behaviors.query(n).state for n in ("dock", "charge")}
            assert set(states.values()) == {esair.BehaviorState.RESTING}
            began = simulation.time
            await asyncio.sleep(3.0)
            assert moving(began)
    assert [each.component for each in changes] == ["dock", "charge", "explore"]
