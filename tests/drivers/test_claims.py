"""Two devices that would each have the same thing for itself are found in the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from esair import config
from esair.drivers.dbc import DbcActuator

HERE = Path(__file__).parent
I2C, CAN = 'type = "i2c"\nbus = 1', 'type = "can"\ninterface = "virtual"\nchannel = "c"'
DBC = f'driver = "dbc"\ndatabase = "{HERE / "rover.dbc"}"\nmessage = "WheelCommand"'
EDS = f'driver = "canopen"\neds = "{HERE / "motor.eds"}"\nnode = 5\nsafe = 0'
SERVO = 'type = "esair.drivers.servo:ServoBus"\nport = "/dev/ttyUSB0"'
LINES = 'type = "serial"\nport = "/dev/ttyUSB0"'
PIN = 'driver = "gpio"\nchip = "/dev/gpiochip0"'
DAC = (
    'driver = "esair.drivers.adafruit:AdafruitActuator"\n'
    'library = "adafruit_bme280.basic:Adafruit_BME280_I2C"\nsafe = 1013.0'
)

SAME = [
    (I2C, 'driver = "pca9685"\nchannel = 3', "channel 3 of the chip 0x40"),
    (CAN, 'driver = "odrive"\nnode = 3', "node 3"),
    (
        CAN,
        f'{DBC}\nsafe = {{ left = 0, right = 0, gear = "low" }}\nsequence = "count"',
        "the frame 0x",
    ),
    (CAN, f'{EDS}\nobject = "Target velocity"', "Target velocity of node 5"),
    (SERVO, 'driver = "servo"\nid = 2\nsafe = { mode = "release" }', "servo 2"),
    (LINES, 'driver = "line"\nkey = "speed"\nsafe = 0.0', "the value 'speed'"),
    (None, f"{PIN}\nline = 4", "line 4 of /dev/gpiochip0"),
    (I2C, f'{DAC}\nattribute = "sea_level_pressure"', "sea_level_pressure of adaf"),
]


def mistakes(
    folder: Path, bus: str | None, left: str, right: str, kind: str = "actuator"
) -> list[str]:
    """Describe two actuators on one bus; return what is wrong with them."""
    on_bus = "" if bus is None else 'bus = "it"\n'
    path = folder / "robot.toml"
    path.write_text(
        ("" if bus is None else f"[bus.it]\n{bus}\n")
        + f"[{kind}.left]\n{on_bus}{left}\n[{kind}.right]\n{on_bus}{right}\n"
    )
    found = config.check(path).findings
    return [each.message for each in found if each.severity == "error"]


@pytest.mark.parametrize("part", ["mpu6050", "bme280"])
def test_one_chip_has_one_sensor(tmp_path, part) -> None:
    """Each would set it up for itself, and read what the other has set up."""
    told = f'driver = "{part}"'
    (message,) = mistakes(tmp_path, I2C, told, told, kind="sensor")

    assert "the chip 0x" in message


@pytest.mark.parametrize(("bus", "part", "told"), SAME)
def test_one_thing_has_one_actuator(tmp_path, bus, part, told) -> None:
    """The second one is told, with what it is and who has it."""
    (message,) = mistakes(tmp_path, bus, part, part)

    assert told in message
    assert "belongs to 'left'" in message


@pytest.mark.parametrize(
    ("said", "count"),
    [
        ("address = 0x77", 1),
        ("arguments = { address = 0x77 }", 1),
        ("address = 0x76", 0),
    ],
)
def test_the_address_that_a_class_has_unless_told_is_one(tmp_path, said, count) -> None:
    """A part is the same whether its address is said or not."""
    part = f'{DAC}\nattribute = "sea_level_pressure"'
    assert len(mistakes(tmp_path, I2C, part, f"{part}\n{said}")) == count


def test_frames_of_two_kinds_are_two_things(tmp_path) -> None:
    """A standard and an extended identifier may have one number."""
    file = tmp_path / "two.dbc"
    signal = ' SG_ speed : 0|8@1+ (1,0) [0|0] "" Motor\n\n'
    file.write_text(
        'VERSION ""\n\nBU_: Motor\n\n'
        f"BO_ 256 Short: 1 Motor\n{signal}BO_ {0x80000000 | 256} Long: 1 Motor\n{signal}"
    )
    short, long = (
        DbcActuator(database=file, message=message, safe={"speed": 0.0})
        for message in ("Short", "Long")
    )

    assert short.claim == "the frame 0x100"
    assert long.claim == "the extended frame 0x100"


def test_frames_that_several_share_are_claimed_by_nobody() -> None:
    """Each page of a multiplexed message may have an actuator of its own."""
    panel = DbcActuator(
        database=HERE / "rover.dbc",
        message="Panel",
        safe={"page": 0, "voltage": 0.0},
    )

    assert panel.claim is None
