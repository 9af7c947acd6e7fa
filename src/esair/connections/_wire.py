"""What leaves for the driver of one actuator, and how its safe command gets there."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import enum
import logging
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Protocol

import attrs

from esair.connections._calls import Call, End, Guard, Method, translate_call
from esair.connections._device import Operating
from esair.connections._values import CommandCheck, is_same
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    NoTurnError,
    StoppingError,
    describe,
)
from esair.flaws import unsound
from esair.journal import Journal, Kind
from esair.loop import REACHED, SAFE, Deadline, Deadlines, spawn, wake
from esair.messages import Refused, ResourceState, Written
from esair.resources import HOLD, Actuator

if TYPE_CHECKING:
    from esair.connections._actuator_channel import ActuatorChannel
    from esair.connections._device import Device
    from esair.connections._sensor_channel import AppliedChannel

_ABSENT = DeviceLostError, DriverStuckError, EOFError, OSError
"""The errors of a device that is not there, or says nothing."""

SAFE_TRIES = 3
"""How often the safe command is tried before the actuator counts as unsafe."""

SENT = Kind.SENT  # hot

TURN_WITHIN = 0.3
"""How long the safe command waits at most for a write in flight, in seconds."""

NOT_YET = "it has not answered yet"


_log = logging.getLogger("esair")


class Watched(Protocol):
    """The watchdog, as an actuator sees it."""

    def may_move(self) -> bool:
        """Hear that it is about to move; false once the watchdog has acted."""

    def is_safe(self) -> None:
        """Hear that it has taken its safe command."""


@attrs.define(eq=False)
class Told:
    """What one actuator was told last."""

    command: Any = None  # as nobody else can change it
    is_safe: bool = False  # whether it is the safe command, sent as such
    error: str = "it was never told anything"  # why not; empty if its driver took it
    at: float = 0.0  # when it was told what nobody wrote: safe, or less by a guard
    base: Any = None
    """Where it is, as far as it has said, while it was told to stay, or until a command
    has left that waits for the device."""
    is_undone: bool = False  # whether a motion has ended since that may undo it

    @property
    def place(self) -> Any:
        """Where the device is; None if nobody knows, as after an operation."""
        place = self.base if self.command is HOLD else self.command
        return None if isinstance(place, Operating) else place


@attrs.define(eq=False)
class Wire:
    """The way of commands to one driver; `send` is the only one of a motion."""

    _device: Device
    _journal: Journal = attrs.field(init=False)
    _begin: Callable[..., Any] = attrs.field(init=False)
    _deadline: float = attrs.field(init=False)
    actuator: Actuator[Any] = attrs.field(init=False)
    method: Method = attrs.field(init=False)
    check: CommandCheck = attrs.field(init=False)
    blocks: bool = attrs.field(init=False)  # whether its driver is called in a thread
    copies: bool = attrs.field(init=False)
    """Whether somebody could change a command after its check."""
    slews: bool = attrs.field(init=False)
    """Whether how fast its commands change is limited."""
    command_timeout: float = attrs.field(init=False)
    turn_within: float = attrs.field(init=False)
    """How long its safe command waits for a write in flight, in seconds."""
    still: Any = attrs.field(init=False)
    """What it is told for protection's sake: its safe command, or to stay where that is a
    place to go."""
    told: Told = attrs.field(init=False)
    lane: Call | None = None  # what waits for the device: there is one at a time
    applied: AppliedChannel | None = None  # given each command that was applied
    watch: Watched | None = None  # told when it moves, and when it is safe

    def __attrs_post_init__(self) -> None:
        self._journal = self._device.registrations.journal

    def attach(self, actuator: Actuator[Any]) -> None:
        """Write to this actuator from now on; it was told nothing."""
        self.actuator = actuator
        self.told = Told()
        self._begin = self._device.calls.begin  # hot
        self.configured()

    def configured(self) -> None:
        """Take over changed limits and time-outs."""
        actuator = self.actuator
        self.command_timeout = float(actuator.command_timeout)
        self._deadline = actuator.deadline
        self.turn_within = min(self._deadline, self.command_timeout, TURN_WITHIN)
        self.still = HOLD if actuator.safe_moves else actuator.safe
        check = self.check = CommandCheck(actuator)
        self.copies, self.slews = check.copies, check.slews
        method = self._device.driver.method("write")
        self.blocks = method.executor is not None
        write = method.function
        if self.copies:
            # The driver's and the guards' code may change what is in theirs.
            method = attrs.evolve(
                method, function=lambda command: write(copy.deepcopy(command))
            )
        self.method = method

    def send(
        self,
        command: Any,
        behavior: str,
        guard: Guard | None = None,
    ) -> Any:
        """Hand a motion to the driver, without a wait if that has none.

        Args:
            command: What has been checked.
            behavior: Whose will it is; empty if it is nobody's.
            guard: What a thread asks just before it calls the driver.

        Returns:
            What the driver has answered, or the call that goes on.

        Raises:
            EsairError: What the driver has raised, as its caller gets it.
        """
        if self.watch is not None and not is_same(command, self.still):
            self.about_to_move()
        told = self.told
        before = told.command
        # A copy of its own: who has the answer may change what is in it.
        told.command = copy.deepcopy(command) if self.copies else command
        told.is_safe = False
        if self._journal.heard.sent:
            self._journal.publish(SENT, self._device.name, behavior, command)
        begin = self._begin  # hot
        try:
            sent = begin("write", self.method, (command,), self._deadline, guard)
        except Exception as error:
            told.base = told.base if before is HOLD else before
            failed = self.in_doubt(self.failed(error, "write"), command)
            raise failed from failed.__cause__
        if sent is not None and type(sent) is Call:
            self.lane = sent
            told.error = NOT_YET
            if before is not HOLD:
                told.base = before
            return sent
        told.error = ""  # done: most drivers need not wait
        return sent

    @property
    def patience(self) -> float:
        """How long its safe command may take in all, in seconds."""
        return self.turn_within + self._deadline + 0.1

    def about_to_move(self) -> None:
        """Tell the watchdog of a motion that leaves now.

        Raises:
            StoppingError: It has made the device safe: this process is about to end.
        """
        if self.watch is not None and not self.watch.may_move():
            raise StoppingError(self._device.name, "made safe by the watchdog")

    def copied(self, command: Any) -> Any:
        """Return a command that nobody but its holder can change."""
        return copy.deepcopy(command) if self.copies else command

    def slewed(self, command: Any, seconds: float) -> Any:
        """Return a command as it may be sent so many seconds after the last one.

        It is as it was if nobody knows where the device stays: its driver has not said.
        """
        told, before = self.told, self.told.place
        if command is HOLD:
            told.base = before
            return command
        return (
            command if before is None else self.check.slewed(command, before, seconds)
        )

    def failed(self, error: BaseException, kind: str) -> EsairError:
        """Take note of what the driver has raised; returns what its caller gets."""
        told, device = self.told, self._device
        if kind == "write" and told.command is HOLD:
            told.command = told.base  # it may move on
        self.unknown()
        translated = self.translated(error, kind)
        told.error = describe(translated)
        if self._journal.heard.unanswered:
            self._journal.publish(
                Kind.UNANSWERED, device.name, "", told.command, told.error
            )
        device.robot.on_error(translated)
        return translated

    def in_doubt(self, failed: EsairError, command: Any) -> EsairError:
        """Say of a loss that nobody knows what became of a motion."""
        if not isinstance(failed, DeviceLostError):
            return failed
        doubt = f"it is unknown whether {command!r:.80} was applied, it is not repeated"
        told = f"{failed.detail}; {doubt}" if failed.detail else doubt
        doubtful = DeviceLostError(self._device.name, told)
        doubtful.__cause__ = failed
        return doubtful

    def translated(self, error: BaseException, kind: str = "write") -> EsairError:
        """Make what its caller gets of what the driver has raised."""
        return translate_call(self._device.name, kind, self.actuator.deadline, error)

    def took(self, command: Any, answer: Any) -> None:
        """Take note of what was applied, and tell those who read it."""
        if isinstance(answer, Written):
            answer = answer.command
        if isinstance(answer, Refused):  # its owner does with it what he likes
            self.unknown()
            return
        if command is HOLD and answer is not None:
            self.told.base = answer
        if self.applied is None:
            return
        if self.told.command is HOLD and getattr(self.actuator, "lets_go", False):
            self.unknown()  # whoever else it is left to moves it as he likes
            return
        if answer is not None:
            command = None if self.unsound(command, answer) else answer
        elif command is HOLD and self.applied.newest is not None:  # else nobody knows
            command = self.told.base
        self.applied.took(copy.deepcopy(command))  # who has the answer may change it

    def unknown(self) -> None:
        """Tell those who read it that nobody knows what is applied now."""
        if self.applied is not None:
            self.applied.took(None)

    def unsound(self, command: Any, applied: Any) -> DeviceFaultError | None:
        """Return what is wrong with what a driver says it has applied, if anything is."""
        # Of another class it is whatever its driver means by it.
        told = unsound(applied) if isinstance(applied, type(command)) else ""
        fault = DeviceFaultError(self._device.name, f"it has applied: {told}")
        return fault if told else None

    def busy_for(self) -> float:
        """Tell for how long at most the device has something else than a command."""
        lane = self.lane
        if lane is None or lane.kind == "write":
            return 0.0
        return lane.until - self._device.time()

    def unsettled(self) -> Call | None:
        """Return a call that is alive, and may still undo what it was told since.

        A safe command may, too: there are actuators that are safe where they stay.
        """
        alive = self._device.calls.alive
        if not (alive or self._device.robot.left):
            return None
        mine = [call for call in alive.values() if call.may_move]
        mine += self.motions_left()
        return min(mine, key=lambda call: call.kind == "safe", default=None)

    def motions_left(self) -> Iterator[Call]:
        """Yield the motions that nobody waits for, and that have not ended."""
        for call in self._device.robot.left:
            if call.may_move and call.resource == self._device.name:
                yield call


class State(enum.Enum):
    """Where a safe command is that somebody has asked for."""

    DUE = "it waits for a write in flight"
    ON_ITS_WAY = "the driver has it"
    AGAIN = "the driver has it, and gets it once more"


DUE, ON_ITS_WAY, AGAIN = State


@attrs.define(eq=False)
class SafeCommand:
    """Makes one actuator safe: it is the last thing on the wire.

    Nothing begins while it is on its way, and it is sent again when a motion ends that
    was begun before it.
    """

    _wire: Wire
    _device: ActuatorChannel
    _refused: Deadline = attrs.field(init=False)
    """When it is sent again because the device has refused it."""
    _last_moment: float = math.inf  # until when the robot waits for it, if it goes
    _pulses: list[asyncio.Future[None]] = attrs.field(factory=list)
    _task: asyncio.Task[bool] | None = None
    _number: int = 0  # of the newest call with the safe command, if that waits
    _stays: bool = False
    """What is on its way is to stay, because safe is a place to go."""
    state: State | None = None  # nobody has asked for it

    def __attrs_post_init__(self) -> None:
        loop = self._device.loop
        self._refused = Deadlines.of(loop).idle(self._once_more)
        for call in self._wire.motions_left():  # of one of this name, which was removed
            over: asyncio.Future[None] = loop.create_future()
            over.add_done_callback(lambda _: self.repeat())
            call.waiters.append(over)

    def attach(self) -> None:
        """Begin with a device that was told nothing."""
        if self._task is None:
            self.state = None
        self._number = 0
        self._last_moment = math.inf

    def make(self, *, stay: bool = False) -> asyncio.Task[bool]:
        """Send the safe command, before anything else; or have it stay where it is."""
        self._device.made_safe()
        stay = stay and self._wire.actuator.safe_moves
        task = self._task
        if task is None:
            self._stays = stay
            task = self._begin()
        elif self._stays and not stay:
            self._stays = False
            if self.state is ON_ITS_WAY:
                self.state = AGAIN  # it was told to stay: safe comes after that
        return task

    def _begin(self) -> asyncio.Task[bool]:
        self.state = DUE
        name = f"{self._device.name} safe"
        task = self._task = spawn(self._device.loop, self._send(), name=name)
        # A task that is cancelled before its first step runs none of its code.
        task.add_done_callback(self._over)
        return task

    def _once_more(self) -> None:
        """Send it again, because it was refused; unless something else was sent since."""
        if self.is_refused and self._device.state is ResourceState.READY:
            self._begin()

    @property
    def is_refused(self) -> bool:
        """Whether it was told last, and not taken."""
        told = self._wire.told
        last = told.command is HOLD if self._stays else told.is_safe
        return last and bool(told.error) and self._task is None

    def repeat(self) -> None:
        """Send it again: a motion has ended that may have undone it."""
        device, wire = self._device, self._wire
        wire.told.is_undone = True
        if self._task is None and device.state is ResourceState.READY:
            self.make(stay=wire.told.command is HOLD)
            return
        if self.state is ON_ITS_WAY:
            self.state = AGAIN
        safe = device.calls.alive.get(self._number)
        if safe is not None and safe.kind == "safe":  # its answer may be long in coming
            Deadlines.of(device.loop).after(wire.turn_within, self._overtake, safe)

    def after_operation(self) -> None:
        """Send it, or send it again: nobody knows where an operation has ended."""
        if self._task is None:
            self.make(stay=True)
        elif self.state is ON_ITS_WAY:
            self.state = AGAIN

    def overtaken(self, call: Call) -> bool:
        """Tell whether the safe command was begun after another call."""
        return call.number < self._number

    def up(self) -> None:
        """The device is open, and was told it by `at_opening`."""
        again = self.state is AGAIN
        if self._task is None:
            self.state = None
        if again:
            self.make()
        elif self._wire.told.error:
            self._send_later()

    def close(self) -> None:
        """Nobody waits for it any more; a thread that has it goes on."""
        if self._task is not None:
            self._task.cancel()

    def latch(self, until: float) -> None:
        """The robot stops, or the device goes, and waits for it until then."""
        self._last_moment = until
        self.pulse()

    def pulse(self) -> None:
        """Let those look again who wait until it is the last thing on the wire."""
        pulses, self._pulses = self._pulses, []
        wake(*pulses)

    async def settled(self, until: float = math.inf) -> None:
        """Wait until it is the last thing on the wire; bounded."""
        device, give_up = self._device, min(self._last_moment, until)
        while self._task is not None or (
            device.state is ResourceState.READY and self._wire.unsettled()
        ):
            now = device.time()
            give_up = min(give_up, now + self._wire.patience)
            if give_up - now <= REACHED:
                return
            await self._pulsed(give_up - now)

    async def _pulsed(self, seconds: float) -> None:
        """Wait until something has ended, for so long at most."""
        loop = self._device.loop
        pulse: asyncio.Future[None] = loop.create_future()
        self._pulses.append(pulse)
        await Deadlines.of(loop).pulse(pulse, seconds)

    def _overtake(self, safe: Call) -> None:
        """Send it beside one that has no answer: a motion may have undone that."""
        device, wire = self._device, self._wire
        if safe.outcome is None and device.state is ResourceState.READY:
            with contextlib.suppress(Exception):  # the answer to the other one counts
                limit = wire.actuator.deadline
                beside = device.calls.begin("safe", wire.method, safe.args, limit)
                if type(beside) is Call and wire.lane is None:
                    wire.lane = beside  # no motion leaves beside it
                    beside.apply = self._has_landed

    def _has_landed(self, call: Call, _: End) -> None:
        if call.ended is not None and call is self._wire.lane:
            self._wire.lane = None
            self._device.idle()

    async def _send(self) -> bool:
        device, wire = self._device, self._wire
        try:
            with device.driver.urgency.raised(SAFE):
                begun = device.time()
                if wire.lane is not None and wire.lane.kind == "write":
                    wire.lane.withdraw()
                # What moves nothing may take its time.
                while wire.lane is not None and wire.lane.may_move:
                    most = min(wire.turn_within, (self._last_moment - begun) / 2)
                    if (seconds := begun + most - device.time()) <= REACHED:
                        break
                    await self._pulsed(seconds)
                while True:
                    self.state = ON_ITS_WAY
                    took = await self._try()
                    # It may have been asked for once more meanwhile.
                    if not took or self.state is ON_ITS_WAY:
                        return took
        finally:
            me = asyncio.current_task()
            if me is not None:
                self._over(me)

    def _over(self, task: asyncio.Task[Any]) -> None:
        if self._task is task:
            self._task = None
            self.state = None
            self._device.idle()

    async def _try(self) -> bool:
        device, wire = self._device, self._wire
        error: EsairError | None = None
        tries = turns = 0
        while tries < SAFE_TRIES:
            if device.state is not ResourceState.READY:
                lost = device.error or DeviceLostError(device.name)
                wire.told.error = describe(lost)
                break
            opening = device.calls.opening
            try:
                await self._tell()
            except Exception as raised:
                if opening == device.calls.opening:
                    error = wire.failed(raised, "safe")
            else:
                return True
            if type(error) is NoTurnError:  # it was not asked: that is no answer
                turns += 1
                if turns == SAFE_TRIES:
                    _log.error("%s: still not told to be safe: %s", device.name, error)
            else:
                tries += 1
            await asyncio.sleep(0.01 * min(tries + turns - 1, 10))
        ready = device.state is ResourceState.READY
        if ready or isinstance(error, DriverStuckError):
            safe = wire.actuator.safe
            _log.critical("%s: UNSAFE: it did not take %r", device.name, safe)
        if ready:
            # It comes back when it takes its safe command after an opening.
            told = "it does not take its safe command"
            device.robot.on_error(DeviceLostError(device.name, told))
        return False

    async def _tell(self, limit: float | None = None) -> None:
        device, wire = self._device, self._wire
        actuator, calls, told = wire.actuator, device.calls, wire.told
        command = HOLD if self._stays else actuator.safe
        if command is HOLD:
            told.base = told.place
        told.command = command
        told.at = device.time()
        told.is_safe = not self._stays
        told.error = NOT_YET
        self._number, told.is_undone = calls.number + 1, False
        opening = calls.opening
        limit = limit or actuator.deadline
        applied = calls.begin("safe", wire.method, (command,), limit)
        if type(applied) is Call:
            applied = await self._outcome(applied)
        if opening == calls.opening and calls is device.calls:
            if isinstance(applied, Refused):  # nobody knows whether it came there
                told.error = applied.rule
                told.base = told.base if wire.still is HOLD else wire.still
                wire.unknown()
                self._send_later()
                return
            told.error = ""
            if getattr(actuator, "lets_go", False) and applied is not None:
                wire.still = applied
            wire.took(command, applied)
            if wire.watch is not None:
                wire.watch.is_safe()
            journal = device.registrations.journal
            if journal.heard.safe:
                journal.publish(Kind.SAFE, device.name, "", command)

    def _send_later(self) -> None:
        self._refused.start(self._device.time() + self._wire.turn_within)

    async def _outcome(self, call: Call) -> Any:
        device, wire = self._device, self._wire
        try:
            return await device.calls.outcome(call)
        finally:
            ready = device.state is ResourceState.READY
            if ready and call.is_abandoned and wire.lane is None:
                wire.lane = call  # its driver still has the device

    async def at_opening(self) -> None:
        """Send it to a device that was just opened."""
        # What has ended until now, it is sent after; `up` sends it after what follows.
        self.state, self._stays = ON_ITS_WAY, False
        self._wire.told.command = None  # it may have been moved since
        for left in reversed(range(SAFE_TRIES)):
            try:
                await self._tell()
                return
            except BaseException as error:
                self._wire.told.error = describe(error)
                # One that is there would move on until the next opening, which may be late.
                is_there = isinstance(error, Exception) and not isinstance(
                    error, _ABSENT
                )
                if not left or not is_there:
                    raise
            await asyncio.sleep(0.01)

    async def at_closing(self) -> None:
        """Send it to a device that is to be closed: it may move still."""
        told = self._wire.told
        if not (told.command is None or told.command is HOLD or told.is_safe):
            urgent = self._device.driver.urgency.raised(SAFE)
            with urgent, contextlib.suppress(Exception):  # it may be gone, or not obey
                await self._tell(self._wire.turn_within)

    async def at_last(self, within: float) -> None:
        """Send it to a device that is closed now, if a motion has ended after it."""
        if self._wire.told.is_undone:
            with contextlib.suppress(Exception):  # it may be gone, or not obey
                await self._tell(min(within, self._wire.turn_within))
