"""How a reaction runs: fed by sensors, stepped by the scheduler, writing actuators.

A step is three things in a row: what it sees (`Senses`), ``react``, and what it decides
(`Outputs`). While it cannot see, or its own command is bad, it is parked.
"""

from __future__ import annotations

import asyncio
import inspect
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import attrs

from esair.actions._flow import Input, Moving, Outputs, Sampling, Senses, Sensing
from esair.actions._reaction import MinimalReaction, Reaction, StepClock
from esair.connections import (
    BLIND,
    ActuatorChannel,
    Decision,
    Protection,
    SensorChannel,
    Sight,
)
from esair.exceptions import BadValueError, BehaviorFailedError, EsairError
from esair.loop import (
    Job,
    Order,
    Owner,
    Scheduler,
    Step,
    Stepping,
    ask_outside,
    clock_beside,
    clock_of,
    ignore,
)

_log = logging.getLogger("esair")


@attrs.frozen(kw_only=True)
class Hooks:
    """What is told of a reaction that runs.

    Attributes:
        state: Told with True that it runs, with False that it is parked, and why.
        crash: Told what the reaction raised; it has been stopped.
        sight: Told that it has decided for the first time since it was blind, before
            what it has decided leaves.
        end: Told that ``until`` came true.
        until: Ends the reaction; asked after each step.
    """

    state: Callable[[bool, str], None] = ignore
    crash: Callable[[BaseException], None] = ignore
    sight: Callable[[], None] = ignore
    end: Callable[[], None] = ignore
    until: Callable[..., bool] | None = None


