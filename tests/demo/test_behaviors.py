"""The rover's decisions, one at a time."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import esair
from esair.demo import Avoid, Belief, Bump, Explore, Home, Scan, Touch, Twist
from esair.demo._journeys import follow
from esair.demo._plan import (
    FloorMap,
    Position,
    Way,
    is_blocked,
    is_worth_while,
    way_to,
    way_to_frontier,
)
from esair.testing._fakes import FakeActuator, FakeSensor

Sensors = Callable[..., FakeSensor[Any]]
Actuators = Callable[..., FakeActuator[Any]]

STEP = math.radians(6)
STOP = Twist(0.0, 0.0)


def scan(default: float = math.inf, **near: float) -> Scan:
    """Make a sweep of 41 beams; ``left``, ``right`` and ``ahead`` are nearer."""
    places = {"right": range(8, 20), "ahead": range(19, 22), "left": range(21, 33)}
    ranges = [default] * 41
    for side, distance in near.items():
        for beam in places[side]:
            ranges[beam] = distance
    return Scan(-20 * STEP, STEP, tuple(ranges))


def floor(size: tuple[float, float] = (4.0, 3.0)) -> FloorMap:
    """Make a map of a floor that is all free, with walls around."""
    made = FloorMap.empty(size)
    made.odds[:] = 3.0
    bottom, left = made.cell_of(0.0, 0.0)
    top, right = made.cell_of(*size)
    made.odds[bottom:top, left:right] = -3.0
    return made


# Reactions.


def test_avoid_has_no_opinion_on_free_space() -> None:
    """Others drive while nothing is near."""
    assert Avoid().react(scan(2.0)) is None
    assert Avoid().react(scan()) is None


@pytest.mark.parametrize(("side", "sign"), [("left", -1), ("right", 1)])
def test_avoid_turns_to_the_side_with_more_room(side: str, sign: int) -> None:
    """Without driving on."""
    command = Avoid().react(scan(2.0, **{side: 0.2}))

    assert command is not None
    assert command.linear == 0.0
    assert math.copysign(1, command.angular) == sign


def test_avoid_goes_the_way_that_it_has_found_free() -> None:
    """It does not give the wheels back to whoever wants to go into the wall again."""
    avoid = Avoid()
    avoid.react(scan(2.0, ahead=0.2))
    turning = avoid.react(scan(2.0, ahead=0.3))
    leaving = [avoid.react(scan(2.0)) for _ in range(Avoid.LEAVE + 1)]

    assert turning is not None
    assert turning.angular != 0.0
    assert leaving[:-1] == [Twist(0.3, 0.0)] * Avoid.LEAVE
    assert leaving[-1] is None


def test_bump_backs_off_and_then_gives_the_wheels_back() -> None:
    """Turning away from the side that was touched; once for each touch."""
    bump = Bump()

    commands = [bump.react(Touch(True, False))]
    while commands[-1] is not None:
        commands.append(bump.react(Touch(False, False)))

    backing = [command for command in commands if command is not None]
    assert len(backing) == Bump.BACK_OFF
    assert all(each.linear < 0 and each.angular < 0 for each in backing)
    assert bump.bumps == 1


# The map.


def test_a_sweep_makes_free_what_it_looked_through_and_marks_where_it_ended() -> None:
    """A wall a metre ahead: free up to it, occupied there, unknown behind."""
    made = FloorMap.empty((4.0, 3.0))
    here = Position(1.0, 1.5, 0.0)
    angles = np.linspace(-0.2, 0.2, 9)

    for _ in range(3):
        made.see(here, angles, 1.0 / np.cos(angles), reach=2.5)

    assert made.free[made.cell_of(1.5, 1.5)]
    assert made.occupied[made.cell_of(2.01, 1.5)]
    assert made.odds[made.cell_of(2.3, 1.5)] == 0.0
    assert not made.occupied[made.cell_of(1.9, 1.5)]


def test_what_was_felt_stays_however_often_it_is_looked_over() -> None:
    """The range finder looks over what is low; the bumper does not lie."""
    made = FloorMap.empty((4.0, 3.0))
    here = Position(1.0, 1.5, 0.0)
    angles, nothing = np.linspace(-0.3, 0.3, 13), np.full(13, np.inf)
    for _ in range(20):
        made.see(here, angles, nothing, reach=2.5)

    made.feel(1.8, 1.5, 0.0)
    for _ in range(20):
        made.see(here, angles, nothing, reach=2.5)

    assert made.occupied[made.cell_of(1.8, 1.5)]
    assert made.free[made.cell_of(1.5, 1.5)]


def test_a_copy_of_the_map_stays_as_it_is() -> None:
    """Whoever asked the mapper does not see the map change under its hands."""
    made = floor()
    copy = made.copy()

    made.odds[:] = 0.0

    assert copy.known((4.0, 3.0)) == 1.0
    assert made.known((4.0, 3.0)) == 0.0


# Ways.


def test_a_way_keeps_clear_of_walls_and_goes_around_them() -> None:
    """Through the gap, not through the wall, and a quarter of a metre from both."""
    made = floor()
    row, column = made.cell_of(2.0, 2.0)
    made.odds[:row, column] = 3.0
    here = Position(0.6, 0.6, 0.0)

    way = way_to(made, here, (3.4, 0.6))

    assert way is not None
    assert math.dist(way.goal, (3.4, 0.6)) < 0.1
    assert max(y for _, y in way.points) > 2.2
    assert all(0.2 < x < 3.8 and 0.2 < y < 2.8 for x, y in way.points)
    assert not is_blocked(made, here, way)


def test_there_is_no_way_to_what_is_walled_in() -> None:
    """None is said at once; nobody drives towards it."""
    made = floor()
    _, column = made.cell_of(2.0, 2.0)
    made.odds[:, column] = 3.0

    assert way_to(made, Position(0.6, 0.6, 0.0), (3.4, 0.6)) is None


def test_a_wall_that_appears_blocks_the_way() -> None:
    """So a new one is looked for."""
    made = floor()
    here = Position(0.6, 1.5, 0.0)
    way = way_to(made, here, (3.4, 1.5))
    assert way is not None

    row, column = made.cell_of(2.0, 1.5)
    made.odds[row - 5 : row + 5, column] = 3.0

    assert is_blocked(made, here, way)


def test_the_frontier_is_where_the_known_floor_ends() -> None:
    """It is gone to while it is worth while, and not if it was tried in vain."""
    made = floor()
    _, column = made.cell_of(2.5, 1.5)
    made.odds[:, column:] = 0.0
    here = Position(0.6, 1.5, 0.0)

    way = way_to_frontier(made, here)

    assert way is not None
    assert 2.1 < way.goal[0] < 2.7
    assert is_worth_while(made, way.goal)
    assert not is_worth_while(made, (1.0, 1.5))
    other = way_to_frontier(made, here, avoid=(way.goal,))
    assert other is None or math.dist(other.goal, way.goal) > 0.25
    assert way_to_frontier(floor(), here) is None


@pytest.mark.parametrize(
    ("heading", "linear", "angular"),
    [(0.0, 0.55, 0.0), (0.5, 0.4, -1.2), (3.0, 0.0, -2.0)],
)
def test_a_way_is_followed_by_turning_first(
    heading: float, linear: float, angular: float
) -> None:
    """The further off the direction, the slower; backwards it turns on the spot."""
    way = Way(tuple((x / 20, 0.0) for x in range(60)))

    command = follow(way, Position(0.0, 0.0, heading))

    assert command.linear == pytest.approx(linear, abs=0.05)
    assert command.angular == pytest.approx(angular, abs=0.05)


# Journeys, in a robot.


class StandInMapper(esair.Behavior):
    """Believes what a test says."""

    def __init__(self, position: Position) -> None:
        super().__init__(name="mapper")
        made = floor()
        _, column = made.cell_of(2.5, 1.5)
        made.odds[:, column:] = 0.0
        self.belief = Belief(position, made, settled=True)

    async def provide(self) -> Belief:
        return self.belief


async def test_explore_drives_only_while_it_can_see(
    fake_sensor: Sensors, fake_actuator: Actuators
) -> None:
    """The wheels stop as the range finder goes, and move again when it is back."""
    ranges = fake_sensor("ranges", scan(2.0), type=Scan, rate=20.0)
    wheels = fake_actuator("wheels", safe=STOP)
    explore = Explore()
    mapper = StandInMapper(Position(0.6, 1.5, 0.0))

    async with esair.Robot(resources=[ranges, wheels], behaviors=[mapper, explore]):
        await wheels.until(lambda command: command.linear > 0.3, timeout=1.0)
        ranges.unplug()
        await asyncio.sleep(0.1)
        told = len(wheels.commands)
        assert wheels.commands[-1] == STOP
        await asyncio.sleep(2.0)
        assert all(command == STOP for command in wheels.commands[told:])
        ranges.plug()
        await wheels.until(lambda command: command.linear > 0.3, timeout=2.0)

    assert wheels.commands[-1] == STOP
    assert explore.blind > 20


async def test_home_ends_where_it_should(
    fake_sensor: Sensors, fake_actuator: Actuators
) -> None:
    """It does not move when it is there."""
    ranges = fake_sensor("ranges", scan(2.0), type=Scan, rate=20.0)
    wheels = fake_actuator("wheels", safe=STOP)
    home = Home(place=(0.7, 1.5))
    mapper = StandInMapper(Position(0.65, 1.5, 0.0))

    async with esair.Robot(
        resources=[ranges, wheels], behaviors=[mapper, home]
    ) as robot:
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("home").state is esair.BehaviorState.FINISHED

    assert home.arrived
    assert set(wheels.commands) == {STOP}


async def test_explore_waits_for_a_mapper(
    fake_sensor: Sensors, fake_actuator: Actuators
) -> None:
    """Without an answer nothing moves, and nothing crashes."""
    ranges = fake_sensor("ranges", scan(2.0), type=Scan, rate=20.0)
    wheels = fake_actuator("wheels", safe=STOP)

    async with esair.Robot(resources=[ranges, wheels], behaviors=[Explore()]) as robot:
        await asyncio.sleep(1.0)
        status = robot.behaviors.query("explore")

    assert status.state is esair.BehaviorState.RUNNING
    assert status.restarts == 0
    assert set(wheels.commands) == {STOP}
