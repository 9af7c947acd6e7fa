"""What is wrong with a device is told when it is made: nothing is opened for it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from esair.buses import Wire
from esair.drivers.ads1115 import Ads1115
from esair.drivers.camera import Camera
from esair.drivers.canopen.drive import Drive, DriveState
from esair.drivers.canopen.position import PositionDrive
from esair.drivers.gamepad import Gamepad
from esair.drivers.gpio import DigitalInput, DigitalOutput
from esair.drivers.gps import Gps
from esair.drivers.line import LineActuator, LineSensor
from esair.drivers.modbus import ModbusActuator, ModbusSensor
from esair.drivers.odrive import OdriveAxis
from esair.drivers.pca9685 import PwmChannel
from esair.drivers.pca9685.servo import PwmServo
from esair.drivers.rplidar import RpLidar
from esair.drivers.servo import Goal, Mode, Servo, ServoBus, ServoPosition
from esair.drivers.servo.feetech import FeetechBus
from esair.drivers.servo.turning import ServoVelocity
from esair.exceptions import BadValueError, ConfigError
from esair.testing import FakeSerial

LINES, RAW = FakeSerial("lines"), FakeSerial("raw", framing="raw")
NMEA = FakeSerial("gps", framing="nmea")
RTU = FakeSerial("plc", framing="modbus-rtu")
ARM = ServoBus(name="arm", wire=Wire())
FEETECH = FeetechBus(name="arm", wire=Wire())
GOES: dict[type, dict[str, Any]] = {
    DigitalInput: {"chip": "fake", "line": 3},
    DigitalOutput: {"chip": "fake", "line": 3},
    Drive: {"node": 5},
    DriveState: {"node": 5},
    LineActuator: {"bus": LINES, "safe": 0.0},
    LineSensor: {"bus": LINES},
    ModbusActuator: {"bus": RTU, "register": 1, "safe": 0},
    ModbusSensor: {"bus": RTU, "register": 1},
    OdriveAxis: {"node": 0},
    PositionDrive: {"node": 5},
    PwmChannel: {"channel": 0},
    PwmServo: {"channel": 0},
    Servo: {"bus": ARM, "safe": Goal(mode=Mode.RELEASE)},
    ServoPosition: {"bus": ARM},
    ServoVelocity: {"bus": FEETECH},
}
"""What goes, but for the mistake."""


@pytest.mark.parametrize(
    ("kind", "wrong", "told"),
    [
        (Ads1115, {"address": 0x4C}, "address: expected 0x48 to 0x4b, not 0x4c"),
        *((Ads1115, {"channel": n}, "channel.*0-3") for n in (4, -1, "1-0", None)),
        (Camera, {"width": 0}, "width: expected 1 or more"),
        (Camera, {"width": 640}, "height: expected both"),
        (Camera, {"fps": 0}, "fps: expected 1 to 1000"),
        (Camera, {"colors": "rbg"}, "colors: expected 'bgr', 'rgb' or 'gray'"),
        (Camera, {"silent_after": 0}, "silent_after: expected"),
        (DigitalInput, {"bias": "up"}, "bias: expected 'as_is'"),
        (DigitalInput, {"line": -1}, "line: expected 0 or more"),
        (DigitalInput, {"chip": ""}, "chip: expected a path"),
        (DigitalInput, {"debounce": -1.0}, "debounce: expected at least 0"),
        (DigitalOutput, {"drive": "push"}, "drive: expected 'push_pull'"),
        (DigitalOutput, {"safe": 0}, "safe: expected a bool"),
        (Drive, {"stop": "now"}, "stop: expected 'quick_stop' or 'halt'"),
        (Drive, {"factor": 0}, "factor: expected a factor that is not 0"),
        (Drive, {"node": 128}, "node: expected 1 to 127"),
        (Drive, {"sync": 0.2}, r"sync: expected 0\.1 s at most"),
        (DriveState, {"sync": 0.0}, "sync: expected"),
        (PositionDrive, {"factor": 0.0}, "factor: expected a factor"),
        (PositionDrive, {"sync": 0.02}, "sync"),
        (Gamepad, {"dead_man": "t1"}, "no button 't1'.*south, east"),
        (Gamepad, {"dead_zone": 1.0}, "dead_zone: expected 0 to 0.9"),
        (Gps, {"bus": LINES}, "bus: expected a SerialBus with framing='nmea'"),
        (Gps, {"bus": NMEA, "sentences": ("GLL",)}, "sentences: expected of GGA"),
        (LineActuator, {"key": "go faster"}, "key: expected letters"),
        (LineSensor, {"bus": None}, "bus: expected a SerialBus, not None"),
        (LineSensor, {"bus": RAW}, "framing='lines', not 'raw'"),
        (ModbusSensor, {"unit": 256}, "unit: expected 0 to 255"),
        (ModbusSensor, {"register": -1}, "register: expected 0 to 65535"),
        (ModbusSensor, {"table": "coils"}, "table: expected 'holding'"),
        (ModbusSensor, {"type": "float"}, "type: expected 'int16'"),
        (ModbusSensor, {"factor": 0}, "factor: expected"),
        (ModbusSensor, {"word_order": "up"}, "word_order: expected"),
        (ModbusSensor, {"bus": LINES}, "with framing='modbus-rtu' or 'modbus-tcp'"),
        (ModbusActuator, {"table": "input"}, "table: expected 'holding' or 'coil'"),
        (ModbusActuator, {"table": "coil"}, "safe: expected a bool"),
        (ModbusActuator, {"safe": 40000}, "limits: expected"),
        (OdriveAxis, {"node": 63}, "node: expected 0 to 62, not 63"),
        (OdriveAxis, {"control": "speed"}, "control: expected 'velocity'"),
        (OdriveAxis, {"control": "position", "idle": True}, "idle: expected false"),
        (OdriveAxis, {"heartbeat_timeout": 0}, "heartbeat_timeout: expected a number"),
        (PwmChannel, {"channel": 16}, "channel: expected"),
        (PwmChannel, {"channel": 1.0}, "channel: expected"),
        (PwmChannel, {"channel": 0, "address": 0x3F}, "address: expected"),
        (PwmChannel, {"channel": 0, "frequency": 10.0}, "frequency: expected"),
        (PwmChannel, {"channel": 0, "frequency": math.nan}, "frequency: expected"),
        (PwmServo, {"channel": -1}, "channel: expected"),
        (PwmServo, {"channel": 0, "min_pulse": 0.003}, "max_pulse: expected"),
        (PwmServo, {"channel": 0, "max_pulse": 0.03}, "max_pulse: expected"),
        (PwmServo, {"channel": 0, "max_angle": math.inf}, "max_angle: expected"),
        (
            PwmServo,
            {"channel": 0, "min_angle": -45, "max_angle": 45},
            "max_angle: expected",
        ),
        (
            PwmServo,
            {"channel": 0, "min_angle": 1.0, "max_angle": 1.0},
            "max_angle: expected",
        ),
        (RpLidar, {"bus": LINES}, "bus: expected a SerialBus with framing='raw'"),
        *((ServoPosition, {"id": n}, "id: expected 0 to 252") for n in (-1, 253, "1")),
        (ServoPosition, {"id": True}, "id: expected 0 to 252"),
        (Servo, {"bus": None}, "bus: expected a ServoBus"),
        (Servo, {"limits": (-10, 10)}, "limits: a servo allows -3.14"),
        (Servo, {"bus": FEETECH, "limits": (0, 60)}, "limits: a servo allows -47"),
        (ServoVelocity, {"limits": (-1e9, 6)}, "limits: a servo allows"),
        (Drive, {"factor": 0.001, "limits": (0, 3e6)}, "limits: its factor allows"),
        (Drive, {"limits": 3}, "limits: expected"),
        (ServoBus, {"name": "arm"}, "port: expected the path of a device file"),
    ],
)
def test_a_mistake_names_the_field_and_what_was_expected(
    kind: Any, wrong: dict[str, Any], told: str
) -> None:
    """In the words that a file gets as well."""
    with pytest.raises((ConfigError, BadValueError, TypeError), match=told):
        kind(**{**GOES.get(kind, {}), **wrong})
