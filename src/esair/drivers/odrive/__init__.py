"""An axis of an ODrive motor controller, over CAN.

The axis is set up with the maker's tools: calibrated, with its node id, its limits, and
the rates at which it tells its heartbeat and its encoder estimates. Set its watchdog
too (``axis.config.watchdog_timeout`` and ``enable_watchdog``) and say so with
``own_timeout``: nothing else stops the motor when this computer dies. It is fed at rest, too,
with each heartbeat; it is to be twice as long as that.

Source: ODrive documentation, "CAN Protocol" (CANSimple), firmware 0.6; the names of the
messages and of the error bits are those of that page. The controller counts in turns;
everything here is in rad.
"""

from __future__ import annotations

import asyncio
import contextlib
import enum
import math
import struct
from collections.abc import AsyncIterator
from typing import Any, ClassVar, Literal, Required, TypedDict, Unpack

import attrs

from esair.buses import CanBus, Inbox
from esair.buses import Frame as CanFrame
from esair.drivers._on_bus import ended, heard, room_comes, watching
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
)
from esair.resources import (
    HOLD,
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)
from esair.values import check_choice, check_seconds, check_whole
from esair.watchdog import SafeFrames, can_frame

__all__ = [
    "AxisError",
    "AxisReading",
    "AxisState",
    "ControlMode",
    "FrameError",
    "Heartbeat",
    "Message",
    "OdriveAxis",
    "OdriveState",
    "decode",
    "decode_estimates",
    "decode_heartbeat",
    "decode_input",
    "encode",
    "encode_estimates",
    "encode_heartbeat",
    "encode_input",
    "encode_mode",
    "frame_id",
]

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


ARM_TIMEOUT = 0.5
"""How long an axis may take to enter closed loop control, in seconds."""

_HELD = (
    (Message.SET_CONTROLLER_MODE, encode_mode(ControlMode.VELOCITY)),
    encode_input(ControlMode.VELOCITY, 0.0),
)
"""What keeps an axis where it is, wherever that is."""


@attrs.frozen
class AxisReading:
    """What an axis measures, and how it is.

    Attributes:
        position: In rad.
        velocity: In rad/s.
        state: What the axis does.
        errors: The names of its errors.
    """

    position: float
    velocity: float
    state: AxisState
    errors: tuple[str, ...]


class _OnAxis(Resource):
    """What the sensor and the actuator have in common: the heartbeat of an axis."""

    bus: CanBus
    deadline: float = 2.0

    def __init__(
        self, *, node: int, heartbeat_timeout: float = 0.5, **settings: Any
    ) -> None:
        super().__init__(**settings)
        self.node: int = check_whole(self.name, "node", node, 0, 0x3E)
        self.heartbeat_timeout: float = check_seconds(
            self.name, "heartbeat_timeout", heartbeat_timeout
        )

    def _frames(self, *messages: Message, limit: int) -> Inbox[CanFrame]:
        ids = (frame_id(self.node, message) for message in messages)
        return self.bus.frames(*ids, limit=limit)

    def _beats(self, inbox: Inbox[CanFrame]) -> AsyncIterator[Heartbeat]:
        """Yield each heartbeat; an axis without any is lost."""
        what = f"no heartbeat of node {self.node}"
        return heard(self, inbox, self.heartbeat_timeout, _heartbeat, what)


def _heartbeat(frame: CanFrame) -> Heartbeat | None:
    with contextlib.suppress(FrameError):
        return decode_heartbeat(frame.data)
    return None


class _AxisSettings(TypedDict, total=False):
    node: Required[int]
    heartbeat_timeout: float


class _SensorSettings(_AxisSettings, SensorSettings): ...


class _ActuatorSettings(_AxisSettings, ActuatorSettings): ...


