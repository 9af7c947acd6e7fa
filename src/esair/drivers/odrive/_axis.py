"""An axis of an ODrive, as a sensor and as an actuator."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, ClassVar, Literal, Required, TypedDict, Unpack

import attrs

from esair.buses import CanBus, Inbox
from esair.buses import Frame as CanFrame
from esair.drivers._on_bus import ended
from esair.drivers.odrive._codec import (
    AxisState,
    ControlMode,
    FrameError,
    Heartbeat,
    Message,
    decode_estimates,
    decode_heartbeat,
    encode,
    encode_input,
    encode_mode,
    frame_id,
)
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError, EsairError
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

    async def _next(self, inbox: Inbox[CanFrame]) -> Heartbeat:
        """Wait for the next heartbeat."""
        loop = asyncio.get_running_loop()
        due = loop.time() + self.heartbeat_timeout
        while True:
            try:
                frame = await inbox.take(timeout=max(0.0, due - loop.time()))
                return decode_heartbeat(frame.data)
            except FrameError:
                continue
            except TimeoutError:
                raise self._silent() from None

    def _silent(self) -> DeviceLostError:
        return DeviceLostError(
            self.name,
            f"no heartbeat of node {self.node} for {self.heartbeat_timeout:g} s",
        )


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

    async def open(self) -> None:
        """Make sure that the axis is there."""
        with self._frames(Message.HEARTBEAT, limit=4) as inbox:
            await self._next(inbox)

    async def stream(self) -> AsyncIterator[AxisReading]:
        """Yield each estimate of the encoder."""
        heartbeat_id = frame_id(self.node, Message.HEARTBEAT)
        loop = asyncio.get_running_loop()
        due = loop.time() + self.heartbeat_timeout
        heartbeat: Heartbeat | None = None
        inbox = self._frames(Message.HEARTBEAT, Message.GET_ENCODER_ESTIMATES, limit=64)
        with inbox:
            while True:
                try:
                    frame = await inbox.take(timeout=max(0.0, due - loop.time()))
                except TimeoutError:
                    raise self._silent() from None
                except StopAsyncIteration:
                    return
                try:
                    if frame.id == heartbeat_id:
                        heartbeat = decode_heartbeat(frame.data)
                        due = loop.time() + self.heartbeat_timeout
                        continue
                    position, velocity = decode_estimates(frame.data)
                except FrameError:
                    self.bad_frames += 1
                    continue
                if loop.time() >= due:  # it measures, but its heart stands still
                    raise self._silent()
                if heartbeat is not None:
                    yield AxisReading(
                        position, velocity, heartbeat.state, heartbeat.error_names
                    )


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
        """When it was told to enter closed loop control; None if it was not."""
        self._holds = False
        """Whether it is kept where it is, at velocity 0 instead of at a position."""
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
        inbox = self._frames(Message.HEARTBEAT, limit=4)
        try:
            heartbeat = await self._next(inbox)
            if heartbeat.errors:
                await self._send(Message.CLEAR_ERRORS, b"\0")
                heartbeat = await self._cleared(inbox, heartbeat)
            # One that was left armed is: its safe command is the next thing that it gets.
            was_armed = heartbeat.state is AxisState.CLOSED_LOOP_CONTROL
            if was_armed and self.control is ControlMode.POSITION:
                await self._hold()  # its mode would have it go where it was to go last
            else:
                await self._send(Message.SET_CONTROLLER_MODE, encode_mode(self.control))
        except BaseException:
            inbox.close()
            raise
        loop = asyncio.get_running_loop()
        self._armed_at = loop.time() if was_armed else None
        self._confirmed = was_armed
        self._watching = loop.create_task(
            self._watch(inbox), name=f"{self.name} heartbeat"
        )

    async def is_set_up(self) -> bool:
        """Tell whether it has been heard all the time: it starts anew in silence."""
        return self._watching is not None and not self._watching.done()

    async def close(self) -> None:
        """Watch it no more."""
        task, self._watching = self._watching, None
        await ended(task)

    async def write(self, command: float) -> None:
        """Tell the axis its input, and arm it if that is no safe command."""
        if command is HOLD:
            await self._hold()  # means nothing to one that is not armed
            return
        message, data = encode_input(self.control, command)
        if command == self.safe:
            await self._send(message, data)
            await self._let_go()
            if self.idle:
                self._armed_at = None
                await self._enter(AxisState.IDLE)
            return
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

    async def _cleared(self, inbox: Inbox[CanFrame], heartbeat: Heartbeat) -> Heartbeat:
        """Wait for a heartbeat without errors, which may be the second one."""
        for _ in range(3):
            heartbeat = await self._next(inbox)
            if not heartbeat.errors:
                return heartbeat
        raise DeviceFaultError(
            self.name, f"errors remain: {', '.join(heartbeat.error_names)}"
        )

    async def _watch(self, inbox: Inbox[CanFrame]) -> None:
        try:
            while (problem := self._problem(await self._next(inbox))) is None:
                pass
        except (OSError, StopAsyncIteration) as error:
            self.report_lost(error if isinstance(error, OSError) else None)
        else:
            self.report_lost(problem)
        finally:
            self._armed_at = None
            inbox.close()

    def _problem(self, heartbeat: Heartbeat) -> EsairError | None:
        if heartbeat.errors:
            return DeviceFaultError(self.name, ", ".join(heartbeat.error_names))
        if self._armed_at is None:
            return None
        if heartbeat.state is AxisState.CLOSED_LOOP_CONTROL:
            self._confirmed = True
            return None
        if self._confirmed:
            return DeviceLostError(  # which is nothing wrong: it may have restarted
                self.name, f"it has left closed loop control for {heartbeat.state.name}"
            )
        if asyncio.get_running_loop().time() - self._armed_at > ARM_TIMEOUT:
            return DeviceFaultError(
                self.name,
                f"it was not armed in {ARM_TIMEOUT:g} s: it is {heartbeat.state.name}",
            )
        return None
