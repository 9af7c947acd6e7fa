"""An ODrive axis that turns as it is told, without a motor."""

from __future__ import annotations

import asyncio

from esair.buses import Frame
from esair.buses.can import FakeCan
from esair.drivers import odrive
from esair.drivers._on_bus import loop_of
from esair.drivers.odrive import AxisError, AxisState, ControlMode, Message

HEARTBEAT_PERIOD = 0.1  # Between two heartbeats, in seconds
ESTIMATE_PERIOD = 0.01  # Between two estimates of its encoder, in seconds


class FakeOdrive:
    """One axis. It begins to tell how it is when it is made, until `stop`.

    Args:
        can: The bus that it is on.
        node: Its node id.
        watchdog: After how many seconds without an input it stops by itself.
        boot_time: How long it is silent when it starts anew, in seconds.

    Attributes:
        state: What it does.
        errors: Why it was disarmed.
        permanent: Errors that no ``Clear_Errors`` clears.
        refuses_to_arm: Whether it ignores the request for closed loop control.
        inputs: The inputs that it got: positions in rad, velocities in rad/s or
            torques in Nm.
        requests: The states that it was asked to enter.
        position: In rad.
        velocity: In rad/s.
        cleared: How often its errors were cleared.
        bad_frames: How many frames were too short.
    """

    position: float

    def __init__(
        self,
        can: FakeCan,
        *,
        node: int = 0,
        watchdog: float | None = None,
        boot_time: float = 1.0,
    ) -> None:
        self._loop = loop_of(self)
        self.node = node
        self.watchdog = watchdog
        self.boot_time = boot_time
        self.state: AxisState = AxisState.IDLE
        self.mode: ControlMode = ControlMode.POSITION
        self.errors: AxisError = AxisError(0)
        self.permanent: AxisError = AxisError(0)
        self.refuses_to_arm = False
        self.inputs: list[float] = []
        self.requests: list[AxisState] = []
        self.position = self._goal = 0.0
        self.velocity: float = 0.0
        self.cleared: int = 0
        self.bad_frames: int = 0
        self._can = can
        can.on_send(self.receive)
        self._fed = self._loop.time()
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self.start()

    @property
    def is_armed(self) -> bool:
        """Whether its motor has power."""
        return self.state is AxisState.CLOSED_LOOP_CONTROL

    def start(self) -> None:
        """Tell how it is from now on, as after power-up."""
        self.stop()
        self._timers["heartbeat"] = self._loop.call_later(
            HEARTBEAT_PERIOD / 2, self._beat
        )
        self._timers["estimate"] = self._loop.call_later(
            ESTIMATE_PERIOD, self._estimate
        )

    def stop(self, what: str | None = None) -> None:
        """Fall silent: wholly, or only with its ``"heartbeat"`` or ``"estimate"``."""
        for name, timer in self._timers.items():
            if what in {None, name}:
                timer.cancel()

    def power_cycle(self) -> None:
        """Lose the power for a moment: it starts anew, which takes its time."""
        self.stop()
        self.state, self.mode = AxisState.IDLE, ControlMode.POSITION
        self.errors = self.permanent
        self.velocity = 0.0
        self._timers["boot"] = self._loop.call_later(self.boot_time, self.start)

    def fail(self, errors: AxisError, *, permanent: bool = False) -> None:
        """Let it disarm itself because of errors."""
        self.errors |= errors
        if permanent:
            self.permanent |= errors
        self.state = AxisState.IDLE
        self.velocity = 0.0

    def receive(self, frame: Frame) -> None:
        """Take a frame from the bus; frames for others are left alone."""
        if frame.extended or frame.id >> 5 != self.node:
            return
        try:
            self._obey(Message(frame.id & 0x1F), frame.data)
        except odrive.FrameError:
            self.bad_frames += 1
        except ValueError:
            return  # a message that it does not know

    def _obey(self, message: Message, data: bytes) -> None:
        if message is Message.SET_AXIS_STATE:
            state = AxisState(*odrive.decode(message, data))
            self.requests.append(state)
            if state is AxisState.CLOSED_LOOP_CONTROL and (
                self.errors or self.refuses_to_arm
            ):
                return
            self.state = state
            self._fed = self._loop.time()
            self.velocity = 0.0
        elif message is Message.SET_CONTROLLER_MODE:
            self.mode = ControlMode(odrive.decode(message, data)[0])
            self._go()
        elif message is Message.CLEAR_ERRORS:
            self.cleared += 1
            self.errors = self.permanent
        elif message is Message.ESTOP:
            self.fail(AxisError.ESTOP_REQUESTED)
        else:
            self.inputs.append(odrive.decode_input(message, data))
            self._fed = self._loop.time()
            if not self.is_armed:
                return
            if message is Message.SET_INPUT_POS:
                self._goal = self.inputs[-1]
            elif message is Message.SET_INPUT_VEL:
                self.velocity = self.inputs[-1]
            self._go()

    def _go(self) -> None:
        """Be where it is to go, in the mode in which it goes somewhere."""
        if self.is_armed and self.mode is ControlMode.POSITION:
            self.position = self._goal

    def _beat(self) -> None:
        self._timers["heartbeat"] = self._loop.call_later(HEARTBEAT_PERIOD, self._beat)
        self._tell(
            Message.HEARTBEAT,
            odrive.encode_heartbeat(odrive.Heartbeat(self.errors, self.state)),
        )

    def _estimate(self) -> None:
        self._timers["estimate"] = self._loop.call_later(
            ESTIMATE_PERIOD, self._estimate
        )
        self.position += self.velocity * ESTIMATE_PERIOD
        silence = self._loop.time() - self._fed
        if self.is_armed and self.watchdog is not None and silence > self.watchdog:
            self.fail(AxisError.WATCHDOG_TIMER_EXPIRED)
        self._tell(
            Message.GET_ENCODER_ESTIMATES,
            odrive.encode_estimates(self.position, self.velocity),
        )

    def _tell(self, message: Message, data: bytes) -> None:
        self._can.feed(odrive.frame_id(self.node, message), data)
