"""``[ros]`` in a robot.toml: what it stands for, and its mistakes."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.ros.parts import twist

import esair
from esair.buses.ros import READY, FakeRos, Joints, Odometry, Scan, form_of
from esair.cli._ros import lines_of
from esair.config import check, load

PARTS = """
import attrs

import esair


@attrs.frozen
class Motion:
    linear: float
    angular: float


@attrs.frozen
class Tracks:
    left: float
    right: float


@attrs.frozen
class Pose:
    x: float
    y: float
    heading: float


@attrs.frozen
class Dock(esair.Request[None]):
    pass


class Wheels(esair.Actuator[Motion]):
    safe = Motion(0.0, 0.0)
    told = []

    async def write(self, command):
        self.told.append(command)


class TrackDrive(esair.Actuator[Tracks]):
    safe = Tracks(0.0, 0.0)

    async def write(self, command):
        pass


class Where(esair.Sensor[Pose]):
    async def read(self):
        return Pose(1.0, 2.0, 0.0)


class Bumper(esair.Sensor[float]):
    async def read(self):
        return 0.0


class Docking(esair.Behavior):
    scan = esair.reads(object)
    docked = 0

    @esair.answers
    async def dock(self, request: Dock) -> None:
        self.docked += 1
"""

ROBOT = """
[robot]
name = "rover"

[ros]
python = "/opt/ros/bin/python3"
domain = 7

[ros.topics."/scan"]
type = "sensor_msgs/msg/LaserScan"
sensor = "scan"

[ros.topics."/cmd_vel"]
type = "geometry_msgs/msg/Twist"
drive = "wheels"
priority = 5

[ros.topics."/odom"]
type = "nav_msgs/msg/Odometry"
publish = "where"
rate = 10.0
frame = "odom"
child = "base_link"

[ros.topics."/tf"]
type = "tf2_msgs/msg/TFMessage"
publish = "where"
frame = "odom"
child = "base_link"

[ros.services."/dock"]
type = "std_srvs/srv/Trigger"
ask = "docking"
request = "MODULE:Dock"

[ros.services."/undock"]
type = "std_srvs/srv/Trigger"
behavior = "undock"
request = "MODULE:Dock"

[sensor.where]
driver = "MODULE:Where"

[sensor.bumper]
driver = "MODULE:Bumper"

[actuator.wheels]
driver = "MODULE:Wheels"

[behavior.docking]
driver = "MODULE:Docking"
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    module = f"ros_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{module}.py").write_text(PARTS)
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT.replace("MODULE", module))
    return path


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_a_sound_file_has_no_findings(file: Path) -> None:
    """The rulebook knows all that it stands for."""
    assert [each for each in check(file).findings if each.severity == "error"] == []


def test_a_topic_that_drives_needs_no_period(file: Path) -> None:
    """None of its commands is current for ever: there is nothing to be warned of."""
    keys = [each.key for each in check(file).findings if each.rule == "silent"]
    assert [key for key in keys if "cmd_vel" in key] == []


