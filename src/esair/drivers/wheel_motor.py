"""Two motor controllers on a CAN bus, one for each wheel: what their frames mean.

The frames are described by ``wheel_motor.dbc`` beside this file and packed by
cantools. A controller obeys a speed while it gets one at least every 0.3 s, and tells
how its wheel turns every 20 ms.
"""

from __future__ import annotations

import functools
import importlib.resources
from typing import Any

import attrs
import cantools.database
from cantools.database.can import Database, Message

LEFT, RIGHT = 0, 1
"""The sides, wherever a side is asked for."""

OWN_TIMEOUT = 0.3
"""After this many seconds without a command a controller stops its wheel."""

MAX_SPEED = 32.0
"""The fastest turn that a frame can ask for, in rad/s."""

_SIDES = ("Left", "Right")


@attrs.frozen
class WheelCommand:
    """What a controller is told.

    Attributes:
        speed: In rad/s, forward positive.
        enable: Whether the motor may have power; a stop says no.
        sequence: Counts the commands, modulo 256.
    """

    speed: float
    enable: bool
    sequence: int


@attrs.frozen
class WheelFeedback:
    """How a wheel turns.

    Attributes:
        angle: How far it has turned since power-up, in rad, forward positive.
        speed: In rad/s.
        enabled: Whether the motor has power.
        timed_out: Whether it stopped because no command came.
        sequence: Counts the frames, modulo 256.
    """

    angle: float
    speed: float
    enabled: bool
    timed_out: bool
    sequence: int


@functools.cache
def database() -> Database:
    """Return the description of all frames."""
    text = importlib.resources.files("esair.drivers").joinpath("wheel_motor.dbc")
    found = cantools.database.load_string(text.read_text("utf-8"), "dbc")
    assert isinstance(found, Database)
    return found


@functools.cache
def _message(kind: str, side: int) -> Message:
    return database().get_message_by_name(f"Wheel{kind}{_SIDES[side]}")


def command_id(side: int) -> int:
    """Return the id of the commands for one side."""
    return _message("Command", side).frame_id


def feedback_id(side: int) -> int:
    """Return the id of the feedback of one side."""
    return _message("Feedback", side).frame_id


def encode_command(side: int, command: WheelCommand) -> bytes:
    """Pack a command.

    Raises:
        cantools.database.EncodeError: The speed is beyond `MAX_SPEED`.
    """
    return _encode(_message("Command", side), command)


def decode_command(side: int, data: bytes) -> WheelCommand:
    """Unpack a command.

    Raises:
        ValueError: The length is wrong.
    """
    command: WheelCommand = _decode(_message("Command", side), data, WheelCommand)
    return command


def encode_feedback(side: int, feedback: WheelFeedback) -> bytes:
    """Pack the feedback of one side; a speed beyond `MAX_SPEED` is cut off."""
    speed = max(-MAX_SPEED, min(MAX_SPEED, feedback.speed))
    return _encode(_message("Feedback", side), attrs.evolve(feedback, speed=speed))


def decode_feedback(side: int, data: bytes) -> WheelFeedback:
    """Unpack the feedback of one side.

    Raises:
        ValueError: The length is wrong.
    """
    found: WheelFeedback = _decode(_message("Feedback", side), data, WheelFeedback)
    return found


def _signal(field: str) -> str:
    return field.title().replace("_", "")


def _encode(message: Message, frame: Any) -> bytes:
    told = attrs.asdict(frame).items()
    values = {_signal(name): +value for name, value in told}  # a bool as a number
    return message.encode({**values, "Sequence": frame.sequence % 256})


def _decode(message: Message, data: bytes, kind: Any) -> Any:
    if len(data) != message.length:
        raise ValueError(f"{message.name} has {message.length} bytes, not {len(data)}")
    values: Any = message.decode(data, decode_choices=False)
    fields = attrs.fields(attrs.resolve_types(kind))
    return kind(**{each.name: each.type(values[_signal(each.name)]) for each in fields})
