"""The drivers that come with esair, by their names in a robot.toml."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from esair import config

FILES = Path(__file__).parents[1] / "drivers"

ROBOT = """
[bus.drive]
type = "can"
channel = "can0"

[sensor.speed]
driver = "dbc"
bus = "drive"
database = "rover.dbc"
message = "WheelFeedback"
signal = "speed"
choices = "names"

[actuator.wheels]
driver = "dbc"
bus = "drive"
database = "rover.dbc"
message = "WheelCommand"
safe = { left = 0.0, right = 0 }
fixed = { gear = "low" }
sequence = "count"
cycle = 0.02
limits = { left = [-1, 1.0] }
own_timeout = 0.3

[sensor.position]
driver = "canopen"
bus = "drive"
node = 5
eds = "motor.eds"
object = [0x6064, 0]
factor = 0.001
rate = 20

[sensor.status]
driver = "canopen"
bus = "drive"
node = 5
eds = "motor.eds"
object = "Statusword"
pdo = true

[actuator.motor]
driver = "canopen"
bus = "drive"
node = 5
eds = "motor.eds"
object = "Target velocity"
safe = 0
heartbeat = 0.1

[sensor.axis]
driver = "odrive"
bus = "drive"
node = 3

[actuator.axis_speed]
driver = "odrive"
bus = "drive"
node = 3
control = "velocity"
idle = true
own_timeout = 0.5
limits = [-10.0, 10.0]

[sensor.bumper]
driver = "gpio"
chip = "pinctrl-bcm2711"
line = 17
bias = "pull_up"
active_low = true
debounce = 0.01

[actuator.lamp]
driver = "gpio"
chip = "/dev/gpiochip0"
line = "GPIO27"
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A folder with the file and what it names."""
    for name in ("rover.dbc", "motor.eds"):
        shutil.copy(FILES / name, tmp_path)
    file = tmp_path / "robot.toml"
    file.write_text(ROBOT)
    return file


def test_every_key_of_the_drivers_has_its_place(robot: Path) -> None:
    """Keywords, settings and attributes; numbers, lists and tables."""
    devices = config.load(robot).resources

    assert {name: type(each).__name__ for name, each in devices.items()} == {
        "speed": "DbcSensor",
        "wheels": "DbcActuator",
        "position": "CanopenSensor",
        "status": "CanopenSensor",
        "motor": "CanopenActuator",
        "axis": "OdriveState",
        "axis_speed": "OdriveAxis",
        "bumper": "DigitalInput",
        "lamp": "DigitalOutput",
    }
    wheels, position, lamp = devices["wheels"], devices["position"], devices["lamp"]
    assert wheels.limits == {"left": (-1.0, 1.0), "right": (-2.0, 2.0)}
    assert (wheels.cycle, wheels.own_timeout) == (0.02, 0.3)
    assert (position.factor, position.rate, position.name) == (0.001, 20.0, "position")
    assert devices["status"].pushes
    assert devices["axis_speed"].limits == (-10.0, 10.0)
    assert devices["bumper"].debounce == 0.01
    assert (lamp.safe, lamp.bus) == (False, None)


@pytest.mark.parametrize(
    ("old", "new", "key", "told"),
    [
        ('signal = "speed"', 'signal = "sped"', "sensor.speed.signal", "'speed'?"),
        ('choices = "names"', 'choices = "name"', "sensor.speed.choices", "one of"),
        ('"low"', '"lo"', "actuator.wheels.safe", "lo"),
        ("0x6064, 0", "0x6065, 0", "sensor.position.object", "no object 0x6065"),
        ("safe = 0\n", "safe = 0.5\n", "actuator.motor.safe", "expected int, not 0.5"),
        ("safe = 0\n", "", "actuator.motor", "the key 'safe' is missing"),
        ('"velocity"', '"speed"', "actuator.axis_speed.control", "one of 'velocity'"),
        ("node = 3", "node = 63", "sensor.axis.node", "expected 0 to 62"),
        ("node = 3", "nod = 3", "sensor.axis.nod", "did you mean 'node'?"),
        ("0.01", "-1.0", "sensor.bumper.debounce", "expected at least 0.0 s"),
        (
            "line = 17",
            "line = true",
            "sensor.bumper.line",
            "a whole number or a string",
        ),
    ],
)
def test_a_mistake_is_told_at_its_key(
    robot: Path, old: str, new: str, key: str, told: str
) -> None:
    """Whether the types find it, or the driver."""
    assert old in ROBOT
    robot.write_text(ROBOT.replace(old, new, 1))

    with pytest.raises(ExceptionGroup) as caught:
        config.load(robot)

    told_by_key = {error.key: str(error) for error in caught.value.exceptions}
    assert told in told_by_key[key]
