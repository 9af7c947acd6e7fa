"""Sensors that are computed of the readings of others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

import attrs

from esair.actions._flow import Input
from esair.actions._needs import Reads, attributes_of
from esair.actions._reaction import Reaction
from esair.actions._reaction_runner import Hooks, ReactionRunner
from esair.connections import Computation, DerivedChannel, Source
from esair.exceptions import DeviceLostError, EsairError
from esair.loop import NEVER, Owner, raisable
from esair.messages import ResourceState, Stamped
from esair.resources import Sensor

T = TypeVar("T")


class Derived(Sensor[T]):
    """A sensor that is computed of the readings of other sensors.

    It is declared like a reaction and read like any sensor, by reactions and behaviors
    alike. A value is computed on each new reading of its sources, in the turn in which
    that came in and before anybody decides. It is as old as the oldest reading that it
    was computed of, and too old when the first of them is. While a source is lost it
    is lost as well.

    Args:
        reads: Sensors to read besides, or instead of, those of the class.
        **options: What `Sensor` takes: a name, settings.

    Example:
        >>> class Odometry(esair.Derived[Pose]):
        ...     left = esair.reads(float, name="left_encoder")
        ...     right = esair.reads(float, name="right_encoder")
        ...
        ...     def compute(self, left: float, right: float) -> Pose | None: ...
    """

    is_computed: ClassVar[bool] = True

    budget: float | None = None
    """How long one computation may take, in seconds; None if there is no limit.

    A longer one is counted, and logged.
    """

    now_ms: int = 0
    """The moment of this computation, in whole milliseconds since the robot started."""

    elapsed_ms: int = 0
    """Milliseconds since the computation before; 0 at the first after an opening."""

    _declared: ClassVar[Mapping[str, Reads[Any]]] = {}
    _given: Mapping[str, Reads[Any]] = {}

    def __init__(
        self, *, reads: Mapping[str, Reads[Any]] | None = None, **options: Any
    ) -> None:
        super().__init__(**options)
        self.set_reads(reads or {})

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls._declared = {
            name: value
            for name, value in attributes_of(cls).items()
            if isinstance(value, Reads)
        }

    @property
    def inputs(self) -> dict[str, Reads[Any]]:
        """What it is computed of, by the name of its port."""
        return {**self._declared, **self._given}

    def set_reads(self, reads: Mapping[str, Reads[Any]]) -> None:
        """Read these besides, or instead of, those of the class; before its robot starts."""
        self._given = {
            attribute: attrs.evolve(need, attribute=attribute)
            for attribute, need in reads.items()
        }

    def compute(self, *args: Any, **readings: Any) -> T | Stamped[T] | None:
        """Compute a value of the newest readings, which come by the names of their ports.

        Returns:
            The value; an `esair.Stamped` one if it is of another time than the oldest
            of the readings; or None if there is nothing new to say.
        """
        raise NotImplementedError

    def open(self) -> None:
        """Begin anew: its sources are there, at the start and again after a loss.

        Meanwhile they may have missed something: here what was summed up is put back,
        or marked as doubtful.
        """


class _Tap(Input):
    """One source of a derived sensor."""

    __slots__ = ()

    def changed(self, error: EsairError | None) -> None:
        """Learn that the source is gone for now (why), or back (None)."""
        super().changed(error)
        there = self.channel.state is ResourceState.READY and self.registration.usable
        runner = self.runner
        if self.channel.state is ResourceState.CLOSED:
            return  # the robot has stopped
        if not self.optional and isinstance(runner, Derivation):
            if not there:
                runner.on_change(self.absence())
            elif error is None:
                runner.on_change(None)

    def absence(self) -> DeviceLostError:
        """Make the error of what is computed of a source that is not there."""
        runner, source = self.runner, self.channel
        named = (
            self.name if self.name == source.name else f"{self.name} ({source.name})"
        )
        why = source.error or source.state.value
        if not self.registration.usable:
            why = source.registrations.refusal(self.registration)
        told = f"its source {named}: {why}"
        if isinstance(why, DeviceLostError):
            told = f"its source {named} is lost: {why.detail}"
        lost = DeviceLostError(runner.reaction.name, told)
        if isinstance(why, EsairError):
            lost.__cause__ = why.with_traceback(None)
        return lost


class Derivation(ReactionRunner):
    """Computes one derived sensor until it is stopped."""

    __slots__ = ("_channel", "_derived", "_is_current", "on_change")

    input_type = _Tap

    def __init__(
        self,
        derived: Derived[Any],
        channel: DerivedChannel,
        on_change: Callable[[DeviceLostError | None], None],
        *,
        began: float,
        owner: Owner | None,
    ) -> None:
        computing = Reaction(name=derived.name, reads=derived.inputs)
        computing.budget = derived.budget
        computing.react = derived.compute  # type: ignore[method-assign]
        super().__init__(computing, Hooks(), began=began, owner=owner)
        self._derived = derived
        self._channel = channel
        self._is_current = False
        """Whether the newest reading is of the newest readings of the sources."""
        self.on_change: Callable[[DeviceLostError | None], None] = on_change

    def follow(self, sources: Mapping[str, Source]) -> None:
        """Begin to follow the sources; nothing is computed before `begin`."""
        computation = Computation(tuple(sources.values()), self._catch_up)
        self._channel.computed_by(computation)
        self.job = self.scheduler.derived(
            self._turn, name=self._derived.name, depth=self._channel.depth
        )
        self.start({name: each[:3] for name, each in sources.items()}, {})

    def stop(self) -> None:
        super().stop()
        self._channel.computation = Computation()

    def begin(self) -> None:
        for each in self.senses.inputs:
            ready = each.channel.state is ResourceState.READY
            if not each.optional and not (ready and each.registration.usable):
                assert isinstance(each, _Tap)
                raise each.absence()
        self.clock.begin_anew(self._derived)
        try:
            self._derived.open()
        except BaseException as error:  # contained: it would end who opens it
            raise raisable(error, self._derived.name) from error.__cause__
        if not self.senses.missing:
            self.job.soon()

    def _catch_up(self) -> bool:
        if self.job.queued:
            self.job.queued = False
            self.job.function(self.time())
        return self._is_current

    def _step(self, now: float) -> None:
        """Compute a value of the readings that there are now."""
        channel, senses = self._channel, self.senses
        if not senses.see(now) or channel.state is not ResourceState.READY:
            return
        senses.steps += 1
        self._is_current = False
        self.clock.step(now)
        stepping = self._stepping
        stepping.runner = self
        try:
            value = self.reaction.react(**senses.by_name())
        except BaseException as error:  # contained: one component's failure
            channel.fail(error)
            return
        finally:
            stepping.runner = None
        if value is None:
            return
        needed = [each for each in senses.inputs if not each.optional]
        known = [each.channel.newest for each in needed or senses.inputs]
        oldest = min((each.time for each in known if each is not None), default=now)
        stale_at = min((each.stale_at for each in needed), default=NEVER)
        self._is_current = channel.publish_until(value, oldest, stale_at)
