"""What the frames of an ODrive mean: bytes to values and back, without I/O."""

from __future__ import annotations

import enum
import math
import struct
from typing import Any

import attrs

TURN = 2 * math.pi
"""One turn, in rad."""


class Message(enum.IntEnum):
    """The lower five bits of an id: what a frame is."""

    HEARTBEAT = 0x01
    ESTOP = 0x02
    SET_AXIS_STATE = 0x07
    GET_ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_POS = 0x0C
    SET_INPUT_VEL = 0x0D
    SET_INPUT_TORQUE = 0x0E
    CLEAR_ERRORS = 0x18


class AxisState(enum.IntEnum):
    """What an axis does; another number is UNDEFINED."""

    UNDEFINED = 0
    IDLE = 1
    STARTUP_SEQUENCE = 2
    FULL_CALIBRATION_SEQUENCE = 3
    MOTOR_CALIBRATION = 4
    ENCODER_INDEX_SEARCH = 6
    ENCODER_OFFSET_CALIBRATION = 7
    CLOSED_LOOP_CONTROL = 8
    LOCKIN_SPIN = 9
    ENCODER_DIR_FIND = 10
    HOMING = 11
    ENCODER_HALL_POLARITY_CALIBRATION = 12
    ENCODER_HALL_PHASE_CALIBRATION = 13
    ANTICOGGING_CALIBRATION = 14

    @classmethod
    def _missing_(cls, value: object) -> AxisState:
        return cls.UNDEFINED


class AxisError(enum.IntFlag):
    """Why an axis was disarmed, bit by bit."""

    INITIALIZING = 1 << 0
    SYSTEM_LEVEL = 1 << 1
    TIMING_ERROR = 1 << 2
    MISSING_ESTIMATE = 1 << 3
    BAD_CONFIG = 1 << 4
    DRV_FAULT = 1 << 5
    MISSING_INPUT = 1 << 6
    DC_BUS_OVER_VOLTAGE = 1 << 8
    DC_BUS_UNDER_VOLTAGE = 1 << 9
    DC_BUS_OVER_CURRENT = 1 << 10
    DC_BUS_OVER_REGEN_CURRENT = 1 << 11
    CURRENT_LIMIT_VIOLATION = 1 << 12
    MOTOR_OVER_TEMP = 1 << 13
    INVERTER_OVER_TEMP = 1 << 14
    VELOCITY_LIMIT_VIOLATION = 1 << 15
    POSITION_LIMIT_VIOLATION = 1 << 16
    WATCHDOG_TIMER_EXPIRED = 1 << 24
    ESTOP_REQUESTED = 1 << 25
    SPINOUT_DETECTED = 1 << 26
    BRAKE_RESISTOR_DISARMED = 1 << 27
    THERMISTOR_DISCONNECTED = 1 << 28
    CALIBRATION_ERROR = 1 << 30


class ControlMode(enum.IntEnum):
    """What the input of an axis is."""

    TORQUE = 1
    VELOCITY = 2
    POSITION = 3


PASSTHROUGH = 1
"""The input mode that takes the input as it is."""

_LAYOUTS = {
    Message.HEARTBEAT: struct.Struct("<IBBBx"),
    Message.SET_AXIS_STATE: struct.Struct("<I"),
    Message.GET_ENCODER_ESTIMATES: struct.Struct("<ff"),
    Message.SET_CONTROLLER_MODE: struct.Struct("<II"),
    Message.SET_INPUT_POS: struct.Struct("<fhh"),
    Message.SET_INPUT_VEL: struct.Struct("<ff"),
    Message.SET_INPUT_TORQUE: struct.Struct("<f"),
}

_INPUTS = {
    ControlMode.POSITION: (Message.SET_INPUT_POS, TURN, (0, 0)),
    ControlMode.VELOCITY: (Message.SET_INPUT_VEL, TURN, (0.0,)),
    ControlMode.TORQUE: (Message.SET_INPUT_TORQUE, 1.0, ()),
}
"""How each input is told: its unit, and what is behind it, feed-forwards that are 0."""


class FrameError(ValueError):
    """A frame that is too short."""


@attrs.frozen
class Heartbeat:
    """What an axis tells about itself, about ten times a second.

    Attributes:
        errors: Why it was disarmed; 0 if it was not.
        state: What it does.
        procedure_result: How the last procedure ended; 0 is success, 1 is busy.
        trajectory_done: Whether the last trajectory has come to its end.
    """

    errors: int
    state: AxisState
    procedure_result: int = 0
    trajectory_done: bool = False

    @property
    def error_names(self) -> tuple[str, ...]:
        """The names of the errors; a bit without a name is its number."""
        return tuple(
            AxisError(1 << bit).name or f"{1 << bit:#x}"
            for bit in range(32)
            if self.errors >> bit & 1
        )


def frame_id(node: int, message: Message) -> int:
    """Return the id of a message from or to an axis."""
    return node << 5 | message


def encode(message: Message, *values: float) -> bytes:
    """Pack what a message has, in the controller's own units."""
    return _LAYOUTS[message].pack(*values)


def decode(message: Message, data: bytes) -> tuple[Any, ...]:
    """Unpack what a message has, in the controller's own units.

    Raises:
        FrameError: It is too short.
    """
    layout = _LAYOUTS[message]
    if len(data) < layout.size:
        raise FrameError(f"expected {layout.size} bytes, not {len(data)}")
    return layout.unpack_from(data)


def encode_heartbeat(heartbeat: Heartbeat) -> bytes:
    """Pack a heartbeat, as an axis does."""
    return encode(Message.HEARTBEAT, *attrs.astuple(heartbeat))


def decode_heartbeat(data: bytes) -> Heartbeat:
    """Unpack a heartbeat; raises as `decode`."""
    errors, state, result, done = decode(Message.HEARTBEAT, data)
    return Heartbeat(errors, AxisState(state), result, bool(done))


def encode_estimates(position: float, velocity: float) -> bytes:
    """Pack a position in rad and a velocity in rad/s, as an axis does."""
    return encode(Message.GET_ENCODER_ESTIMATES, position / TURN, velocity / TURN)


def decode_estimates(data: bytes) -> tuple[float, float]:
    """Unpack a position in rad and a velocity in rad/s; raises as `decode`."""
    position, velocity = decode(Message.GET_ENCODER_ESTIMATES, data)
    return position * TURN, velocity * TURN


def encode_mode(mode: ControlMode) -> bytes:
    """Pack what the input of an axis shall be."""
    return encode(Message.SET_CONTROLLER_MODE, mode, PASSTHROUGH)


def encode_input(mode: ControlMode, value: float) -> tuple[Message, bytes]:
    """Pack an input: a position in rad, a velocity in rad/s or a torque in Nm."""
    message, unit, rest = _INPUTS[mode]
    return message, encode(message, value / unit, *rest)


def decode_input(message: Message, data: bytes) -> float:
    """Unpack an input, in rad, rad/s or Nm; raises as `decode`."""
    unit = 1.0 if message is Message.SET_INPUT_TORQUE else TURN
    return float(decode(message, data)[0]) * unit