class OdriveState(_OnAxis, Sensor[AxisReading]):
    """What an axis measures, each time that it tells, and how it is.

    An error of the axis is no fault of this sensor: it is in the reading. Without a
    heartbeat for ``heartbeat_timeout`` the axis is lost.

    Args:
        node: The node id of the axis.
        heartbeat_timeout: In seconds.

    Attributes:
        bad_frames: How many frames were too short.
    """

    counted: ClassVar[tuple[str, ...]] = ("bad_frames",)

    def __init__(self, **settings: Unpack[_SensorSettings]) -> None:
        super().__init__(**settings)
        self.bad_frames: int = 0
        if self.period is None:  # it may have a heartbeat, and tell no estimates
            self.period = self.heartbeat_timeout

    async def open(self) -> None:
        """Make sure that the axis is there."""
        with self._frames(Message.HEARTBEAT, limit=4) as inbox:
            await anext(self._beats(inbox))

    async def stream(self) -> AsyncIterator[AxisReading]:
        """Yield each estimate of the encoder."""
        heartbeat_id = frame_id(self.node, Message.HEARTBEAT)
        loop = asyncio.get_running_loop()
        due = loop.time() + self.heartbeat_timeout
        heartbeat: Heartbeat | None = None
        inbox = self._frames(Message.HEARTBEAT, Message.GET_ENCODER_ESTIMATES, limit=64)
        with inbox:
            # It may measure, but its heart stand still; or its beat wait behind that.
            while inbox or loop.time() < due:
                try:
                    frame = await inbox.take(timeout=max(0.0, due - loop.time()))
                    if frame.id == heartbeat_id:
                        heartbeat = decode_heartbeat(frame.data)
                        due = loop.time() + self.heartbeat_timeout
                        continue
                    position, velocity = decode_estimates(frame.data)
                except FrameError:
                    self.bad_frames += 1
                    continue
                except TimeoutError:
                    break
                except StopAsyncIteration:
                    return
                if heartbeat is not None:
                    yield AxisReading(
                        position, velocity, heartbeat.state, heartbeat.error_names
                    )
        told = f"no heartbeat of node {self.node} for {self.heartbeat_timeout:g} s"
        raise DeviceLostError(self.name, told)


