"""What flows through a running reaction: the newest readings in, its commands out."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import functools
import logging
from collections.abc import Awaitable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs

from esair.actions._needs import Reads
from esair.connections import (
    GRACE,
    SENT,
    ActuatorChannel,
    Decision,
    Registration,
    SensorChannel,
    Sight,
)
from esair.exceptions import (
    BadValueError,
    DeviceLostError,
    EsairError,
    ResourceRemovedError,
    StaleReadingError,
    describe,
)
from esair.loop import NEVER, REACHED, Deadline, Deadlines, Job, Order, Scheduler, Step
from esair.messages import Reading, Refused, Written

if TYPE_CHECKING:
    from esair.actions._reaction_runner import ReactionRunner

_log = logging.getLogger("esair")

EVERY_LIMIT = 256
"""How many readings of ports with ``every=True`` wait for a step; the oldest go."""

Sensing = tuple[SensorChannel, Registration, float | None]
"""A sensor of a reaction: its channel, the right to it, the greatest age of a reading."""

Moving = tuple[ActuatorChannel, Registration]
"""An actuator of a reaction: its channel, and the right to it."""

_QUICK = 100.0
"""From this rate on, in Hz, the next step finds soon enough that a reading is too old."""


@attrs.define(eq=False, repr=False)
class Input:
    """One sensor of a running reaction."""

    runner: ReactionRunner
    senses: Senses
    name: str
    place: int  # where its value is among those of the reaction
    optional: bool
    every: bool  # whether each single reading has a step
    channel: SensorChannel
    registration: Registration
    max_age: float | None
    """The greatest age of a reading; the sensor's own limit if it is None."""
    seen: int = -1  # how many steps there were when it was fed last
    ready: bool = False
    stale_at: float = NEVER

    def feed(self, reading: Reading[Any]) -> None:
        """Take a new reading; the reaction's next step decides on it."""
        senses = self.senses
        # By their places: a name in a tuple takes three times as long.  # hot
        value = senses.values[self.place] = reading[0]
        limit = self.max_age
        if limit is None:
            limit = self.channel.max_age
        if limit < NEVER:
            self.stale_at = reading[1] + limit + GRACE
            senses.refresh(self)
        if not self.ready:
            self.ready = True
            if not self.optional:
                senses.arrived()
        if senses.missing:
            self.seen = senses.steps
            return
        if self.every:
            senses.queue(self.place, value)
        elif self.seen == senses.steps:
            senses.skipped += 1
        self.seen = senses.steps
        if senses.on_reading:
            self.runner.job.soon()

    @property
    def limit(self) -> float:
        """The greatest age of a reading that the reaction decides on, in seconds."""
        return self.channel.max_age if self.max_age is None else self.max_age

    @property
    def order(self) -> Order:
        """When it is told of what happens in one moment: a guard is the last."""
        return self.senses.order

    def changed(self, error: EsairError | None) -> None:
        """Park the reaction when the sensor is gone; feeding it wakes it up."""
        if error is None:
            self.runner.resample()
        else:
            self.lose(_in_short(self.name, error))

    def limited(self) -> None:
        """Have the newest reading for as long as is said now, where the sensor says it."""
        newest = self.channel.newest
        if self.ready and self.max_age is None and newest is not None:
            self.stale_at = newest[1] + self.limit + GRACE
            self.senses.refresh(self)

    def doubt(self, error: EsairError) -> None:
        """Park it at a bad reading, if nothing else tells how old the last good one is."""
        if self.limit == NEVER:
            self.lose(f"{self.name} is bad: {error}")

    def lose(self, reason: str) -> None:
        """Have no reading any more; without one that it needs the reaction is blind."""
        if not self.ready:
            return
        self.ready = False
        self.stale_at = NEVER
        senses = self.senses
        senses.forget()
        if self.optional:
            senses.values[self.place] = None
            if senses.on_reading:
                self.runner.job.soon()
        else:
            senses.missing += 1
            self.runner.park(reason)