class ReactionRunner:
    """Runs one reaction until it is stopped.

    Args:
        reaction: What to run.
        hooks: What is told of it.
        began: When the robot has started, in seconds of the loop's clock.
        owner: Whose random numbers it draws.
    """

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_hooks",
        "_late",
        "_react",
        "_sampling",
        "_stepping",
        "_until",
        "blind",
        "clock",
        "flaw",
        "job",
        "outputs",
        "owner",
        "parked",
        "reaction",
        "scheduler",
        "senses",
        "step_time",
        "stopped",
        "time",
    )

    input_type: ClassVar[type[Input]] = Input  # what each of its sensors feeds

    order: ClassVar[Order] = Order.STALE
    """When it is told that a reading is too old, or gone: others hear of it then, too."""

    def __init__(
        self,
        reaction: Reaction,
        hooks: Hooks,
        *,
        began: float,
        owner: Owner | None,
    ) -> None:
        self.reaction: Reaction = reaction
        self.owner: Owner | None = owner
        self._hooks = hooks
        told = reaction.reaction if isinstance(reaction, MinimalReaction) else None
        self.clock: StepClock = StepClock(began, told)
        loop = asyncio.get_running_loop()
        self.time: Callable[[], float] = clock_of(loop)
        budget = reaction.budget
        if budget is None and loop.get_debug():
            budget = loop.slow_callback_duration
        self.step_time: StepTime | None = None  # only who has a budget pays for it
        if budget is not None:
            self.step_time = StepTime(reaction, loop, budget)
        self.scheduler: Scheduler = Scheduler.of(loop)
        self._stepping = Stepping.of(loop)
        names, react = ordered(reaction)
        self._react: Callable[..., Any] = self.clock.telling(react)
        self.senses: Senses = Senses(
            self, reaction.inputs, names, self.order, reaction.rate
        )
        self.outputs: Outputs = Outputs(self)
        self.job: Job = self.scheduler.on_demand(self._turn, name=reaction.name)
        self._sampling: Sampling | None = None
        """How its steps wait for their samples, if it has a rate."""
        self._late = 0
        self._until = None if hooks.until is None else by_name(hooks.until, reaction)
        self.parked: bool = True
        self.blind: bool = True  # whether it has not decided since it could not
        self.flaw: BadValueError | None = None
        """Why it is parked, if that is what it has decided itself."""
        self.stopped: bool = False
        reaction.take_clock(self.clock)

    def counts(self) -> dict[str, int]:
        senses, outputs, timed = self.senses, self.outputs, self.step_time
        return {
            "steps": senses.steps,
            "late": self._late + self.job.skipped,
            "refused": outputs.refused,
            "rejected": outputs.rejected,
            "conflated": outputs.conflated,
            "skipped": senses.skipped,
            "overflow": senses.overflow,
            "overruns": 0 if timed is None else timed.overruns,
        }

    def start(
        self, inputs: Mapping[str, Sensing], outputs: Mapping[str, Moving]
    ) -> None:
        senses = self.senses
        senses.begin(inputs)
        self.outputs.begin(outputs)
        self.resample()
        senses.follow(self.time())
        if senses.missing == 0 and self.parked:
            self.unpark()
            if senses.on_reading:  # with optional ones alone none may ever come
                self.job.soon()
        elif self.parked:
            waits = ", ".join(each.name for each in senses.lacking())
            self._hooks.state(False, f"no reading of {waits} yet")

    @property
    def moved(self) -> list[tuple[Decision, float]]:
        """The decisions in which it takes part, each with its priority there."""
        return self.outputs.moved

    def resample(self) -> None:
        """Go by the sensors that are asked now: a source may be another one."""
        if self.stopped or not self.senses.resample():
            return
        polled = self.senses.polled or ()
        self._join(polled)
        if self.reaction.rate is not None:
            self._take_rate(self.reaction.rate, polled)

    def _join(self, polled: tuple[SensorChannel, ...]) -> None:
        self.outputs.join(polled)

    def _take_rate(self, rate: float, polled: tuple[SensorChannel, ...]) -> None:
        """Step on the grid, at the moments at which the sensors are asked."""
        name, scheduler = self.reaction.name, self.scheduler
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
        senses, outputs = self.senses, self.outputs
        near = [self, self.clock, self._react, self.reaction]
        near += [senses, senses.values, outputs]
        for each in outputs.all.values():
            near += (each, each.registration, each.channel, each.decision)
        return tuple(near)

    def stop(self) -> None:
        """Never step again, and follow nothing. What it wrote is the caller's to undo."""
        if self.stopped:
            return
        self.stopped, self.clock.runs = True, False
        self.job.stop()
        if self._sampling is not None:
            self._sampling.stop()
        self.senses.stop()
        self.outputs.stop()

    # Parking.

    def absence(self) -> EsairError | None:
        """Make the error for what blinds it: a reading that it needs, or its command."""
        return self.senses.absence(self.time()) or self.flaw

    def park(self, reason: str) -> None:
        """Be blind and give the actuators back, until the sensors are back."""
        if self.stopped or (self.parked and self.flaw is None):
            return
        self.flaw = None
        self.parked = self.blind = True
        if self.senses.waiting:
            self.senses.waiting.clear()
        self.outputs.drop()
        self._hooks.state(False, reason)

    def flawed(self, error: BadValueError) -> None:
        """Be blind until its next good decision: nothing of this one is sent."""
        self.outputs.forget()
        if self.flaw is None:
            self.park(f"its command is bad: {error}")
        self.flaw = error

    def unpark(self) -> None:
        self.flaw = None
        self.parked = False
        self._hooks.state(True, "")

    # Steps.

    @property
    def _turn(self) -> Step:
        """What the scheduler calls: chosen once, so that no step has to ask."""
        if self.step_time is not None:
            return self._timed_step
        return self._step if self.senses.waiting is None else self._step_on_each

    def _timed_step(self, now: float) -> None:
        assert self.step_time is not None
        begin = self.step_time.begin()
        self._step_on_each(now)
        failed = self.step_time.end(begin)
        if failed is not None and not self.stopped:
            self.crash(failed)

    def _step_on_each(self, now: float) -> None:
        senses = self.senses
        while senses.see(now) and not self.stopped:
            if senses.waiting:
                place, value = senses.waiting.popleft()
                senses.values[place] = value
            self._step(now)
            if not senses.waiting:
                break

    def _step(self, now: float) -> None:
        senses = self.senses
        if (senses.missing or now >= senses.stale_at) and not senses.see(now):
            return
        senses.steps += 1
        clock = self.clock  # hot: of `StepClock.step` what is needed here
        clock.before = clock.now
        clock.now = now
        stepping = self._stepping
        stepping.runner = self
        react = self._react  # hot: by itself
        try:
            values = senses.values
            result = react(values[0]) if senses.is_alone else react(*values)
        except BaseException as error:  # contained: one component's failure
            self.crash(error)
            return
        finally:
            stepping.runner = None
        if self._until is not None and self._is_over():
            return
        output = self.outputs.single
        try:
            if result is None and output is not None:
                if output.active:
                    output.decide(None)
            elif output is None or type(result) is dict:
                self.outputs.decide(result)
            else:
                output.decide(result)
        except BadValueError:  # told, and blind
            return
        except BaseException as error:  # contained: what it returns is of any class
            self.crash(error)
            return
        if self.blind and not self.stopped:
            if self.flaw is not None:
                self.unpark()
            self.blind = False
            self._hooks.sight()

    def _is_over(self) -> bool:
        assert self._until is not None
        stepping = self._stepping
        stepping.runner, before = self, stepping.runner
        try:
            over = self._until(self.senses.by_name())
        except BaseException as error:  # contained: one component's failure
            self.crash(error)
            return True
        finally:
            stepping.runner = before
        if over:
            self.stop()
            self._hooks.end()
        return bool(over)

    def crash(self, error: BaseException) -> None:
        self.stop()
        self._hooks.crash(error)