class OdriveAxis(_OnAxis, Actuator[float]):
    """An axis that is told a velocity in rad/s, a position in rad or a torque in Nm.

    It is armed, which is to say it enters closed loop control, only by a command that
    is not the safe one. The safe command never arms it: an axis that is armed gets it
    as its input, one that is not stays as it is.

    At each opening the axis must show a heartbeat, and errors that it shows are cleared;
    those that remain are a fault. While it is open an error, a disarming that nobody
    asked for, or an arming that does not come about is a fault with the names of the
    errors at once; no heartbeat for ``heartbeat_timeout`` means that it is lost. After
    either it is opened again, and not armed until a fresh command.

    Args:
        node: The node id of the axis.
        control: What commands are: ``"velocity"``, ``"position"`` or ``"torque"``.
        safe: The safe command; 0 for a velocity or torque, `esair.HOLD` for a position:
            the axis stays where it is, at velocity 0. A position that it moves to is for
            the stop alone; whoever protects the axis has it stay (``safe_moves``).
        idle: Whether the safe command also takes the power from the motor, so that it
            turns freely. An axis that holds a position cannot be let go like that.
        heartbeat_timeout: In seconds.
    """

    def __init__(
        self,
        *,
        control: Literal["velocity", "position", "torque"] = "velocity",
        safe: float | None = None,
        idle: bool = False,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        check_choice(self.name, "control", control, ("velocity", "position", "torque"))
        self.control: ControlMode = ControlMode[control.upper()]
        self.claim: str = f"node {self.node}"
        goes = self.control is ControlMode.POSITION
        if idle and goes:
            raise ConfigError(
                self.name,
                "idle",
                "expected false: an axis without power does not hold its safe position",
            )
        if safe is None:
            safe = HOLD if goes else 0.0
        self.safe = safe
        self.safe_moves: bool = goes and safe is not HOLD
        self.idle = idle
        self._armed_at: float | None = None
        self._idle_at: float | None = None  # when it was told to be idle
        """When it was told to enter closed loop control; None if it was not."""
        self._holds = False
        """Whether it is kept where it is, at velocity 0 instead of at a position."""
        self._rest: tuple[Message, bytes] | None = None
        """The input that it was told last, if that was safe."""
        self._confirmed = False
        self._watching: asyncio.Task[None] | None = None

    def safe_frames(self) -> SafeFrames:
        """The safe input, which arms nothing; then no power, if that is asked for."""
        told = _HELD if self.safe is HOLD else (encode_input(self.control, self.safe),)
        frames = [
            can_frame(frame_id(self.node, message), data) for message, data in told
        ]
        if self.idle:
            idle = frame_id(self.node, Message.SET_AXIS_STATE)
            frames.append(
                can_frame(idle, encode(Message.SET_AXIS_STATE, AxisState.IDLE))
            )
        return SafeFrames(frames)

    @property
    def is_armed(self) -> bool:
        """Whether the axis was told to enter closed loop control."""
        return self._armed_at is not None

    async def open(self) -> None:
        """Make sure that it is there and without errors; it is not armed by that."""
        self._rest = None
        inbox = self._frames(Message.HEARTBEAT, limit=4)
        try:
            beats = self._beats(inbox)
            heartbeat = await anext(beats)
            if heartbeat.errors:
                await self._send(Message.CLEAR_ERRORS, b"\0")
                heartbeat = await self._cleared(beats)
            # One that was left armed is: its safe command is the next thing that it gets.
            was_armed = heartbeat.state is AxisState.CLOSED_LOOP_CONTROL
            if was_armed and self.control is ControlMode.POSITION:
                await self._hold()  # its mode would have it go where it was to go last
            else:
                await self._send(Message.SET_CONTROLLER_MODE, encode_mode(self.control))
        except BaseException:
            inbox.close()
            raise
        now = asyncio.get_running_loop().time()
        self._armed_at = now if was_armed else None
        self._confirmed = was_armed
        self._idle_at = None
        self._watching = watching(self, inbox, self._watch)

    async def is_set_up(self) -> bool:
        """Tell whether it has been heard all the time: it starts anew in silence."""
        return self._watching is not None and not self._watching.done()

    async def close(self) -> None:
        """Watch it no more."""
        await ended(self._watching)

    def check(self, command: float) -> None:
        """Refuse a command that no frame can hold.

        Raises:
            BadValueError: It is one.
        """
        try:
            encode_input(self.control, command)
        except OverflowError:
            told = f"{command!r} does not fit a single float"
            raise BadValueError(self.name, "command", told) from None

    async def write(self, command: float) -> None:
        """Tell the axis its input, and arm it if that is no safe command."""
        self._rest = None
        if command is HOLD:
            await self._hold()  # means nothing to one that is not armed
            return
        message, data = encode_input(self.control, command)
        if command == self.safe:
            await self._send(message, data)
            self._rest = message, data
            await self._let_go()
            if self.idle:
                self._armed_at = None
                self._idle_at = asyncio.get_running_loop().time()
                await self._enter(AxisState.IDLE)
            return
        self._idle_at = None
        if self._armed_at is None:
            # With its mode: it may have started anew more quickly than is noticed.
            await self._send(Message.SET_CONTROLLER_MODE, encode_mode(self.control))
            await self._enter(AxisState.CLOSED_LOOP_CONTROL)
            self._armed_at = asyncio.get_running_loop().time()
            self._confirmed = self._holds = False
        await self._send(message, data)
        await self._let_go()

    async def _hold(self) -> None:
        self._holds = True
        for message, data in _HELD:
            await self._send(message, data)
        self._rest = message, data

    async def _let_go(self) -> None:
        """Have it go to its position, after that was told: not to the one before."""
        if self._holds:
            await self._send(Message.SET_CONTROLLER_MODE, encode_mode(self.control))
            self._holds = False

    async def _enter(self, state: AxisState) -> None:
        message = Message.SET_AXIS_STATE
        await self._send(message, encode(message, state))

    async def _send(self, message: Message, data: bytes) -> None:
        await self.bus.send(frame_id(self.node, message), data, replaces=True)

    async def _cleared(self, beats: AsyncIterator[Heartbeat]) -> Heartbeat:
        """Wait for a heartbeat without errors, which may be the second one."""
        for _ in range(3):
            heartbeat = await anext(beats)
            if not heartbeat.errors:
                return heartbeat
        raise DeviceFaultError(
            self.name, f"errors remain: {', '.join(heartbeat.error_names)}"
        )

    async def _watch(self, inbox: Inbox[CanFrame]) -> None:
        try:
            async for heartbeat in self._beats(inbox):
                self._check_state(heartbeat)
                if self._rest is not None and self.own_timeout is not None:
                    with room_comes():  # or its watchdog would disarm it at rest
                        await self._send(*self._rest)
        finally:
            self._armed_at = None

    def _check_state(self, heartbeat: Heartbeat) -> None:
        if heartbeat.errors:
            raise DeviceFaultError(self.name, ", ".join(heartbeat.error_names))
        now = asyncio.get_running_loop().time()
        if self._armed_at is None:
            idle_for = 0.0 if self._idle_at is None else now - self._idle_at
            is_armed = heartbeat.state is AxisState.CLOSED_LOOP_CONTROL
            if is_armed and idle_for > ARM_TIMEOUT:
                text = f"it is armed {ARM_TIMEOUT:g} s after it was told to be idle"
                raise DeviceFaultError(self.name, text)
        elif heartbeat.state is AxisState.CLOSED_LOOP_CONTROL:
            self._confirmed = True
        elif self._confirmed:
            raise DeviceLostError(  # which is nothing wrong: it may have restarted
                self.name, f"it has left closed loop control for {heartbeat.state.name}"
            )
        elif now - self._armed_at > ARM_TIMEOUT:
            raise DeviceFaultError(
                self.name,
                f"it was not armed in {ARM_TIMEOUT:g} s: it is {heartbeat.state.name}",
            )
