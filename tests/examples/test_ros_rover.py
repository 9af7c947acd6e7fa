"""A rover that ROS drives and sees: the file of the how-to, with a graph in memory."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.ros.parts import twist

import esair
from esair.buses.ros import FakeRos
from esair.config import check

FILE = Path(__file__).parents[2] / "examples" / "ros_rover" / "robot.toml"

pytestmark = pytest.mark.virtual_clock


@pytest.fixture
def rover(monkeypatch: pytest.MonkeyPatch) -> tuple[Any, FakeRos]:
    """The robot of the file on a floor of its own, with ROS in memory."""
    robot: Any = esair.Robot.from_config(FILE)
    parts = sys.modules["ros_rover"]
    monkeypatch.setattr(parts, "floor", parts.Floor())
    (bus,) = {each.bus for each in robot.plan.resources if each.name == "ros"}
    bus.network.begin = ros = FakeRos()
    return robot, ros


def newest(ros: FakeRos, topic: str) -> Any:
    return [message for name, message in ros.published if name == topic][-1]


async def drive(ros: FakeRos, linear: float, seconds: float) -> None:
    """Press a key, as teleop_twist_keyboard tells it."""
    for _ in range(round(10 * seconds)):
        ros.publish("/cmd_vel", twist(linear))
        await asyncio.sleep(0.1)


def test_the_file_is_sound() -> None:
    """The rulebook knows all that it stands for."""
    assert [each for each in check(FILE).findings if each.severity == "error"] == []


@pytest.mark.promise("ROS-1", "ROS-2")
async def test_teleop_drives_and_the_wall_stops(rover: tuple[Any, FakeRos]) -> None:
    """ROS sees where it is; a key that is held drives to 0.3 m before the wall, no further."""
    robot, ros = rover
    async with robot:
        await asyncio.sleep(1.0)
        await drive(ros, 0.4, 2.0)
        assert robot.resources.why("wheels").holder == "ros:/cmd_vel"
        odometry = newest(ros, "/odom")
        assert odometry["pose"]["pose"]["position"]["x"] == pytest.approx(0.8, abs=0.15)
        (moved,) = newest(ros, "/tf")["transforms"]
        assert moved["child_frame_id"] == "base_link"
        await drive(ros, 0.4, 20.0)
        scan = newest(ros, "/scan")
        assert 0.29 <= scan["ranges"][0] <= 0.4
        assert scan["header"]["frame_id"] == "base_link"


@pytest.mark.promise("ROS-1", "ROS-2")
async def test_a_service_drives_above_the_keys(rover: tuple[Any, FakeRos]) -> None:
    """It is answered once it is done; nobody else moves the wheels meanwhile."""
    robot, ros = rover
    async with robot:
        await asyncio.sleep(1.0)
        await drive(ros, 0.4, 3.0)
        asked = ros.call("/go_home", {})
        await drive(ros, 0.4, 1.0)
        assert robot.resources.why("wheels").holder == "home"
        assert await asked == ("answered", None)
        await asyncio.sleep(0.2)
        at = newest(ros, "/odom")["pose"]["pose"]["position"]
        assert abs(at["x"]) < 0.25
        assert abs(at["y"]) < 0.25
