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

_HEARTBEAT = struct.Struct("<IBBBx")
_ESTIMATES = struct.Struct("<ff")
_STATE = struct.Struct("<I")
_MODE = struct.Struct("<II")
_POSITION = struct.Struct("<fhh")
_VELOCITY = struct.Struct("<ff")
_TORQUE = struct.Struct("<f")


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


def encode_heartbeat(heartbeat: Heartbeat) -> bytes:
    """Pack a heartbeat, as an axis does."""
    return _HEARTBEAT.pack(
        heartbeat.errors,
        heartbeat.state,
        heartbeat.procedure_result,
        heartbeat.trajectory_done,
    )


def decode_heartbeat(data: bytes) -> Heartbeat:
    """Unpack a heartbeat.

    Raises:
        FrameError: It is too short.
    """
    errors, state, result, done = _unpack(_HEARTBEAT, data)
    return Heartbeat(errors, AxisState(state), result, bool(done))


def encode_estimates(position: float, velocity: float) -> bytes:
    """Pack a position in rad and a velocity in rad/s, as an axis does."""
    return _ESTIMATES.pack(position / TURN, velocity / TURN)


def decode_estimates(data: bytes) -> tuple[float, float]:
    """Unpack a position in rad and a velocity in rad/s.

    Raises:
        FrameError: It is too short.
    """
    position, velocity = _unpack(_ESTIMATES, data)
    return position * TURN, velocity * TURN


def encode_state(state: AxisState) -> bytes:
    """Pack the state that an axis is asked to enter."""
    return _STATE.pack(state)


def decode_state(data: bytes) -> AxisState:
    """Unpack the state that an axis is asked to enter.

    Raises:
        FrameError: It is too short.
    """
    return AxisState(_unpack(_STATE, data)[0])


def encode_mode(mode: ControlMode) -> bytes:
    """Pack what the input of an axis shall be."""
    return _MODE.pack(mode, PASSTHROUGH)


def decode_mode(data: bytes) -> tuple[int, int]:
    """Unpack what the input of an axis shall be, and its input mode.

    Raises:
        FrameError: It is too short.
    """
    control, inputs = _unpack(_MODE, data)
    return control, inputs


def encode_input(mode: ControlMode, value: float) -> tuple[Message, bytes]:
    """Pack an input: a position in rad, a velocity in rad/s or a torque in Nm."""
    if mode is ControlMode.POSITION:
        return Message.SET_INPUT_POS, _POSITION.pack(value / TURN, 0, 0)
    if mode is ControlMode.VELOCITY:
        return Message.SET_INPUT_VEL, _VELOCITY.pack(value / TURN, 0.0)
    return Message.SET_INPUT_TORQUE, _TORQUE.pack(value)


def decode_input(message: Message, data: bytes) -> float:
    """Unpack an input: a position in rad, a velocity in rad/s or a torque in Nm.

    Raises:
        FrameError: It is too short.
    """
    if message is Message.SET_INPUT_POS:
        return float(_unpack(_POSITION, data)[0]) * TURN
    if message is Message.SET_INPUT_VEL:
        return float(_unpack(_VELOCITY, data)[0]) * TURN
    return float(_unpack(_TORQUE, data)[0])


def _unpack(layout: struct.Struct, data: bytes) -> tuple[Any, ...]:
    if len(data) < layout.size:
        raise FrameError(f"expected {layout.size} bytes, not {len(data)}")
    return layout.unpack_from(data)
