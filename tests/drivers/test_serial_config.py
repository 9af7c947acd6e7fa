"""The drivers on serial lines, as a robot.toml names them."""

from __future__ import annotations

from pathlib import Path

import pytest

from esair import config
from esair.buses import SerialBus
from esair.drivers.gps import Gps
from esair.drivers.line import LineActuator, LineSensor
from esair.drivers.rplidar import RpLidar
from esair.drivers.servo import Goal, Mode, Servo, ServoBus, ServoPosition
from esair.framing import Lines

ROBOT = """
[robot]
name = "rover"

[bus.gps]
type = "serial"
port = "usb:1546:01a7"
baudrate = 9600
framing = "nmea"

[bus.board]
type = "serial"
port = "/dev/serial/by-id/usb-Maker_Board-if00"
framing = { type = "lines", delimiter = ";", max_length = 80 }

[bus.lidar]
type = "serial"
port = "socket://lidar.local:2217"
framing = "raw"

[bus.arm]
type = "esair.drivers.servo:ServoBus"
port = "usb:0403:6014"

[sensor.position]
driver = "gps"
bus = "gps"
sentences = ["GGA"]

[sensor.range]
driver = "line"
bus = "board"
ask = true
rate = 20

[actuator.speed]
driver = "line"
bus = "board"
safe = 0.0
limits = [-1.0, 1.0]
ack = true

[sensor.scan]
driver = "rplidar"
bus = "lidar"

[sensor.angle]
driver = "servo"
bus = "arm"
id = 3

[actuator.elbow]
driver = "servo"
bus = "arm"
id = 3
safe = { mode = "release" }
limits = [-1.0, 1.0]
speed = 2.0
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "robot.toml"


def test_all_of_them_are_described_by_a_file(file: Path) -> None:
    """A module's name finds its sensor or its actuator; nothing is opened."""
    file.write_text(ROBOT)

    described = config.load(file)

    buses, resources = described.buses, described.resources
    assert [type(resources[name]) for name in resources] == [
        Gps, LineSensor, RpLidar, ServoPosition, LineActuator, Servo,
    ]  # fmt: skip
    assert isinstance(buses["board"], SerialBus)
    assert isinstance(buses["board"].framing, Lines)
    assert buses["board"].framing.delimiter == b";"
    assert buses["board"].framing.max_length == 80
    assert isinstance(buses["arm"], ServoBus)
    assert resources["range"].bus is resources["speed"].bus is buses["board"]
    assert resources["range"].settings["rate"] == 20.0
    assert resources["position"].sentences == ("GGA",)
    assert resources["elbow"].safe == Goal(mode=Mode.RELEASE)
    assert resources["elbow"].limits == {"angle": (-1.0, 1.0)}
    assert resources["elbow"].settings["speed"] == 2.0


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ('framing = "nmea"', 'framing = "lines"', "framing='nmea'"),
        ('framing = "raw"', 'framing = "nmae"', "did you mean 'nmea'?"),
        ("max_length = 80", "max_lenght = 80", "did you mean 'max_length'?"),
        ("max_length = 80", "max_length = 0", "max_length: expected"),
        ('type = "lines", ', "", "'type' is missing: expected one of 'lines'"),
        ('port = "usb:1546:01a7"', 'port = "usb:1546"', "usb:VID:PID"),
        ("id = 3", "id = 300", "expected 0 to 252"),
        ('bus = "arm"\nid', 'bus = "gps"\nid', "expected a ServoBus"),
        ("safe = 0.0\n", "", "safe"),
        ("safe = 0.0\n", "safe = 3.0\n", "outside the limits"),
        ('mode = "release"', 'mode = "relax"', "release"),
    ],
)
def test_a_mistake_is_told_with_its_place(
    file: Path, right: str, wrong: str, told: str
) -> None:
    """The table, the key, and what was expected."""
    assert right in ROBOT
    file.write_text(ROBOT.replace(right, wrong))

    with pytest.raises(ExceptionGroup) as caught:
        config.load(file)

    assert any(told in str(error) for error in caught.value.exceptions), (
        caught.value.exceptions
    )
