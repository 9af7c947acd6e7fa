"""How a reaction runs: fed by sensors, stepped by the scheduler, writing actuators."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from esair.actions._by_name import by_name, ordered
from esair.actions._from_minimal import MinimalReaction
from esair.actions._reaction import EVERY_LIMIT, Reaction
from esair.actions._reaction_ports import FOR_EVER, Input, Output
from esair.actions._sampling import Sampling, polled_for
from esair.actions._step_clock import StepClock
from esair.actions._step_time import step_time
from esair.connections import ActuatorChannel, Decision, Registration, SensorChannel
from esair.exceptions import BadValueError, EsairError, StaleReadingError
from esair.loop import (
    Job,
    OneShot,
    Order,
    Owner,
    Scheduler,
    Step,
    Stepping,
    clock_of,
    ignore,
)

_EARLY = 1e-6  # timers may fire a hair early

_QUICK = 100.0
"""From this rate on, in Hz, the next step finds soon enough that a reading is too old."""


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
        "_clock",
        "_inputs",
        "_is_alone",
        "_late",
        "_loop",
        "_names",
        "_on_crash",
        "_on_end",
        "_on_sight",
        "_on_state",
        "_outputs",
        "_polled",
        "_react",
        "_sampling",
        "_scheduler",
        "_single",
        "_step_time",
        "_stepping",
        "_time",
        "_until",
        "_watch",
        "_watch_at",
        "_watches",
        "blind",
        "conflated",
        "every",
        "flaw",
        "job",
        "missing",
        "on_reading",
        "overflow",
        "owner",
        "parked",
        "reaction",
        "refused",
        "rejected",
        "settling",
        "skipped",
        "stale_at",
        "steps",
        "stopped",
        "values",
    )

    input_type: ClassVar[type[Input]] = Input  # what each of its sensors feeds

    grace: ClassVar[float] = 1e-5
    """Seconds that a reading may be older than its limit: timers are a hair early."""

    def __init__(
        self,
        reaction: Reaction,
        *,
        on_state: Callable[[bool, str], None],
        on_crash: Callable[[BaseException], None],
        until: Callable[..., bool] | None = None,
        on_end: Callable[[], None] | None = None,
        on_sight: Callable[[], None] = ignore,
        began: float = 0.0,
        owner: Owner | None = None,
    ) -> None:
        self.reaction = reaction
        self.owner = owner
        told = reaction.reaction if isinstance(reaction, MinimalReaction) else None
        self._clock = StepClock(began, told)
        reaction.take_clock(self._clock)
        self.every: collections.deque[tuple[int, Any]] | None = None
        """The readings that wait for a step each, of ports with ``every=True``."""
        if any(need.every for need in reaction.inputs.values()):
            self.every = collections.deque()
        self.overflow = 0  # how many of those were dropped because too many waited
        self.skipped = 0  # how many readings were replaced by a newer one before a step
        self.blind = True  # whether it has not decided since it could not
        self.flaw: BadValueError | None = None
        """Why it is parked, if that is what it has decided itself."""
        self._on_sight = on_sight
        self.on_reading = reaction.rate is None
        self._watches = reaction.rate is None or reaction.rate < _QUICK
        self._names, self._react = ordered(reaction)
        self.values: list[Any] = [None] * len(self._names)
        """The newest readings, in the order of the names."""
        self.missing = 0  # how many sensors have no reading that may be used
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
        self._step_time = step_time(reaction, self._loop)
        self._scheduler = Scheduler.of(self._loop)
        self._stepping = Stepping.of(self._loop)
        self.job: Job = self._scheduler.on_demand(self._turn, name=reaction.name)
        self._sampling: Sampling | None = None
        """How its steps wait for their samples, if it has a rate."""
        self._polled: tuple[SensorChannel, ...] | None = None
        self._late = 0
        self._inputs: list[Input] = []
        self._outputs: dict[str, Output] = {}
        self._single: Output | None = None
        self._on_state = on_state
        self._on_crash = on_crash
        self._until = by_name(until, reaction) if until is not None else None
        self._on_end = on_end
        self._watch: OneShot | None = None
        self._watch_at = FOR_EVER
        self.stopped = False
        self.settling: set[asyncio.Task[Any]] = set()
        """The tasks of writes whose drivers wait."""

    def counts(self) -> dict[str, int]:
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
    def overruns(self) -> int:
        """How many steps have taken longer than their budget."""
        return 0 if self._step_time is None else self._step_time.overruns

    @property
    def late(self) -> int:
        """How many steps were left out because they came too late."""
        return self._late + self.job.skipped

    def start(
        self,
        inputs: Mapping[str, tuple[SensorChannel, Registration, float | None]],
        outputs: Mapping[str, tuple[ActuatorChannel, Registration]],
    ) -> None:
        needs, place = self.reaction.inputs, self._names.index
        self._inputs = [
            self.input_type(
                *(self, name, place(name), *terms),
                optional=needs[name].optional,
                every=needs[name].every,
            )
            for name, terms in inputs.items()
        ]
        self._is_alone = len(needs) == 1
        self._outputs = {
            name: Output(self, name, *terms) for name, terms in outputs.items()
        }
        if len(self._outputs) == 1:
            (self._single,) = self._outputs.values()
        self.missing = sum(not each.optional for each in self._inputs)
        self.resample()
        for each in self._inputs:
            each.channel.follow(each)
            newest = each.channel.newest
            if newest is not None and self._time() - newest.time <= each.limit:
                each.feed(newest)
        if self.missing == 0 and self.parked:
            self._unpark()
            if self.on_reading:  # with optional ones alone none may ever come
                self.job.soon()
        elif self.parked:
            waits = ", ".join(
                each.name for each in self._inputs if not (each.ready or each.optional)
            )
            self._on_state(False, f"no reading of {waits} yet")

    @property
    def moved(self) -> list[tuple[Decision, float]]:
        """The decisions in which it takes part, each with its priority there."""
        outputs = self._outputs.values()
        return [(each.decision, each.registration.priority) for each in outputs]

    def resample(self) -> None:
        """Go by the sensors that are asked now: a source may be another one."""
        polled = polled_for(self._inputs)
        if polled == self._polled or self.stopped:
            return
        self._polled = polled
        self._join(polled)
        if self.reaction.rate is not None:
            self._take_rate(self.reaction.rate, polled)

    def _join(self, polled: tuple[SensorChannel, ...]) -> None:
        for output in self._outputs.values():
            output.join(polled)

    def _take_rate(self, rate: float, polled: tuple[SensorChannel, ...]) -> None:
        """Step on the grid, at the moments at which the sensors are asked."""
        name, scheduler = self.reaction.name, self._scheduler
        self._late += self.job.skipped
        self.job.stop()
        if self._sampling is not None:
            self._sampling.stop()
        names = [each.name for each in polled] or [name]
        phase = max(map(scheduler.phase, names))
        self.job = scheduler.every(1.0 / rate, self._turn, name=name, phase=phase)
        self.job.near = self._near()
        moved = self.moved
        self._sampling = Sampling(scheduler, polled, moved, self._turn, name, rate)
        self.job.waits = self._sampling.waits

    def _near(self) -> tuple[object, ...]:
        near = [self, self._clock, self._react, self.reaction, self.values]
        for each in self._outputs.values():
            near += (each, each.registration, each.channel, each.decision)
        return tuple(near)

    def stop(self) -> None:
        """Never step again, and follow nothing. What it wrote is the caller's to undo."""
        self.stopped = True
        self.job.stop()
        if self._sampling is not None:
            self._sampling.stop()
        if self._watch is not None:
            self._scheduler.cancel(self._watch)
            self._watch = None
        for each in self._inputs:
            each.channel.unfollow(each)
        for output in self._outputs.values():
            output.leave()
        for task in tuple(self.settling):
            task.cancel()

    # Parking.

    def absence(self) -> EsairError | None:
        """Make the error for what blinds it: a reading that it needs, or its command."""
        for each in self._inputs:
            if not (each.ready or each.optional):
                channel = each.channel
                if channel.error is not None:
                    return channel.error.with_traceback(None)
                newest = channel.newest
                age = None if newest is None else self._time() - newest.time
                return StaleReadingError(channel.name, age, each.limit)
        return self.flaw

    def arrived(self) -> None:
        self.missing -= 1
        if self.missing == 0:
            self._unpark()

    def refresh(self, fed: Input) -> None:
        """Compute anew when the first reading becomes stale."""
        if self._is_alone:
            self.stale_at = fed.stale_at
        else:
            self.stale_at = min(each.stale_at for each in self._inputs)
        if self.stale_at < self._watch_at and self._watches:
            self._watch_for_age()

    def park(self, reason: str, *, missing: int = 0) -> None:
        """Be blind and give the actuators back, until the sensors are back."""
        self.missing += missing
        if self.stopped or (self.parked and self.flaw is None):
            return
        self.flaw = None
        self.parked = self.blind = True
        if self.every:
            self.every.clear()
        for output in self._outputs.values():
            output.forget()
            output.active = False
            output.channel.drop(output.registration)
        self._on_state(False, reason)

    def flawed(self, error: BadValueError) -> None:
        """Be blind until its next good decision: nothing of this one is sent."""
        for output in self._outputs.values():
            output.forget()
        if self.flaw is None:
            self.park(f"its command is bad: {error}")
        self.flaw = error

    def _unpark(self) -> None:
        self.flaw = None
        self.parked = False
        self._on_state(True, "")

    def _look(self, now: float) -> None:
        """Park a reaction that nothing steps before a reading is too old."""
        self._watch, self._watch_at = None, FOR_EVER
        if self.stale_at == FOR_EVER:
            return  # it is parked; the next reading begins anew
        if now + _EARLY < self.stale_at:
            self._watch_for_age()
        else:
            self._stale(max(now, self.stale_at))

    def _watch_for_age(self) -> None:
        """Look when the first reading becomes stale: earlier than was thought, maybe."""
        if self._watch is not None:
            self._scheduler.cancel(self._watch)
        self._watch_at = self.stale_at
        self._watch = self._scheduler.at(self.stale_at, self._look, order=Order.STALE)

    def _stale(self, now: float) -> None:
        for each in self._inputs:
            if each.ready and now >= each.stale_at:
                each.lose(f"{each.name} is older than {each.limit:g} s")
        self.forget()

    def forget(self) -> None:
        """Compute anew when the first reading becomes stale, after one is gone."""
        self.stale_at = min((each.stale_at for each in self._inputs), default=FOR_EVER)
        if self.stale_at < self._watch_at and self._watches and not self.stopped:
            self._watch_for_age()

    # Steps.

    @property
    def _turn(self) -> Step:
        """What the scheduler calls: chosen once, so that no step has to ask."""
        if self._step_time is not None:
            return self._timed_step
        return self._step if self.every is None else self._step_on_each

    def _timed_step(self, now: float) -> None:
        assert self._step_time is not None
        begin = self._step_time.begin()
        if self.every is None:
            self._step(now)
        else:
            self._step_on_each(now)
        failed = self._step_time.end(begin)
        if failed is not None and not self.stopped:
            self._crash(failed)

    def _step_on_each(self, now: float) -> None:
        assert self.every is not None
        while self._sees(now) and not self.stopped:
            if self.every:
                place, value = self.every.popleft()
                self.values[place] = value
            self._step(now)
            if not self.every:
                break

    def _sees(self, now: float) -> bool:
        """Tell whether it can decide; one with a reading that is too old is parked."""
        if self.missing:
            return False
        if now >= self.stale_at:
            self._stale(now)
            return False
        return True

    def _step(self, now: float) -> None:
        if self.missing or now >= self.stale_at:
            self._sees(now)
            return
        self.steps += 1
        clock = self._clock  # `StepClock.step` in its place: each step comes here
        clock.before = clock.now
        clock.now = now
        if clock.reaction is not None:
            clock.tell()
        stepping = self._stepping
        stepping.stepper = self
        react = self._react  # by itself: see the scheduler
        try:
            values = self.values
            result = react(values[0]) if self._is_alone else react(*values)
        except BaseException as error:  # contained: one component's failure
            self._crash(error)
            return
        finally:
            stepping.stepper = None
        if self._until is not None and self._is_over():
            return
        output = self._single
        try:
            if output is None:
                self._decide_all(result)
            elif result is None:
                if output.active:
                    output.decide(None)
            elif type(result) is dict:
                self._decide_all(result)
            else:
                output.decide(result)
        except BadValueError:  # told, and blind
            return
        if self.blind and not self.stopped:
            if self.flaw is not None:
                self._unpark()
            self.blind = False
            self._on_sight()

    def readings(self) -> dict[str, Any]:
        return dict(zip(self._names, self.values, strict=True))

    def queue(self, place: int, value: Any) -> None:
        """Keep a reading for a step of its own."""
        waiting = self.every
        if waiting is None:
            return
        if len(waiting) >= EVERY_LIMIT:
            waiting.popleft()
            self.overflow += 1
        waiting.append((place, value))

    def _is_over(self) -> bool:
        assert self._until is not None
        assert self._on_end is not None
        try:
            over = self._until(self.readings())
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
            told = f"expected a dictionary with commands for {expected}, not {result!r:.80}"
            self._crash(BadValueError(self.reaction.name, "react", told))
            return
        for name, output in self._outputs.items():
            command = commands.get(name)
            if command is not None or output.active:
                output.decide(command)

    def forget_waiting(self) -> None:
        """Drop the commands that have not left yet: the robot is halted."""
        for output in self._outputs.values():
            output.forget()
