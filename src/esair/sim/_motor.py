"""A motor controller on the CAN bus: turns one wheel, tells how it turns."""

from __future__ import annotations

from collections.abc import Callable

from esair.buses import Frame
from esair.drivers.wheel_motor import (
    OWN_TIMEOUT,
    WheelFeedback,
    command_id,
    decode_command,
    encode_feedback,
    feedback_id,
)
from esair.sim._world import World

FEEDBACK_PERIOD = 0.02  # Between two feedback frames, in seconds


class SimMotor:
    """One motor controller. It trusts nobody: silence stops its wheel.

    Attributes:
        timeouts: How often it has stopped because no command came.
        bad_frames: How many command frames it could not read.
    """

    def __init__(self, world: World, side: int, send: Callable[[Frame], None]) -> None:
        self.timeouts: int = 0
        self.bad_frames: int = 0
        self._world = world
        self._side = side
        self._send = send
        self._heard: float | None = None
        self._enabled = False
        self._sequence = 0
        self._due = 0.0

    def receive(self, frame: Frame) -> None:
        """Take a frame from the bus; frames for others are left alone."""
        if frame.id != command_id(self._side) or frame.extended:
            return
        try:
            command = decode_command(self._side, frame.data)
        except ValueError:
            self.bad_frames += 1
            return
        self._heard = self._world.time
        self._enabled = command.enable
        self._world.target[self._side] = command.speed if command.enable else 0.0

    def step(self) -> None:
        """Do what is due at the world's time."""
        now = self._world.time
        timed_out = self._heard is not None and now - self._heard > OWN_TIMEOUT
        if timed_out and self._enabled:
            self._enabled = False
            self.timeouts += 1
            self._world.target[self._side] = 0.0
        if now + 1e-9 < self._due:
            return
        self._due = now + FEEDBACK_PERIOD
        self._sequence += 1
        feedback = WheelFeedback(
            self._world.wheel_angle[self._side],
            self._world.wheel_speed[self._side],
            self._enabled,
            timed_out,
            self._sequence,
        )
        self._send(
            Frame(feedback_id(self._side), encode_feedback(self._side, feedback))
        )
