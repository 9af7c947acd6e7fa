"""The physics of the rover."""

from __future__ import annotations

import math

import pytest

from esair.sim import Arena, Box, World

EMPTY = Arena(size=(4.0, 4.0), walls=(), boxes=(), pillars=(), start=(1.0, 2.0, 0.0))


def drive(world: World, left: float, right: float, seconds: float) -> None:
    """Tell the wheels their speeds in rad/s and let time pass."""
    world.target[:] = [left, right]
    for _ in range(round(seconds / 0.01)):
        world.step(0.01)


def test_equal_wheels_drive_straight() -> None:
    """8 rad/s on wheels of 5 cm are 0.4 m/s, but for the time to get there."""
    world = World(EMPTY)

    drive(world, 8.0, 8.0, 2.0)

    assert world.pose.x == pytest.approx(1.0 + 0.4 * (2.0 - 0.07), abs=0.02)
    assert world.pose.y == pytest.approx(2.0)
    assert world.distance == pytest.approx(world.pose.x - 1.0)


def test_opposite_wheels_turn_on_the_spot() -> None:
    """Forward on the right is counter-clockwise."""
    world = World(EMPTY)

    drive(world, -2.6, 2.6, 1.0)

    assert world.pose.heading == pytest.approx(1.0 * (1.0 - 0.07), abs=0.02)
    assert (world.pose.x, world.pose.y) == pytest.approx((1.0, 2.0))
    assert world.turn_rate == pytest.approx(1.0, abs=0.01)


def test_a_wall_stops_the_rover_and_is_felt() -> None:
    """It stands in front of the wall, not in it, and its wheels stand too."""
    world = World(EMPTY)

    drive(world, 10.0, 10.0, 8.0)

    assert world.pose.x == pytest.approx(4.0 - 0.16, abs=0.06)
    assert world.bumps == (True, True)
    turned = world.wheel_angle[0]
    drive(world, 10.0, 10.0, 1.0)
    assert world.wheel_angle[0] - turned < 0.5
    drive(world, -5.0, -5.0, 1.0)
    assert world.bumps == (False, False)


@pytest.mark.parametrize(
    ("offset", "felt"), [(0.13, (True, False)), (-0.13, (False, True))]
)
def test_the_side_that_touches_is_known(offset: float, felt: tuple[bool, bool]) -> None:
    """A box on the left is felt on the left."""
    arena = Arena(
        size=(4.0, 4.0), walls=(), pillars=(), start=(1.0, 2.0, 0.0),
        boxes=(Box((2.0, 2.0 + offset), (0.1, 0.1)),),
    )  # fmt: skip
    world = World(arena)
    world.target[:] = [8.0, 8.0]

    while world.bumps == (False, False) and world.time < 5.0:
        world.step(0.01)

    assert world.bumps == felt


def test_the_range_finder_sees_walls_and_looks_over_what_is_low() -> None:
    """Distances are from the rover's centre; nothing in reach is None."""
    low = Box((2.0, 2.0), (0.1, 1.0), low=True)
    world = World(
        Arena(
            size=(4.0, 4.0), walls=(), pillars=(), boxes=(low,), start=(1.0, 2.0, 0.0)
        )
    )

    assert world.distance_ahead(math.pi, 2.5) == pytest.approx(1.0, abs=0.04)
    assert world.distance_ahead(math.pi / 2, 2.5) == pytest.approx(2.0, abs=0.04)
    assert world.distance_ahead(0.0, 2.5) is None
    assert world.distance_ahead(0.0, 3.5) == pytest.approx(3.0, abs=0.04)


def test_what_is_low_is_felt() -> None:
    """The bumper finds what the range finder cannot see."""
    low = Box((2.0, 2.0), (0.1, 1.0), low=True)
    world = World(
        Arena(
            size=(4.0, 4.0), walls=(), pillars=(), boxes=(low,), start=(1.0, 2.0, 0.0)
        )
    )

    drive(world, 8.0, 8.0, 5.0)

    assert world.pose.x < 1.95
    assert world.bumps == (True, True)


def test_the_same_seed_gives_the_same_world() -> None:
    """To the last bit; another seed gives another."""

    def run(seed: int) -> list[float]:
        world = World(seed=seed)
        drive(world, 8.0, 6.0, 6.0)
        drive(world, -4.0, 6.0, 2.0)
        return [*world.wheel_angle, world.pose.x, world.pose.y, world.pose.heading]

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_the_wheels_tell_nearly_how_far_it_was() -> None:
    """Encoders are good, not perfect: within two per cent."""
    world = World(EMPTY)

    drive(world, 8.0, 8.0, 4.0)

    told = sum(world.wheel_angle) / 2 * 0.05
    assert told == pytest.approx(world.distance, rel=0.02)
    assert told != world.distance
