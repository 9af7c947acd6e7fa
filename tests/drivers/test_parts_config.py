"""Drives, Modbus, pads, cameras and Feetech's servos as a robot.toml describes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from esair import config

pytest.importorskip("pymodbus", reason="the extra 'modbus' is not installed")
pytest.importorskip("scservo_sdk", reason="the extra 'feetech' is not installed")

ROBOT = """
[bus.plc]
type = "serial"
port = "usb:0403:6001"
baudrate = 19200
framing = "modbus-rtu"

[bus.cabinet]
type = "serial"
port = "socket://192.168.0.10:502"
framing = "modbus-tcp"

[bus.drive]
type = "can"
channel = "can0"

[bus.arm]
type = "esair.drivers.servo.feetech:FeetechBus"
port = "usb:1a86:55d3"

[sensor.flow]
driver = "esair.drivers.modbus:ModbusSensor"
bus = "plc"
unit = 3
register = 100
table = "input"
type = "float32"

[actuator.pump]
driver = "esair.drivers.modbus:ModbusActuator"
bus = "cabinet"
register = 8
factor = 0.1
safe = 0.0

[actuator.wheel]
driver = "esair.drivers.canopen.drive:Drive"
bus = "drive"
node = 5
factor = 0.00157
sync = 0.02
limits = [-10, 10]

[sensor.wheel_state]
driver = "esair.drivers.canopen.drive:DriveState"
bus = "drive"
node = 5

[actuator.axis]
driver = "esair.drivers.canopen.position:PositionDrive"
bus = "drive"
node = 6

[actuator.elbow]
driver = "servo"
bus = "arm"
id = 3
safe = { mode = "release" }

[actuator.neck]
driver = "esair.drivers.servo.turning:ServoVelocity"
bus = "arm"
id = 4

[sensor.pad]
driver = "esair.drivers.gamepad:Gamepad"
device = "usb:045e:028e"
dead_man = "tl"

[sensor.front]
driver = "esair.drivers.camera:Camera"
device = "usb:046d:0825"
width = 640
height = 480
fps = 30
"""


def test_all_of_them_are_described_by_a_file(tmp_path: Path) -> None:
    """With the keys of their documentation; nothing is opened."""
    (file := tmp_path / "robot.toml").write_text(ROBOT)

    described = config.load(file)

    assert {
        name: type(each).__name__ for name, each in described.resources.items()
    } == {
        "flow": "ModbusSensor",
        "wheel_state": "DriveState",
        "pad": "Gamepad",
        "front": "Camera",
        "pump": "ModbusActuator",
        "wheel": "Drive",
        "axis": "PositionDrive",
        "elbow": "Servo",
        "neck": "ServoVelocity",
    }
    assert type(described.buses["arm"]).__name__ == "FeetechBus"
    assert described.buses["arm"].baudrate == 1_000_000
    assert described.resources["flow"].kind == "float32"
    assert described.resources["wheel"].sync == 0.02
    assert described.resources["pad"].dead_man == "tl"