@attrs.define(eq=False, repr=False)
class Senses:
    """The newest readings of a reaction, and until when it may decide on them."""

    _runner: ReactionRunner
    _needs: Mapping[str, Reads[Any]]
    names: tuple[str, ...]
    """The ports that give ``react`` its readings, in the order of its parameters."""
    order: Order
    """When it is told that a reading is too old, among those to whom that happens then."""
    _rate: float | None
    values: list[Any] = attrs.field(init=False)  # the newest, in the order of the names
    inputs: list[Input] = attrs.field(factory=list)
    polled: tuple[SensorChannel, ...] | None = None
    """The sensors that are asked for what is decided on, each once."""
    is_alone: bool = attrs.field(init=False)
    on_reading: bool = attrs.field(init=False)  # each new reading has a step
    missing: int = 0  # how many sensors have no reading that may be used
    steps: int = 0  # how often was decided on them
    skipped: int = 0  # how many readings a newer one replaced before a step
    stale_at: float = NEVER
    waiting: collections.deque[tuple[int, Any]] | None = None
    """The readings that wait for a step each, of ports with ``every=True``."""
    overflow: int = 0  # how many of those were dropped because too many waited
    _watch: Deadline | None = None
    _watch_at: float = NEVER

    def __attrs_post_init__(self) -> None:
        self.values = [None] * len(self.names)
        self.is_alone = len(self.names) == 1
        self.on_reading = self._rate is None
        if self._rate is not None and self._rate >= _QUICK:
            self._watch_at = -NEVER  # no moment is earlier: it is never watched for
        if any(need.every for need in self._needs.values()):
            self.waiting = collections.deque()

    def begin(self, inputs: Mapping[str, Sensing]) -> None:
        """Have these sensors, none of which is heard yet."""
        kind, runner, needs = self._runner.input_type, self._runner, self._needs
        for name, terms in inputs.items():
            need, place = needs[name], self.names.index(name)
            each = kind(runner, self, name, place, need.optional, need.every, *terms)
            self.inputs.append(each)
        self.missing = sum(not each.optional for each in self.inputs)

    def follow(self, now: float) -> None:
        """Hear them from now on; what was heard lately is a reading, too."""
        for each in self.inputs:
            each.channel.follow(each)
            newest = each.channel.newest
            if newest is not None and now - newest.time <= each.limit:
                each.feed(newest)

    def resample(self) -> bool:
        """Go by the sensors that are asked now; tells whether those are others."""
        asked = [each for one in self.inputs for each in one.channel.sampled]
        before, self.polled = self.polled, tuple(dict.fromkeys(asked))
        return self.polled != before

    def stop(self) -> None:
        """Hear nothing more."""
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        for each in self.inputs:
            each.channel.unfollow(each)

    def by_name(self) -> dict[str, Any]:
        return dict(zip(self.names, self.values, strict=True))

    def absence(self, now: float) -> EsairError | None:
        """Make the error for a reading that is needed and not there."""
        for each in self.lacking():
            channel = each.channel
            if channel.error is not None:
                return channel.error.with_traceback(None)
            newest = channel.newest
            age = None if newest is None else now - newest.time
            return StaleReadingError(channel.name, age, each.limit)
        return None

    def lacking(self) -> list[Input]:
        return [each for each in self.inputs if not (each.ready or each.optional)]

    def arrived(self) -> None:
        self.missing -= 1
        if self.missing == 0:
            self._runner.unpark()

    def queue(self, place: int, value: Any) -> None:
        """Keep a reading for a step of its own."""
        waiting = self.waiting
        assert waiting is not None
        if len(waiting) >= EVERY_LIMIT:
            waiting.popleft()
            self.overflow += 1
        waiting.append((place, value))

    # How old they are.

    def see(self, now: float) -> bool:
        """Tell whether it can decide; one with a reading that is too old is parked."""
        if not self.missing and now >= self.stale_at:
            self._stale(now)
        return not self.missing

    def is_blind(self, now: float) -> bool:
        """Tell whether it cannot decide; nothing is parked by that."""
        return self.missing > 0 or any(
            now >= each.stale_at and not each.optional for each in self.inputs
        )

    def refresh(self, fed: Input) -> None:
        """Compute anew when the first reading becomes stale."""
        if self.is_alone:
            self.stale_at = fed.stale_at
        else:
            self.stale_at = min(each.stale_at for each in self.inputs)
        if self.stale_at < self._watch_at:
            self._watch_for_age()

    def forget(self) -> None:
        """Compute anew when the first reading becomes stale, after one is gone."""
        self.stale_at = min((each.stale_at for each in self.inputs), default=NEVER)
        if self.stale_at < self._watch_at and not self._runner.stopped:
            self._watch_for_age()

    def _watch_for_age(self) -> None:
        """Look when the first reading becomes stale: earlier than was thought, maybe."""
        if self._watch is not None:
            self._watch.cancel()
        self._watch_at = self.stale_at
        deadlines = Deadlines.of(asyncio.get_running_loop())
        self._watch = deadlines.at(self.stale_at, self._look, order=self.order)

    def _look(self) -> None:
        """Park a reaction that nothing steps before a reading is too old."""
        now = self._runner.time()
        self._watch, self._watch_at = None, NEVER
        if self.stale_at == NEVER:
            return  # it is parked; the next reading begins anew
        if now + REACHED < self.stale_at:
            self._watch_for_age()
        else:
            self._stale(max(now, self.stale_at))

    def _stale(self, now: float) -> None:
        for each in self.inputs:
            if each.ready and now >= each.stale_at:
                each.lose(f"{each.name} is older than {each.limit:g} s")
        self.forget()


