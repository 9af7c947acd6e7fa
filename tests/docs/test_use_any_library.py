"""The line follower of the page, without a Pi."""

import sys
from pathlib import Path

import pytest

import esair
from esair.config import check

CODE = Path(__file__).parents[2] / "docs" / "code"
sys.path.insert(0, str(CODE))

from line_follower import ClearLeft, ClearRight, Follow  # noqa: E402


async def test_it_turns_to_the_line(fake_sensor, fake_actuator):
    """The wheel on the side of the line slows down; a wall stops both."""
    left_line, right_line = (
        fake_sensor("left_line", False),
        fake_sensor("right_line", True),
    )
    ahead = fake_sensor("ahead", 2.0, rate=20.0)
    left, right = fake_actuator("left", safe=0.0), fake_actuator("right", safe=0.0)
    robot = esair.Robot(
        resources=[left_line, right_line, ahead, left, right],
        behaviors=[Follow(), ClearLeft(), ClearRight()],
    )

    async with robot:
        await right.until(0.1, timeout=0.5)
        assert left.commands[-1] == 0.4
        ahead.feed(0.1)
        await left.until(0.0, timeout=0.2)
        await right.until(0.0, timeout=0.2)


def test_the_robot_of_the_page_has_no_mistake() -> None:
    """All of its parts are used; 40 lines of code are enough."""
    pytest.importorskip("gpiozero", reason="the extra 'gpiozero' is missing")
    report = check(CODE / "line_follower.toml")

    assert report.errors == 0
    assert [str(found) for found in report.findings if found.rule == "unused"] == []
    lines = (CODE / "line_follower.py").read_text().splitlines()
    assert len([line for line in lines if line.strip()]) <= 40
