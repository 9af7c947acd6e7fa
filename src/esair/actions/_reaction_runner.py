"""How a reaction runs: fed by sensors, stepped by the scheduler, writing actuators."""

from __future__ import annotations

import asyncio
import collections
import functools
import inspect
import logging
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from esair.actions._from_minimal import MinimalReaction
from esair.actions._reaction import EVERY_LIMIT, Reaction
from esair.actions._reaction_ports import FOR_EVER, Input, Output
from esair.actions._step_clock import StepClock
from esair.connections import ActuatorChannel, Registration, SensorChannel
from esair.exceptions import (
    BadValueError,
    BehaviorFailedError,
    EsairError,
    StaleReadingError,
    describe,
)
from esair.loop import (
    Job,
    OneShot,
    Order,
    Owner,
    Scheduler,
    Step,
    clock_of,
    stepping,
)
from esair.messages import Refused, Written

_log = logging.getLogger("esair")


def _ignore() -> None:
    """Tell nobody."""


class ReactionRunner:
    """Runs one reaction until it is stopped.

    Args:
        reaction: What to run.
        on_state: Called with True when it runs and False when it is parked, and
            the reason.
        on_crash: Called with what the reaction raised; it has been stopped.
        until: Ends the reaction; asked after each step.
        on_end: Called when ``until`` came true.
        on_sight: Called when it has decided for the first time since it was blind,
            before what it has decided leaves.
        began: When the robot has started, in seconds of the loop's clock.
        owner: Whose random numbers it draws.
    """

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_awaits",
        "_budget",
        "_clock",
        "_deferred",
        "_inputs",
        "_loop",
        "_on_crash",
        "_on_end",
        "_on_sight",
        "_on_state",
        "_outputs",
        "_overruns_in_row",
        "_owner",
        "_patience",
        "_polled",
        "_react",
        "_sampled_in",
        "_scheduler",
        "_settling",
        "_single",
        "_stopped",
        "_time",
        "_until",
        "_watch",
        "blind",
        "conflated",
        "every",
        "job",
        "missing",
        "on_reading",
        "overflow",
        "overruns",
        "parked",
        "reaction",
        "refused",
        "rejected",
        "skipped",
        "stale_at",
        "steps",
        "values",
    )

    def __init__(
        self,
        reaction: Reaction,
        *,
        on_state: Callable[[bool, str], None],
        on_crash: Callable[[BaseException], None],
        until: Callable[..., bool] | None = None,
        on_end: Callable[[], None] | None = None,
        on_sight: Callable[[], None] = _ignore,
        began: float = 0.0,
        owner: Owner | None = None,
    ) -> None:
        self.reaction = reaction
        self._owner = owner
        decides = (
            reaction.reaction if isinstance(reaction, MinimalReaction) else reaction
        )
        self._clock = StepClock(decides, began)
        self.every: collections.deque[tuple[str, Any]] | None = None
        """The readings that wait for a step each, of ports with ``every=True``."""
        self.overflow = 0
        """How many of those were dropped because too many waited."""
        self.skipped = 0
        """How many readings were replaced by a newer one before a step."""
        self.blind = True
        """Whether it has not decided since it could not."""
        self._on_sight = on_sight
        self.on_reading = reaction.rate is None
        self.values: dict[str, Any] = {}
        self.missing = 0
        """How many sensors have no reading that may be used."""
        self.steps = 0
        self.refused = 0
        self.rejected = 0
        """How many commands were no good, or met a device that is not there."""
        self.conflated = 0
        """How many commands were replaced by a newer one before they could leave."""
        self.stale_at = FOR_EVER
        self.parked = True
        self._loop = asyncio.get_running_loop()
        self._time = clock_of(self._loop)
        self._budget = reaction.budget
        if self._budget is None and self._loop.get_debug():
            self._budget = self._loop.slow_callback_duration
        self.overruns = 0
        """How many steps have taken longer than their budget."""
        self._overruns_in_row = 0
        self._scheduler = Scheduler.of(self._loop)
        self.job: Job = self._scheduler.on_demand(self._turn, name=reaction.name)
        self._polled: tuple[SensorChannel, ...] = ()
        """What it samples: the sensors that are asked, if it has a rate."""
        self._deferred: Job | None = None
        """The step that waits for its samples."""
        self._awaits = 0
        """For how many samples it waits,"""
        self._sampled_in = 0
        """and of which turn they are; 0 if it waits for none."""
        self._patience: OneShot | None = None
        self._react = reaction.react
        self._inputs: list[Input] = []
        self._outputs: dict[str, Output] = {}
        self._single: Output | None = None
        self._on_state = on_state
        self._on_crash = on_crash
        self._until = _by_name(until, reaction) if until is not None else None
        self._on_end = on_end
        self._watch: asyncio.TimerHandle | None = None
        self._stopped = False
        self._settling: set[asyncio.Task[Any]] = set()
        """The tasks of writes whose drivers wait."""

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "steps": self.steps,
            "late": self.late,
            "refused": self.refused,
            "rejected": self.rejected,
            "conflated": self.conflated,
            "skipped": self.skipped,
            "overflow": self.overflow,
            "overruns": self.overruns,
        }

    @property
    def late(self) -> int:
        """How many steps were left out because they came too late."""
        return self.job.skipped

    def start(
        self,
        inputs: Mapping[str, tuple[SensorChannel, Registration, float | None]],
        outputs: Mapping[str, tuple[ActuatorChannel, Registration]],
    ) -> None:
        """Begin to follow the sensors and to run.

        Args:
            inputs: For each reading its channel, registration, and greatest age.
            outputs: For each command its channel and registration.
        """
        optional = {k for k, need in self.reaction.inputs.items() if need.optional}
        every = {k for k, need in self.reaction.inputs.items() if need.every}
        self._inputs = [
            Input(self, name, *terms, optional=name in optional, every=name in every)
            for name, terms in inputs.items()
        ]
        if every:
            self.every = collections.deque()
        self.values.update(dict.fromkeys(optional))
        self._outputs = {
            name: Output(self, name, *terms) for name, terms in outputs.items()
        }
        if len(self._outputs) == 1:
            (self._single,) = self._outputs.values()
        self.missing = sum(not each.optional for each in self._inputs)
        if self.reaction.rate is not None:
            self._take_rate(self.reaction.rate)
        for each in self._inputs:
            each.channel.follow(each)
            newest = each.channel.newest
            if newest is not None and self._time() - newest.time <= each.limit:
                each.feed(newest)
        if self.missing == 0 and self.parked:
            self._unpark()
        elif self.parked:
            waits = ", ".join(
                each.name for each in self._inputs if not (each.ready or each.optional)
            )
            self._on_state(False, f"no reading of {waits} yet")

    def _take_rate(self, rate: float) -> None:
        """Step on the grid, at the moments at which the sensors are asked."""
        channels = [each.channel for each in self._inputs]
        self._polled = tuple(each for each in channels if each.sensor.can_be_asked)
        name, scheduler = self.reaction.name, self._scheduler
        step = self._turn
        if self._polled:
            self._deferred = scheduler.on_demand(step, name=name)
            step = self._sample
        names = [each.name for each in self._polled] or [name]
        phase = max(map(scheduler.phase, names))
        self.job = scheduler.every(1.0 / rate, step, name=name, phase=phase)

    def stop(self) -> None:
        """Never step again, and follow nothing. What it wrote is the caller's to undo."""
        self._stopped = True
        self.job.stop()
        if self._deferred is not None:
            self._deferred.stop()
        self._lose_patience()
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        for each in self._inputs:
            each.channel.unfollow(each)
        for output in self._outputs.values():
            output.forget()
        for task in tuple(self._settling):
            task.cancel()

    # Parking.

    def absence(self) -> EsairError | None:
        """Make the error for a reading that it needs and does not have."""
        for each in self._inputs:
            if not (each.ready or each.optional):
                channel = each.channel
                if channel.error is not None:
                    return channel.error.with_traceback(None)
                newest = channel.newest
                age = None if newest is None else self._time() - newest.time
                return StaleReadingError(channel.name, age, each.limit)
        return None

    def arrived(self) -> None:
        """A sensor has a reading again."""
        self.missing -= 1
        if self.missing == 0:
            self._unpark()

    def refresh(self) -> None:
        """Compute anew when the first reading becomes stale."""
        inputs = self._inputs
        if len(inputs) == 1:
            self.stale_at = inputs[0].stale_at
        else:
            self.stale_at = min(each.stale_at for each in inputs)
        if self._watch is None and self.on_reading:
            self._watch = self._loop.call_at(self.stale_at, self._look)

    def park(self, reason: str, *, missing: int = 0) -> None:
        """Stop deciding and give the actuators back, until the sensors are back."""
        self.missing += missing
        if self.parked or self._stopped:
            return
        self.parked = self.blind = True
        if self.every:
            self.every.clear()
        for output in self._outputs.values():
            output.forget()
            output.active = False
            output.channel.drop(output.registration)
        self._on_state(False, reason)

    def _unpark(self) -> None:
        self.parked = False
        self._on_state(True, "")

    def _look(self) -> None:
        """Park a reaction that nothing steps because no reading comes any more."""
        self._watch = None
        now = self._time()
        if self.stale_at == FOR_EVER:
            return  # it is parked; the next reading begins anew
        if now < self.stale_at:
            self._watch = self._loop.call_at(self.stale_at, self._look)
        else:
            self._stale(now)

    def _stale(self, now: float) -> None:
        for each in self._inputs:
            if each.ready and now >= each.stale_at:
                each.lose(f"{each.name} is older than {each.limit:g} s")
        self.forget()

    def forget(self) -> None:
        """Compute anew when the first reading becomes stale, after one is gone."""
        self.stale_at = min((each.stale_at for each in self._inputs), default=FOR_EVER)

    # Steps.

    @property
    def _turn(self) -> Step:
        """What the scheduler calls; only who has a budget pays for the clock."""
        return self._step if self._budget is None else self._timed_step

    def _sample(self, now: float) -> Awaitable[object] | None:
        """Step when the polls of this instant are answered, half a period late at most."""
        # One look for all: a thousand sensors that answer at once are not touched.
        if self._scheduler.polled_in == self._scheduler.turns:
            for channel in self._polled:
                if channel.awaited_in and self._wait_for_samples(now):
                    return None
        assert self._deferred is not None
        return self._deferred.function(now)

    def _wait_for_samples(self, now: float) -> bool:
        assert self.reaction.rate is not None
        half, turn = 0.5 / self.reaction.rate, self._scheduler.turns
        awaited = [
            each
            for each in self._polled
            if each.awaited_in == turn and each.latency <= half
        ]
        if not awaited:
            return False
        self._awaits = len(awaited)
        self._sampled_in = turn
        for each in awaited:
            each.when_answered(functools.partial(self._answered, turn))
        self._lose_patience()
        self._patience = self._scheduler.at(
            now + half, self._wait_no_longer, order=Order.EXPIRY
        )
        return True

    def _answered(self, turn: int) -> None:
        """A sample has come; step when all have."""
        if turn == self._sampled_in:
            self._awaits -= 1
            if self._awaits == 0:
                self._wait_no_longer(0.0)

    def _wait_no_longer(self, _now: float) -> None:
        self._sampled_in = 0
        self._lose_patience()
        if self._deferred is not None:
            self._deferred.soon()

    def _lose_patience(self) -> None:
        if self._patience is not None:
            self._scheduler.cancel(self._patience)
            self._patience = None

    def _timed_step(self, now: float) -> Awaitable[object] | None:
        begin = self._time()
        rest = self._step(now)
        failed = self.overran(self._time() - begin)
        if failed is not None and not self._stopped:
            self._crash(failed)
        return rest

    def overran(self, took: float) -> BehaviorFailedError | None:
        """Count a step that took too long; return an error if there were too many."""
        assert self._budget is not None
        if took <= self._budget:
            self._overruns_in_row = 0
            return None
        self.overruns += 1
        self._overruns_in_row += 1
        reaction = self.reaction
        text = f"step took {took:.3g} s, its budget is {self._budget:g} s"
        if self.overruns == 1 or self.overruns % 1000 == 0:
            _log.warning("%s: overrun %d: %s", reaction.name, self.overruns, text)
        limit = reaction.overrun_limit
        if limit is None or self._overruns_in_row <= limit:
            return None
        row = f"overrun {self._overruns_in_row} in a row: {text}"
        return BehaviorFailedError(reaction.name, row)

    def _step(self, now: float) -> Awaitable[object] | None:
        if self.missing:
            return None
        if now >= self.stale_at:
            self._stale(now)
            return None
        if self.every is None:
            self._decide(now)
            return None
        while not (self.missing or self._stopped):
            if self.every:
                name, value = self.every.popleft()
                self.values[name] = value
            self._decide(now)
            if not self.every:
                break
        return None

    def _decide(self, now: float) -> None:
        """Make one step on the values that there are now."""
        self.steps += 1
        self._clock.step(now)
        stepping.owner = self._owner
        try:
            result = self._react(**self.values)
        except BaseException as error:  # contained: one component's failure
            self._crash(error)
            return
        finally:
            stepping.owner = None
        if self._until is not None and self._is_over():
            return
        if self.blind:
            self.blind = False
            self._on_sight()
        output = self._single
        if output is None or result.__class__ is dict:
            self._decide_all(result)
        elif result is not None or output.active:
            output.decide(result)

    def queue(self, name: str, value: Any) -> None:
        """Keep a reading for a step of its own."""
        waiting = self.every
        if waiting is None:
            return
        if len(waiting) >= EVERY_LIMIT:
            waiting.popleft()
            self.overflow += 1
        waiting.append((name, value))

    def _is_over(self) -> bool:
        assert self._until is not None
        assert self._on_end is not None
        try:
            over = self._until(self.values)
        except BaseException as error:  # contained: one component's failure
            self._crash(error)
            return True
        if over:
            self.stop()
            self._on_end()
        return bool(over)

    def _crash(self, error: BaseException) -> None:
        self.stop()
        self._on_crash(error)

    def _decide_all(self, result: Any) -> None:
        single = self._single
        if single is not None and single.name not in result:
            single.decide(result)  # its commands are dictionaries
            return
        commands = {} if result is None else result
        if type(commands) is not dict or not commands.keys() <= self._outputs.keys():
            expected = ", ".join(self._outputs) or "nothing"
            self._crash(
                BadValueError(
                    self.reaction.name,
                    "react",
                    f"expected a dictionary with commands for {expected}, not {result!r:.80}",
                )
            )
            return
        for name, output in self._outputs.items():
            command = commands.get(name)
            if command is not None or output.active:
                output.decide(command)

    def forget_waiting(self) -> None:
        """Drop the commands that have not left yet: the robot is halted."""
        for output in self._outputs.values():
            output.forget()

    def write(
        self, output: Output, command: Any
    ) -> tuple[bool, Awaitable[object] | None]:
        """Send a command; return whether it was looked at, and the rest of the work."""
        if output.pending:
            if output.later is not None:
                self.conflated += 1
            output.later = command
            return True, None
        try:
            outcome = output.channel.begin(output.registration, command, None)
        except EsairError as error:
            self._reject(output, error)
            return False, None
        kind = type(outcome)
        if kind is Written:
            output.active = True
        elif kind is Refused:
            self.refused += 1
        else:
            output.active = True
            output.pending = True
            return True, self._settle(output, outcome)  # type: ignore[arg-type]
        return True, None

    async def _settle(
        self, output: Output, rest: Awaitable[Written[Any] | Refused]
    ) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._settling.add(task)
        try:
            if not await rest:
                self.refused += 1
        except EsairError as error:
            self._reject(output, error)
            output.later = None
        finally:
            self._settling.discard(task)
            output.pending = False
            command, output.later = output.later, None
        if command is None or self._stopped:
            return
        if output.decided:  # in this turn, and newer
            self.conflated += 1
        else:
            output.decide(command)

    def _reject(self, output: Output, error: EsairError) -> None:
        self.rejected += 1
        if self.rejected == 1 or self.rejected % 1000 == 0:
            _log.warning(
                "%s: command %d for %s was rejected: %s",
                self.reaction.name,
                self.rejected,
                output.name,
                describe(error),
            )


def _by_name(
    until: Callable[..., bool], reaction: Reaction
) -> Callable[[Mapping[str, Any]], bool]:
    """Adapt a condition that names the readings it wants."""
    if not callable(until):
        raise BadValueError(
            reaction.name, "until", f"expected a function, not {until!r:.80}"
        )
    parameters = inspect.signature(until).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return lambda values: until(**values)
    wanted = [
        p.name
        for p in parameters
        if p.default is p.empty and p.kind is not p.VAR_POSITIONAL
    ]
    unknown = [name for name in wanted if name not in reaction.inputs]
    if unknown:
        raise BadValueError(
            reaction.name,
            "until",
            f"its parameters must be readings ({', '.join(reaction.inputs)}), "
            f"not {', '.join(unknown)}",
        )
    return lambda values: until(**{name: values[name] for name in wanted})
