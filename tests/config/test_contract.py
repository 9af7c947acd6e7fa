"""The example of the contract, with a rover that fits it.

Its access table names a behavior ``avoid`` that has no table: it may be added later.
"""

import sys
from pathlib import Path

import pytest

from esair import config
from esair.drivers.dbc import DbcActuator

ROBOT = """
[robot]
name = "rover"

[bus.front]
type = "serial"
port = "usb:0403:6001"      # or a path, or "loop://" style URLs of pyserial
baudrate = 115200

[bus.drive]
type = "can"
interface = "socketcan"
channel = "can0"

[sensor.sonar]
driver = "rover:Sonar"      # module:Class, or the name of an installed entry point
bus = "front"
rate = 20

[actuator.wheels]
driver = "dbc"
bus = "drive"
database = "rover.dbc"
message = "WheelCommand"
safe = { left = 0.0, right = 0.0 }

[behavior.wander]
driver = "rover:Wander"
restart = { max = 3, within = 30 }

[access.wheels]
wander = "write"
avoid = "write, configure"
"""

ROVER = """
import esair
from esair.buses import SerialBus


class Sonar(esair.Sensor[float]):
    bus: SerialBus

    async def read(self) -> float:
        return 1.0


class Wander(esair.Behavior):
    wheels = esair.writes(dict)

    async def run(self) -> None:
        await self.wheels.write({"left": 0.3, "right": 0.3})


class Avoid(esair.Reaction):
    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(dict, priority=10, configure=True)

    def react(self, sonar: float) -> dict | None:
        return {"left": -0.2, "right": 0.2} if sonar < 0.4 else None
"""

DBC = """
VERSION ""
NS_ :
BS_:
BU_: Robot Motors

BO_ 256 WheelCommand: 4 Robot
 SG_ left : 0|16@1- (0.001,0) [-2|2] "m/s" Motors
 SG_ right : 16|16@1- (0.001,0) [-2|2] "m/s" Motors
"""


@pytest.fixture
def rover(tmp_path: Path):
    """The file, its module and its database in one folder."""
    (tmp_path / "robot.toml").write_text(ROBOT)
    (tmp_path / "rover.py").write_text(ROVER)
    (tmp_path / "rover.dbc").write_text(DBC)
    before = sys.modules.pop("rover", None)
    yield tmp_path / "robot.toml"
    sys.modules.pop("rover", None)
    if before is not None:
        sys.modules["rover"] = before


def test_the_example_of_the_contract_loads(rover: Path) -> None:
    """Every key of it; the database is found beside the file."""
    described = config.load(rover)

    wheels = described.resources["wheels"]
    assert isinstance(wheels, DbcActuator)
    assert wheels.bus is described.buses["drive"]
    assert wheels.safe == {"left": 0.0, "right": 0.0}
    assert wheels.limits == {"left": (-2.0, 2.0), "right": (-2.0, 2.0)}
    assert described.resources["sonar"].rate == 20.0


def test_nothing_in_it_is_an_error(rover: Path) -> None:
    """``esair check`` says so too."""
    report = config.check(rover)

    errors = [each for each in report.findings if each.severity == "error"]
    assert errors == []
    assert [each.key for each in report.findings if "nobody here" in each.message] == [
        "access.wheels.avoid"
    ]
    (wheels,) = report.actuators
    assert wheels.safe == "{'left': 0.0, 'right': 0.0}"
    assert wheels.driver == "esair.drivers.dbc:DbcActuator"


@pytest.mark.parametrize(
    ("old", "new", "key", "told"),
    [
        ('"dbc"', '"dbq"', "driver", "'dbq' is not installed; did you mean 'dbc'?"),
        ('"rover.dbc"', '"rovr.dbc"', "database", "rovr.dbc cannot be read"),
        ('"WheelCommand"', '"WheelComand"', "message", "did you mean 'WheelCommand'?"),
        ("right = 0.0", "right = 3.0", "safe", "right: expected -2 to 2, not 3.0"),
        ("right = 0.0", "rigth = 0.0", "safe", "rigth: there is no such signal; did"),
        ("left = 0.0, ", "", "safe", 'The signal "left" is required'),
        ("safe = { left = 0.0, right = 0.0 }", "", "", "the key 'safe' is missing"),
        ('message = "W', 'signal = "left"\nmessage = "W', "safe", "expected a number"),
        ('bus = "drive"', 'bus = "front"', "bus", "expected a CanBus, but"),
        ('bus = "drive"', "", "", "the key 'bus' is missing"),
        ('bus = "drive"', 'bus = "drive"\ncylce = 1', "cylce", "did you mean 'cycle'?"),
    ],
)
def test_a_mistake_in_it_is_told_at_its_key(
    rover: Path, old: str, new: str, key: str, told: str
) -> None:
    """With the nearest name where there is one."""
    rover.write_text(ROBOT.replace(old, new, 1))

    with pytest.raises(ExceptionGroup) as caught:
        config.load(rover)

    where = f"actuator.wheels.{key}" if key else "actuator.wheels"
    told_by_key = {error.key: str(error) for error in caught.value.exceptions}
    assert told in told_by_key[where]


def test_one_driver_serves_sensors_as_well(rover: Path) -> None:
    """The kind of the table decides which of its classes is meant."""
    rover.write_text(
        ROBOT + '[sensor.echo]\ndriver = "dbc"\nbus = "drive"\n'
        'database = "rover.dbc"\nmessage = "WheelCommand"\nsignal = "left"\n'
    )

    echo = config.load(rover).resources["echo"]
    assert type(echo).__name__ == "DbcSensor"
    assert echo.value_type is float
