"""Robots in one network, each a process of its own, linked by their files."""

from __future__ import annotations

import pytest
from tests.net.fleet import fleet

pytest.importorskip("zenoh")
pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.xdist_group("zenoh"),
    pytest.mark.promise("NET-2", "NET-3"),
]


@pytest.mark.long
def test_three_robots_use_each_other() -> None:
    """Each sees both others, and drives the next one."""
    found = fleet(3, 1.0)

    assert len(found.robots) == 3
    assert all(one.took for one in found.robots), found


@pytest.mark.soak
@pytest.mark.parametrize("near", [2, 0])
def test_twenty_robots_lose_nobody(near: int) -> None:
    """Each sees its neighbors, or all others, for a while, and nobody is lost."""
    found = fleet(20, 20.0, near)

    assert len(found.robots) == 20
    assert sum(one.lost for one in found.robots) == 0, found
    assert all(one.took for one in found.robots), found
