"""What a picture is made of is as much for any recording, and no peak is lost."""

from __future__ import annotations

import math

import pytest

from esair.cli._plot import NAMES, POINTS, Seen, Track
from esair.recording import Recorded

pytestmark = pytest.mark.promise("REC-6")


@pytest.mark.parametrize("count", [10, POINTS, 100_003])
def test_a_track_keeps_its_peaks(count: int) -> None:
    """However many points it had: the greatest, the least, the first and the last."""
    track = Track()
    for number in range(count):
        track.add(float(number), math.sin(number / 50))
    track.add(float(count), 0.0)
    for number in range(3 * count):
        track.add(float(count + 1 + number), 7.0 if number == count else -0.1)
    points = track.all()

    assert len(points) <= 2 * POINTS
    assert points == sorted(points)
    assert points[0] == (0.0, 0.0)
    assert points[-1] == (4.0 * count, -0.1)
    assert max(points, key=lambda each: each[1]) == (2.0 * count + 1, 7.0)
    if count <= POINTS // 5:
        assert len(points) == 4 * count + 1


def test_names_and_holders_are_bounded() -> None:
    """A recording of a stranger may name as many as it likes."""
    seen = Seen(None)
    for number in range(30_000):
        value = {"x": number}
        seen.take(
            Recorded(
                number, number, "sent", f"w{number % 500:03}", f"p{number}", value, ""
            )
        )
        seen.take(Recorded(number, number, "crashed", "a", "", None, ""))
        seen.take(Recorded(number, number, "up", f"u{number}", "", None, ""))

    assert len(seen._came_up) <= len(seen.named) == NAMES
    assert len(seen.tracks) == len(seen.holders) == 24
    assert sorted(seen.tracks)[0] == "w000.x"
    assert len(seen.marks) == 1000
    assert seen.end == 29_999