class GuardRunner(ReactionRunner):
    """Runs one guard until it is stopped.

    Its ``react`` is called at the commit point of the actuator, for each command, and
    from there again when a sensor has a new reading, or at its rate: then the command
    that was asked for last is put to it.
    """

    order = Order.DARK

    __slots__ = ("_channel", "_port", "_protection", "_sight")

    def __init__(
        self,
        reaction: Reaction,
        port: str,
        protection: Protection,
        hooks: Hooks,
        **options: Any,
    ) -> None:
        super().__init__(reaction, hooks, **options)
        self._port = port
        self._protection = protection
        self._channel: ActuatorChannel | None = None
        self._sight: Sight | None = None

    def guard(self, channel: ActuatorChannel, inputs: Mapping[str, Sensing]) -> None:
        """Begin to follow the sensors, and to judge the commands of an actuator."""
        self._channel = channel
        protection = self._protection
        protection.judge = self._judge
        protection.fallback = self._fallback
        protection.on_crash = self._crashed
        self.start(inputs, {})

    def _join(self, polled: tuple[SensorChannel, ...]) -> None:
        for decision, priority in self.moved:
            decision.leave(self._sight)
            self._sight = Sight(priority, polled)
            decision.join(self._sight)

    @property
    def moved(self) -> list[tuple[Decision, float]]:
        """All guards of the actuator look together."""
        return [] if self._channel is None else [(self._channel.decision, math.inf)]

    def stop(self) -> None:
        """Judge no command any more: while its entry is in the table none passes."""
        super().stop()
        if self._channel is not None:
            self._channel.decision.leave(self._sight)
        if self._protection.judge == self._judge:
            self._protection.judge = None

    @property
    def _turn(self) -> Step:
        return self._step if self.senses.waiting is None else self._step_on_each

    def unpark(self) -> None:
        super().unpark()
        self.blind = False
        self._hooks.sight()

    def _step(self, now: float) -> None:
        if not self.senses.see(now) or (self._until is not None and self._is_over()):
            return
        if self._channel is None:
            return
        if self.senses.waiting:  # another reading waits, so this one has its own look
            self._channel.review()
        else:
            self._channel.decision.look()

    def _judge(self, command: Any) -> Any:
        began, senses = self.time(), self.senses
        if senses.missing or began >= senses.stale_at:
            if senses.is_blind(began):
                self.job.soon()  # it is parked in a step of its own
                return BLIND
            senses.see(began)
        senses.steps += 1
        timed = self.step_time
        first = timed.begin() if timed is not None else 0.0
        self.clock.step(began)
        stepping = self._stepping
        stepping.runner, before = self, stepping.runner
        try:
            passed = self.reaction.react(**senses.by_name(), **{self._port: command})
        finally:
            stepping.runner = before
        if timed is None:
            return passed
        failed = timed.end(first)
        if failed is not None:
            raise failed
        return BLIND if timed.in_row else passed

    def _fallback(self, command: Any) -> Any:
        return self.reaction.blind(**{self._port: command})

    def _crashed(self, error: BaseException) -> None:
        if not self.stopped:
            self.crash(error)


class StepTime:
    """Counts the steps that take longer than their budget."""

    def __init__(
        self, reaction: Reaction, loop: asyncio.AbstractEventLoop, budget: float
    ) -> None:
        self._reaction = reaction
        self._budget = budget
        self._clock = clock_beside(loop)
        self.overruns: int = 0  # how many have taken longer,
        self.in_row: int = 0  # and how many of them the last ones

    def begin(self) -> float:
        return self._clock()

    def end(self, begin: float) -> BehaviorFailedError | None:
        """Count a step that took too long; return an error if there were too many."""
        reaction = self._reaction
        # When the run was recorded, it is what the step took then.
        took = ask_outside((reaction.name, "took"), lambda: self._clock() - begin)
        if took <= self._budget:
            self.in_row = 0
            return None
        self.overruns += 1
        self.in_row += 1
        text = f"step took {took:.3g} s, its budget is {self._budget:g} s"
        if self.overruns == 1 or self.overruns % 1000 == 0:
            _log.warning("%s: overrun %d: %s", reaction.name, self.overruns, text)
        limit = reaction.overrun_limit
        if limit is None or self.in_row <= limit:
            return None
        row = f"overrun {self.in_row} in a row: {text}"
        return BehaviorFailedError(reaction.name, row)


# What its functions get: the readings, by the names of their parameters.


def by_name(
    until: Callable[..., bool], reaction: Reaction
) -> Callable[[Mapping[str, Any]], bool]:
    """Adapt a condition that names the readings it wants."""
    if not callable(until) or inspect.iscoroutinefunction(until):
        told = f"expected a function without async, not {until!r:.80}"
        raise BadValueError(reaction.name, "until", told)
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


def ordered(reaction: Reaction) -> tuple[tuple[str, ...], Callable[..., Any]]:
    """Return the names of the readings, and ``react`` as it takes them in that order.

    By place is three times as quick as by name, where its parameters are known.
    """
    inputs, react = tuple(reaction.inputs), reaction.react
    code = getattr(getattr(react, "__func__", None), "__code__", None)
    if code is not None:
        parameters = code.co_varnames[1 : code.co_argcount]
        if sorted(parameters) == sorted(inputs):
            return parameters, react
    return inputs, lambda *values: react(**dict(zip(inputs, values, strict=True)))
