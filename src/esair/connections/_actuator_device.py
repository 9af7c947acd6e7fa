"""One actuator's device: its state, what it was told, and its safe command."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import logging
import math
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from esair.connections._applied_channel import AppliedChannel
from esair.connections._call import Call, End
from esair.connections._device import Device, OfRobot
from esair.connections._driver import Method, translate_call
from esair.connections._halt import LastCommand
from esair.exceptions import DeviceLostError, DriverStuckError, EsairError, describe
from esair.journal import Kind
from esair.loop import REACHED, Deadlines, spawn, wake
from esair.messages import Refused, ResourceState, Written
from esair.resources import HOLD, Actuator

SAFE_TRIES = 3
"""How often the safe command is tried before the actuator counts as unsafe."""

TURN_WITHIN = 0.3
"""How long the safe command waits at most for a write in flight, in seconds."""

_log = logging.getLogger("esair")


class Watched(Protocol):
    """The watchdog, as an actuator sees it."""

    def may_move(self) -> bool:
        """Hear that it is about to move; false once the watchdog has acted."""

    def is_safe(self) -> None:
        """Hear that it has taken its safe command."""


class ActuatorDevice(Device):
    """Makes one actuator safe, and knows whether it is.

    The safe command is the last thing on the wire: nothing begins while it is on its
    way, and it is sent again when a motion ends that was begun before it.
    """

    __slots__ = (
        "_again",
        "_base",
        "_busy",
        "_lane",
        "_last_moment",
        "_pulses",
        "_safe_number",
        "_safe_task",
        "_stays",
        "_told",
        "_told_at",
        "_told_error",
        "_told_safe",
        "_write",
        "actuator",
        "applied",
        "command_timeout",
        "latched",
        "watch",
    )

    _write: Method

    def __init__(self, actuator: Actuator[Any], robot: OfRobot) -> None:
        self.latched = False
        """Set when the robot stops: from then on only the safe command leaves."""
        self._last_moment = math.inf
        """Until when the stop of the robot waits for the safe command."""
        self._lane: Call | None = None
        """The write that waits for the device: there is one at a time."""
        self._busy = False  # a write, or the safe command, is on its way
        self._safe_task: asyncio.Task[bool] | None = None
        self._pulses: list[asyncio.Future[None]] = []
        self.watch: Watched | None = None
        """Told when it moves and when it is safe, if there is a watchdog."""
        self.command_timeout = 0.0
        self.applied: AppliedChannel | None = None
        """Given each command that was applied, if somebody reads that."""
        super().__init__(actuator, robot)
        for call in self._motions_left():  # of one of this name, which was removed
            over: asyncio.Future[None] = self.loop.create_future()
            over.add_done_callback(lambda _: self._repeat_safe())
            call.waiters.append(over)

    def attach(self, actuator: Actuator[Any]) -> None:
        """Write to this actuator from now on; it was told nothing."""
        self.actuator = actuator
        self._again = False
        self._safe_number = 0  # the number of the newest call with the safe command
        self._stays = False
        """The safe command on its way is to stay, because safe is a place to go."""
        self._base: Any = None
        """Where the device is, as far as it has said, while it was told to stay."""
        self._told: Any = None
        self._told_at = 0.0
        """When it was told something that nobody wrote: safe, or less by a guard."""
        self._told_safe = False
        self._told_error = "it was never told anything"
        super().attach(actuator)

    def configured(self) -> None:
        """Take over changed limits and time-outs."""
        self.command_timeout = float(self.actuator.command_timeout)

    # State, told by the supervisor.

    def up(self) -> None:
        """The device is open and was told its safe command."""
        self.state = ResourceState.READY
        self.error = None
        if self.applied is not None:
            self.tell_applied(self.applied)
        if self._again:
            self.make_safe()

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: what its calls still do is fenced."""
        self.state = state
        self.error = error
        taken_away = self._told_safe and state is ResourceState.REMOVED
        if self._told_error == "" and not taken_away:
            self._told_error = f"it is {state.value}"
        self._lane = None
        if self.applied is not None:
            self.applied.down(state, error)
        self.calls.next_opening(error)
        self._idle()

    def closed(self) -> None:
        """Nobody waits for the safe command any more; a thread that has it goes on."""
        if self._safe_task is not None:
            self._safe_task.cancel()

    def tell_applied(self, channel: AppliedChannel) -> None:
        """Give each command that is applied to its readers from now on."""
        self.applied = channel
        if self.state is ResourceState.READY:
            channel.up()
            if not self._told_error:
                self._took(self._told, None)
        elif self.error is not None:
            channel.down(self.state, self.error)

    def _took(self, command: Any, answer: Any) -> None:
        if self.applied is None or isinstance(answer, Refused):
            return
        if isinstance(answer, Written):
            answer = answer.command
        if answer is not None:
            command = answer
        elif command is HOLD:
            command = self._base
        self.applied.took(copy.deepcopy(command))  # who has the answer may change it

    def between(self, method: Method, told: Callable[[End], None]) -> bool:
        """Call the driver between two commands; tells whether the device was free."""
        if self._busy or self.calls.alive:
            return False

        def ended(call: Call, end: End) -> None:
            told(end)
            if call.ended is not None and call is self._lane:
                self._lane_free(call)

        waits = self.calls.attempt(method, self.actuator.deadline, told, ended)
        if waits is not None:
            self._lane, self._busy = waits, True
        return True

    # Calls that waited.

    def _late(self, call: Call) -> None:
        """A call has ended whose outcome was out before: who knows what it did."""
        if call is self._lane:
            self._lane_free(call)
        elif call.may_move:
            self._repeat_safe()
            if self.state is ResourceState.LOST:  # because that did not end
                self.actuator.report_arrived()
        self._pulse()

    def _lane_free(self, call: Call) -> None:
        if call is self._lane:
            self._lane = None
        if call.number < self._safe_number:
            self._repeat_safe()  # the safe command has overtaken it
        self._idle()

    def _idle(self) -> None:
        """Something has ended: let those that wait look again."""
        self._busy = self._lane is not None or self._safe_task is not None
        self._pulse()

    def _pulse(self) -> None:
        pulses, self._pulses = self._pulses, []
        wake(*pulses)

    def _failed(self, error: BaseException, kind: str) -> EsairError:
        """Take note of what the driver has raised; returns what its caller gets."""
        translated = self._translated(error, kind)
        self._told_error = describe(translated)
        if self._journal.heard:
            self._journal.publish(
                Kind.UNANSWERED, self.name, "", self._told, self._told_error
            )
        self._on_error(translated)
        return translated

    def _translated(self, error: BaseException, kind: str = "write") -> EsairError:
        return translate_call(self.name, kind, self.actuator.deadline, error)

    # The safe command.

    def make_safe(self, *, stay: bool = False) -> asyncio.Task[bool]:
        """Send the safe command, before anything else."""
        task = self._safe_task
        stay = stay and self.actuator.safe_moves
        if task is not None and self._stays and not stay:
            self._again = True  # to stay may be on its way: safe comes after it
        self._stays = stay and (task is None or self._stays)
        if task is None:
            self._busy = True
            task = self._safe_task = spawn(
                self.loop, self._send_safe(), name=f"{self.name} safe"
            )
            # A task that is cancelled before its first step runs none of its code.
            task.add_done_callback(self._safe_over)
        return task

    async def safe_now(self, until: float = math.inf) -> None:
        """Wait until the safe command is the last thing on the wire; bounded."""
        turn = self._turn_within + self.actuator.deadline + 0.1
        give_up = min(self.time() + turn, self._last_moment, until)
        while self._safe_task is not None or (
            self.state is ResourceState.READY and self._unsettled()
        ):
            seconds = give_up - self.time()
            if seconds <= REACHED:
                return
            pulse: asyncio.Future[None] = self.loop.create_future()
            self._pulses.append(pulse)
            await Deadlines.of(self.loop).wait(pulse, seconds)

    @property
    def _turn_within(self) -> float:
        """How long the safe command waits for a write in flight, in seconds."""
        return min(self.actuator.deadline, self.command_timeout, TURN_WITHIN)

    def _unsettled(self) -> Call | None:
        """Return a motion that is alive, and may still undo the safe command."""
        mine = (call for call in self.calls.alive.values() if call.may_move)
        return next(mine, None) or next(self._motions_left(), None)

    def _motions_left(self) -> Iterator[Call]:
        """Yield the motions that nobody waits for, and that have not ended."""
        for call in self._left:
            if call.may_move and call.resource == self.name:
                yield call

    def _repeat_safe(self) -> None:
        if self._safe_task is None and self.state is ResourceState.READY:
            self.make_safe(stay=self._told is HOLD)
            return
        self._again = True
        safe = self.calls.alive.get(self._safe_number)
        if safe is not None:  # its answer may be long in coming
            Deadlines.of(self.loop).after(self._turn_within, self._overtake, safe)

    def _overtake(self, safe: Call) -> None:
        """Send safe beside one that has no answer: a motion may have undone that."""
        if safe.outcome is None and self.state is ResourceState.READY:
            with contextlib.suppress(Exception):  # the answer to the other one counts
                self.calls.begin("safe", self._write, safe.args, self.actuator.deadline)

    async def _send_safe(self) -> bool:
        try:
            until = self.time() + self._turn_within
            while self._lane is not None and self.time() + REACHED < until:
                await self.calls.next_end(until)
            while True:
                self._again = False
                took = await self._try_safe()
                if not (took and self._again):
                    return took
        finally:
            me = asyncio.current_task()
            if me is not None and me is self._safe_task:
                self._safe_over(me)

    def _safe_over(self, task: asyncio.Task[bool]) -> None:
        if self._safe_task is task:
            self._safe_task = None
            self._idle()

    async def _try_safe(self) -> bool:
        error: EsairError | None = None
        for attempt in range(SAFE_TRIES):
            if self.state is not ResourceState.READY:
                self._told_error = describe(self.error or DeviceLostError(self.name))
                break
            opening = self.calls.opening
            try:
                await self._tell_safe()
            except Exception as raised:
                if opening == self.calls.opening:
                    error = self._failed(raised, "safe")
            else:
                return True
            await asyncio.sleep(0.01 * attempt)
        if self.state is ResourceState.READY or isinstance(error, DriverStuckError):
            _log.critical(
                "%s: UNSAFE: it did not take %r", self.name, self.actuator.safe
            )
        if self.state is ResourceState.READY:
            # It comes back when it takes its safe command after an opening.
            self._on_error(
                DeviceLostError(self.name, "it does not take its safe command")
            )
        return False

    async def _tell_safe(self, limit: float | None = None) -> None:
        actuator, calls = self.actuator, self.calls
        command = HOLD if self._stays else actuator.safe
        if command is HOLD and self._told is not HOLD:
            self._base = self._told
        self._told = command
        self._told_at = self.time()
        self._told_safe = command is actuator.safe
        self._told_error = "it has not answered yet"
        self._safe_number = calls.number + 1
        opening = calls.opening
        limit = limit or actuator.deadline
        applied = calls.begin("safe", self._write, (command,), limit)
        if type(applied) is Call:
            applied = await self._outcome_of_safe(applied)
        if opening == calls.opening and calls is self.calls:
            self._told_error = ""
            if command is HOLD and applied is not None:
                self._base = applied
            self._took(command, applied)
            if self.watch is not None:
                self.watch.is_safe()
            if self._journal.heard:
                self._journal.publish(Kind.SAFE, self.name, "", command)

    async def _outcome_of_safe(self, call: Call) -> Any:
        try:
            return await self.calls.outcome(call)
        finally:
            ready = self.state is ResourceState.READY
            if ready and call.is_abandoned and self._lane is None:
                self._lane = call  # its driver still has the device

    async def open_safe(self) -> None:
        """Send the safe command to a device that was just opened."""
        self._again = self._stays = False  # what has ended until now, it is sent after
        try:
            await self._tell_safe()
        except BaseException as error:
            self._told_error = describe(error)
            raise

    async def last_safe(self) -> None:
        """Send the safe command to a device that is to be closed: it may move still."""
        if not (self._told is None or self._told is HOLD or self._told_safe):
            with contextlib.suppress(Exception):  # it may be gone, or not obey
                await self._tell_safe(self._turn_within)

    # What people ask.

    @property
    def is_safe(self) -> bool:
        """Whether the device was told its safe command last, took it, and is settled."""
        return self._told_safe and not self._told_error and self._unsettled() is None

    def not_told(self, error: BaseException) -> None:
        """Take note that the device could not be told its safe command."""
        self._told_error = describe(error)

    def told(self) -> LastCommand:
        error = self._told_error
        earlier = self._unsettled()
        if earlier is not None:
            error = f"{earlier}, begun before it, has not ended"
        return LastCommand(self.name, self._told, self._told_safe, not error, error)