class Sampling:
    """Has a step wait for the polls of its own instant, half a period at most.

    For its own, and for those of who has as much to say about what it moves: the guards,
    and whoever writes it with its priority or a higher one. So all decide together, on
    what there is to see at that moment. A sensor that lately took longer than half a
    period is not waited for.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        polled: tuple[SensorChannel, ...],
        moved: Sequence[tuple[Decision, float]],
        step: Step,
        name: str,
        rate: float,
    ) -> None:
        self._scheduler = scheduler
        self._polled = polled
        self._moved = moved
        self._half = 0.5 / rate
        self._deferred: Job = scheduler.on_demand(step, name=name)
        self._awaits = 0  # for how many samples it waits,
        self._sampled_in = 0  # and of which turn they are; 0 if it waits for none
        deadlines = Deadlines.of(asyncio.get_running_loop())
        self._patience = Deadline(deadlines, self._wait_no_longer, is_patient=False)

    def waits(self, now: float) -> bool:
        """Tell whether the step waits; then it comes when its samples are there."""
        turn, half = self._scheduler.turns, self._half
        bearing = list(self._polled)
        for decision, priority in self._moved:
            for sight in decision.sights:
                if sight.priority >= priority:
                    bearing += sight.sensors
        awaited = [
            each
            for each in dict.fromkeys(bearing)
            if each.asking.awaited_in == turn and each.asking.latency <= half
        ]
        if not awaited:
            return False
        self._awaits = len(awaited)
        self._sampled_in = turn
        for each in awaited:
            each.asking.when_answered(functools.partial(self._answered, turn))
        self._patience.start(now + half)
        return True

    def stop(self) -> None:
        self._deferred.stop()
        self._patience.cancel()

    def _answered(self, turn: int) -> None:
        """A sample has come; step when all have."""
        if turn == self._sampled_in:
            self._awaits -= 1
            if self._awaits == 0:
                self._wait_no_longer()

    def _wait_no_longer(self) -> None:
        self._sampled_in = 0
        self._patience.cancel()
        self._deferred.soon()


def _in_short(sensor: str, error: EsairError) -> str:
    """Say in a few words why there is no reading of a sensor."""
    if isinstance(error, ResourceRemovedError):
        return f"{sensor} removed"
    if isinstance(error, DeviceLostError):
        return f"{sensor} lost: {error.detail}" if error.detail else f"{sensor} lost"
    return f"{sensor}: {error}"


@attrs.define(eq=False, repr=False)
class Output:
    """One actuator of a running reaction, and what it decided for it in this turn."""

    _outputs: Outputs
    name: str
    channel: ActuatorChannel
    registration: Registration
    decision: Decision
    _sight: Sight | None = None
    command: Any = None
    """What it decided in this turn; None to give the actuator back."""
    checked: Any = None  # the same as it may be sent
    decided: bool = False  # it takes part in the decision of this turn
    active: bool = False  # it may hold the actuator
    pending: bool = False  # a write is on its way
    later: Any = None  # the newest command, while an older one is on its way

    def join(self, sensors: tuple[SensorChannel, ...]) -> None:
        """Have a say in what the actuator does, by what these sensors see."""
        self.decision.leave(self._sight)
        self._sight = Sight(self.registration.priority, sensors)
        self.decision.join(self._sight)

    def leave(self) -> None:
        """Send nothing more of what was decided, and have no say."""
        self.forget()
        self.decision.leave(self._sight)

    def decide(self, command: Any) -> None:
        """Want a command sent at the end of the turn, or None.

        Raises:
            BadValueError: It must not be sent; the reaction is blind now.
        """
        if command is not None:
            try:
                check = self.channel.checked  # hot: by itself
                self.checked = check(command)
            except BadValueError as error:
                self.channel.wanted(self.registration, command)
                self.reject(error)
                raise
        self.command = command
        if not self.decided:
            self.decided = True
            self.decision.add(self)

    def commit(self, now: float) -> tuple[bool, Awaitable[object] | None]:
        """Send what was decided; return whether it left, and the rest of the work."""
        command, self.command = self.command, None
        self.decided = False
        if command is None:
            if self.active:
                self.release()
            return False, None
        if self.pending:
            renewed = self.channel.renew(self, command)
            self._outputs.conflated += renewed or self.later is not None
            self.later = None if renewed else command
            return True, None
        try:
            outcome = self.channel.begin(
                self.registration, command, None, self, self.checked, now
            )
        except EsairError as error:
            self.reject(error)
            return False, None
        if outcome is SENT or type(outcome) is Written:
            self.active = True
        elif type(outcome) is Refused:
            self._outputs.refused += 1
            self.active = True  # what a guard stops has taken the actuator
        else:
            self.active = self.pending = True
            return True, self._settle(outcome)  # type: ignore[arg-type]
        return True, None

    async def _settle(self, rest: Awaitable[Written[Any] | Refused]) -> None:
        outputs, task = self._outputs, asyncio.current_task()
        assert task is not None
        outputs.settling.add(task)
        try:
            if not await rest:
                outputs.refused += 1
        except EsairError as error:
            self.reject(error)
            self.later = None
        finally:
            outputs.settling.discard(task)
            self.pending = False
            command, self.later = self.later, None
        if command is None or outputs.runner.stopped:
            return
        if self.decided:  # in this turn, and newer
            outputs.conflated += 1
        else:
            with contextlib.suppress(BadValueError):  # by limits that are new
                self.decide(command)

    def reject(self, error: EsairError) -> None:
        """Count what cannot be sent; who wants what is bad by itself is blind."""
        outputs, runner = self._outputs, self._outputs.runner
        outputs.rejected += 1
        if outputs.rejected == 1 or outputs.rejected % 1000 == 0:
            _log.warning(
                "%s: command %d for %s was rejected: %s",
                runner.reaction.name,
                outputs.rejected,
                self.name,
                describe(error),
            )
        if isinstance(error, BadValueError):
            runner.flawed(error)

    def lost(self, winner: Registration) -> None:
        """Count a command that another one of the same turn has beaten."""
        command, self.command = self.command, None
        self.decided = False
        self._outputs.refused += 1
        self.channel.lost(self.registration, command, winner)

    def release(self) -> None:
        """Give the actuator back; what it was told times out unless somebody writes."""
        self.active = False
        self.later = None
        self.channel.release(self.registration)

    def forget(self) -> None:
        """Send nothing more of what was decided."""
        self.command = self.later = None


@attrs.define(eq=False, repr=False)
class Outputs:
    """The actuators of a running reaction, and what became of its commands."""

    runner: ReactionRunner
    all: dict[str, Output] = attrs.field(factory=dict)
    single: Output | None = None
    """The only one, if there is but one."""
    refused: int = 0
    rejected: int = 0
    """How many commands were no good, or met a device that is not there."""
    conflated: int = 0
    """How many commands were replaced by a newer one before they could leave."""
    settling: set[asyncio.Task[Any]] = attrs.field(factory=set)
    """The tasks of writes whose drivers wait."""

    def begin(self, outputs: Mapping[str, Moving]) -> None:
        """Have these actuators from now on."""
        self.all = {
            name: Output(self, name, channel, registration, channel.decision)
            for name, (channel, registration) in outputs.items()
        }
        self.single = next(iter(self.all.values())) if len(self.all) == 1 else None

    def join(self, polled: tuple[SensorChannel, ...]) -> None:
        for output in self.all.values():
            output.join(polled)

    @property
    def moved(self) -> list[tuple[Decision, float]]:
        """The decisions in which it takes part, each with its priority there."""
        outputs = self.all.values()
        return [(each.decision, each.registration.priority) for each in outputs]

    def decide(self, result: Any) -> None:
        """Want what ``react`` has returned sent, or given back.

        Raises:
            BadValueError: It must not be sent; the reaction is blind now.
        """
        single = self.single
        if single is not None and not (type(result) is dict and single.name in result):
            if result is not None or single.active:
                single.decide(result)  # its commands may be dictionaries
            return
        commands = {} if result is None else result
        if type(commands) is not dict or not commands.keys() <= self.all.keys():
            expected = ", ".join(self.all) or "nothing"
            told = f"expected a dictionary with commands for {expected}, not {result!r:.80}"
            name = self.runner.reaction.name
            self.runner.crash(BadValueError(name, "react", told))
            return
        for name, output in self.all.items():
            command = commands.get(name)
            if command is not None or output.active:
                output.decide(command)

    def forget(self) -> None:
        """Drop the commands that have not left yet."""
        for output in self.all.values():
            output.forget()

    def drop(self) -> None:
        """Give all of them back at once, for it cannot decide."""
        for output in self.all.values():
            output.forget()
            output.active = False
            output.channel.drop(output.registration)

    def stop(self) -> None:
        """Send nothing more, and have no say. What it wrote is the caller's to undo."""
        for output in self.all.values():
            output.leave()
        for task in tuple(self.settling):
            task.cancel()
