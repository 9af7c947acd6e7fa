"""The frames of the motor controllers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from esair.drivers.wheel_motor import (
    LEFT,
    RIGHT,
    WheelCommand,
    WheelFeedback,
    command_id,
    database,
    decode_command,
    decode_feedback,
    encode_command,
    encode_feedback,
    feedback_id,
)

SIDES = st.sampled_from([LEFT, RIGHT])


def test_a_command_has_the_bytes_that_the_dbc_file_describes() -> None:
    """Milliradians a second, low byte first; enable; sequence."""
    assert command_id(LEFT) == 0x101
    assert command_id(RIGHT) == 0x102
    assert feedback_id(LEFT) == 0x181
    assert encode_command(LEFT, WheelCommand(1.0, True, 7)) == b"\xe8\x03\x01\x07"
    assert encode_command(RIGHT, WheelCommand(-1.0, False, 256)) == b"\x18\xfc\x00\x00"


@given(SIDES, st.floats(-32, 32), st.booleans(), st.integers(0, 255))
def test_a_command_comes_back_within_its_resolution(
    side: int, speed: float, enable: bool, sequence: int
) -> None:
    """What is packed is unpacked."""
    again = decode_command(
        side, encode_command(side, WheelCommand(speed, enable, sequence))
    )

    assert again.speed == pytest.approx(speed, abs=0.00051)
    assert (again.enable, again.sequence) == (enable, sequence)


@given(SIDES, st.floats(-2e6, 2e6), st.floats(-99, 99), st.booleans(), st.booleans())
def test_feedback_comes_back_and_speeds_are_cut_off(
    side: int, angle: float, speed: float, enabled: bool, timed_out: bool
) -> None:
    """An encoder counts for days; a speed beyond the signal is its limit."""
    told = WheelFeedback(angle, speed, enabled, timed_out, 9)

    again = decode_feedback(side, encode_feedback(side, told))

    assert again.angle == pytest.approx(angle, abs=0.00051)
    assert again.speed == pytest.approx(max(-32.0, min(32.0, speed)), abs=0.00051)
    assert (again.enabled, again.timed_out) == (enabled, timed_out)


@pytest.mark.fault("C10")
@pytest.mark.parametrize("length", [0, 3, 5, 8])
def test_a_command_of_the_wrong_length_is_refused(length: int) -> None:
    """It is not read as if the missing bytes were there."""
    with pytest.raises(ValueError, match="4 bytes"):
        decode_command(LEFT, bytes(length))


def test_every_message_has_a_sender() -> None:
    """The file describes both motors, and who says what."""
    senders = {message.name: message.senders for message in database().messages}

    assert senders["WheelCommandLeft"] == ["Robot"]
    assert senders["WheelFeedbackRight"] == ["MotorRight"]