@pytest.mark.virtual_clock
@pytest.mark.promise("ROS-1")
async def test_what_it_stands_for(file: Path) -> None:
    """Topics drive, are heard and published, with frames; services both ways."""
    robot: Any = esair.Robot.from_config(file)
    (bus,) = {each.bus for each in robot.plan.resources if each.name in {"ros", "scan"}}
    assert bus.network.begin.python == "/opt/ros/bin/python3"
    assert bus.network.domain == 7
    ros = bus.network.begin = FakeRos()
    async with robot:
        await asyncio.sleep(1.0)
        for _ in range(10):
            ros.publish("/cmd_vel", twist(0.3, 0.5))
            await asyncio.sleep(0.02)
        why = robot.resources.why("wheels")
        assert (why.holder, why.priority) == ("ros:/cmd_vel", 5)
        assert (why.last.linear, why.last.angular) == (0.3, 0.5)
        assert robot.resources.query("scan").state is esair.ResourceState.READY
        assert await ros.call("/dock", {}) == ("answered", None)
    topics = dict(ros.published)
    assert topics["/odom"]["pose"]["pose"]["position"] == {"x": 1.0, "y": 2.0}
    assert topics["/odom"]["header"] == {"frame_id": "odom"}
    (moved,) = topics["/tf"]["transforms"]
    assert moved["child_frame_id"] == "base_link"
    assert moved["transform"]["rotation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


@pytest.mark.parametrize(
    ("old", "new", "key", "told"),
    [
        ('drive = "wheels"', 'drive = "weels"', "drive", "did you mean 'wheels'"),
        ('drive = "wheels"\n', "", "cmd_vel", "expected one of sensor, drive, publish"),
        ('"geometry_msgs/msg/Twist"', '"Twist"', "type", "'package/msg/Name'"),
        ('"/cmd_vel"', '"cmd_vel"', "cmd_vel", "the whole name of a topic"),
        ('ask = "docking"', 'ask = "dock"', "ask", "did you mean 'docking'"),
        ("MODULE:Wheels", "MODULE:TrackDrive", "cmd_vel", "Tracks.left is none of"),
        ("MODULE:Dock", "MODULE:Pose", "request", "not derived from esair.Request"),
        ("domain = 7", 'domain = "a"', "domain", "whole number"),
        ("domain = 7", "domain = -1", "domain", "expected 0 to 232"),
        ("domain = 7", 'namespace = "x y"', "namespace", "expected letters, digits"),
        ("domain = 7", 'node = "1st"', "node", "expected letters, digits"),
        ("priority = 5", "latched = true", "latched", "a command of before would"),
        ("priority = 5", "rate = 0", "topics.'/cmd_vel'.rate", "more than 0 and at"),
        ("rate = 10.0", "rate = -1.0", "topics.'/odom'.rate", "more than 0 and at"),
        ("priority = 5", 'frame = "map"', "cmd_vel", "Twist has no header.frame_id"),
        ('sensor = "scan"', 'publish = "bumper"', "scan", "is more than one float"),
        ("priority = 5", "priorty = 5", "priorty", "did you mean 'priority'"),
        ('sensor = "scan"', 'sensor = "where"', "scan", "a sensor 'where' already"),
        ('services."/dock"', 'services."/scan"', "services", "a topic '/scan' already"),
    ],
)
def test_a_mistake_is_found_before_anything_moves(
    file: Path, old: str, new: str, key: str, told: str
) -> None:
    """With its key, what was expected, and its line."""
    module = next(file.parent.glob("ros_*.py")).stem
    change(file, old.replace("MODULE", module), new.replace("MODULE", module))
    found = [each for each in check(file).findings if each.severity == "error"]
    (mistake,) = [each for each in found if told in each.message]
    assert key in mistake.key
    assert mistake.line is not None


@pytest.mark.promise("ROS-1")
def test_a_simulation_joins_no_graph_by_an_omission(file: Path) -> None:
    """It could move what is real: it needs ``sim``, whose keys replace those beside it."""
    for part in ("sensor.where", "sensor.bumper", "actuator.wheels"):
        change(file, f"[{part}]", f"[{part}]\nsim = {{}}")
    with pytest.raises(ExceptionGroup) as refused:
        load(file, simulated=True)
    (mistake,) = refused.value.exceptions
    assert str(mistake).startswith(f"{file}:5")
    assert "sim = {} to join it as it is" in str(mistake)

    change(file, "domain = 7", "domain = 7\nsim = { domain = 8 }")
    bus: Any = load(file, simulated=True).buses["ros"]
    assert bus.network.domain == 8
    assert load(file).buses["ros"].network.domain == 7  # type: ignore[attr-defined]


@pytest.mark.promise("ROS-2")
def test_without_it_nothing_is_imported(file: Path) -> None:
    """No module of ROS, or of peers, is loaded by a file that has no such table."""
    text = file.read_text()
    begin, end = text.index("[ros]"), text.index("[sensor.where]")
    file.write_text(text[:begin] + text[end:].partition("[behavior")[0])
    program = (
        "import sys, esair; esair.Robot.from_config(sys.argv[1]);"
        "print([each for each in sys.modules if 'ros.' in each or 'peer' in each"
        " and 'config' not in each])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(file)],
        capture_output=True,
        check=True,
        text=True,
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.promise("ROS-1")
@pytest.mark.parametrize("ros", sorted(READY))
def test_a_ready_value_comes_back_equal(ros: str) -> None:
    """As a message, and as a value again; a tuple of them where the message has rows."""
    kind = READY[ros][0]
    value = {
        "Twist": kind(1.0, 2.0) if kind.__name__ == "Twist" else None,
        "Scan": Scan(-1.0, 0.1, (1.0, float("inf")), "laser"),
        "Odometry": Odometry(1.0, 2.0, -0.5, 0.1, 0.2, "odom", "base"),
        "Joints": Joints(("a",), (0.1,), (0.2,), (0.3,)),
    }.get(kind.__name__)
    if value is None:
        filled = {
            each.name: (0.0, 0.0, 0.0, 1.0) if "ation" in each.name else each.name
            for each in kind.__attrs_attrs__  # type: ignore[attr-defined]
        }
        for name in ("translation", "acceleration"):
            filled |= {name: (1.0, 2.0, 3.0)} if name in filled else {}
        filled |= {"rotation": (0.0, 0.1, 0.2)} if kind.__name__ == "Imu" else {}
        value = kind(**filled)
    form = form_of(ros)
    back = form.value(form.message(value))
    assert back in (value, (value,)) or abs(back.heading - value.heading) < 1e-9


def test_what_was_not_measured_is_zero() -> None:
    """NaN in a row becomes 0.0, as below the least range; infinity stays."""
    message = {
        "angle_min": 0.0,
        "angle_increment": 0.1,
        "ranges": [float("nan"), float("inf"), 1.0],
        "header": {"frame_id": "laser"},
    }
    value = form_of("sensor_msgs/msg/LaserScan").value(message)
    assert value.ranges == (0.0, float("inf"), 1.0)
    nothing = [float("nan")]
    message = {"name": ["a"], "position": [1.0], "velocity": nothing, "effort": nothing}
    value = form_of("sensor_msgs/msg/JointState").value(message)
    assert value == Joints(("a",), (1.0,), (0.0,), (0.0,))


def test_what_is_found_becomes_lines_of_a_file(file: Path) -> None:
    """``esair ros --find``: a table for each name; what every node has is left out."""
    graph = {
        "topics": [
            ["/scan", ["sensor_msgs/msg/LaserScan"], ["lidar"], []],
            ["/cmd_vel", ["geometry_msgs/msg/Twist"], ["teleop"], ["base"]],
            ["/rosout", ["rcl_interfaces/msg/Log"], ["lidar"], []],
        ],
        "services": [["/dock", ["std_srvs/srv/Trigger"], [], []]],
        "actions": [],
    }
    lines = "\n".join(lines_of(graph))
    assert "rosout" not in lines
    assert '[ros.topics."/cmd_vel"]  # published by teleop; heard by base' in lines
    text = file.read_text()
    begin, end = text.index("[ros.topics"), text.index("[sensor.where]")
    module = next(file.parent.glob("ros_*.py")).stem
    lines = lines.replace("module:Class", f"{module}:Dock")
    file.write_text(text[:begin] + lines + "\n" + text[end:])
    assert [each for each in check(file).findings if each.severity == "error"] == []


def test_what_is_found_has_no_name_twice(file: Path) -> None:
    """Nor what is no command for an actuator, or more lines than it is."""
    text: Any = ["std_msgs/msg/String"], ["talker\n[actuator.wheels]"], []
    twist: Any = ["geometry_msgs/msg/TwistWithCovarianceStamped"], ["ekf"], []
    names = ("/scan", "/a/b", "/a_b", "/A_B", "/ros", "/wheels", "/both", "/_hidden")
    graph = {
        "topics": [*([name, *text] for name in names), ["/measured", *twist]],
        "services": [["/both", ["std_srvs/srv/Trigger"], [], []]],
        "actions": [],
    }
    lines = "\n".join(lines_of(graph))
    assert "drive" not in lines
    whole = file.read_text()
    begin, end = whole.index("[ros.topics"), whole.index("[sensor.where]")
    file.write_text(whole[:begin] + lines + "\n" + whole[end:])
    assert [each for each in check(file).findings if each.severity == "error"] == []
