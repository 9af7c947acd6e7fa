"""The journal of a robot: it numbers the events and hands them to who listens."""

from __future__ import annotations

import asyncio
import collections
import inspect
import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from esair.exceptions import ConfigError, describe
from esair.journal._event import Event, Kind
from esair.loop import clock_of

BACKLOG = 4096
"""How many events may wait for one listener; the oldest are dropped, and counted."""

SLICE = 0.001
"""How long one listener may take in one turn before its other events wait, in s."""

LAST = 0.5
"""How long one listener may take at the end before its other events are dropped, in s."""

_new = tuple.__new__
"""Makes an event without the checks of its arguments, which are here."""

_log = logging.getLogger("esair")


class Here(threading.local):
    """What this thread is at.

    Attributes:
        is_telling: Whether a listener runs: a line that it logs is told to nobody, or
            each line would be the cause of the next.
    """

    is_telling = False


here = Here()

Counted = Callable[[], Iterable[tuple[str, Mapping[str, int]]]]
"""Returns the name of each component of a group with some of its counters."""


class Listener:
    """One function that hears of events.

    Attributes:
        heard: How many events it was told.
        dropped: How many it was not told, because too many waited.
        is_waited_for: Whether the turn goes on until it has heard all: time is virtual.
    """

    __slots__ = (
        "_journal",
        "_kinds",
        "dropped",
        "function",
        "heard",
        "is_waited_for",
        "waiting",
    )

    def __init__(
        self,
        journal: Journal,
        function: Callable[[Event], object],
        kinds: frozenset[Kind] | None,
        backlog: int,
    ) -> None:
        self._journal = journal
        self._kinds = kinds
        self.function: Callable[[Event], object] = function
        self.waiting: collections.deque[Event] = collections.deque(maxlen=backlog)
        self.heard: int = 0
        self.dropped: int = 0
        self.is_waited_for: bool = False

    def take(self, event: Event) -> None:
        """Put an event into the queue; the oldest makes room."""
        if self._kinds is not None and event.kind not in self._kinds:
            return
        waiting = self.waiting
        if len(waiting) == waiting.maxlen:
            self.dropped += 1
        waiting.append(event)

    def stop(self) -> None:
        """Hear no more; what waits is forgotten."""
        self._journal.forget(self)


class Journal:
    """What happened in a robot, in one order.

    An event is made where its effect is, and handed to the listeners at the end of
    the turn, so that a listener never runs between a check and its effect. While
    nobody listens an event costs one look at `heard`.
    """

    def __init__(self) -> None:
        self.heard: bool = False
        """Whether anybody listens: who has much to tell looks here first."""
        self.number: int = 0
        """The number of the last event."""
        self._listeners: tuple[Listener, ...] = ()
        self._residents: dict[Kind, tuple[Callable[[Event], object], ...]] = {}
        self._counted: dict[str, Counted] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._time: Callable[[], float] = time.monotonic
        self._flushing = False
        self.ended_listeners: int = 0
        self.dropped: int = 0  # what those who listen no more were not told
        """How many listeners were ended because they raised."""

    # Who listens.

    def listen(
        self,
        function: Callable[[Event], object],
        *,
        kinds: Iterable[Kind] | None = None,
        backlog: int = BACKLOG,
    ) -> Listener:
        """Have a plain function called with each event, in the loop.

        One that raises is ended, with a line in the log. For one that is slow events
        wait, and the oldest are dropped when more than `backlog` do.

        Args:
            function: Called with each `Event`, at the end of the turn it happened in.
            kinds: Only these; all unless given.
            backlog: How many events may wait for it.

        Returns:
            The listener; its ``stop()`` ends it.

        Raises:
            ConfigError: It is no plain function.
        """
        if not callable(function) or inspect.iscoroutinefunction(function):
            told = f"expected a plain function, not {function!r:.80}"
            raise ConfigError("journal", "listen", told)
        wanted = None if kinds is None else frozenset(Kind(kind) for kind in kinds)
        listener = Listener(self, function, wanted, backlog)
        self._listeners = (*self._listeners, listener)
        self.heard = True
        return listener

    def forget(self, listener: Listener) -> None:
        """Tell a listener nothing more."""
        if listener in self._listeners:
            self.dropped += listener.dropped
        self._listeners = tuple(each for each in self._listeners if each != listener)
        listener.waiting.clear()
        self.heard = bool(self._listeners)

    def attach(self, kind: Kind, function: Callable[[Event], object]) -> None:
        """Have a resident of the robot act on a kind of event in the same step.

        This is how the supervisors hear of each other; what they do belongs to the
        effect itself, so it does not wait for the end of the turn.
        """
        self._residents[kind] = (*self._residents.get(kind, ()), function)

    # What happens.

    def publish(
        self,
        kind: Kind,
        component: str,
        peer: str = "",
        value: Any = None,
        text: str = "",
    ) -> None:
        """Make an event of an effect; called where the effect is, in the loop."""
        self.number += 1
        event = _new(
            Event, (self.number, self._time(), kind, component, peer, value, text)
        )
        listeners = self._listeners
        if listeners:
            for listener in listeners:
                listener.take(event)
            if not self._flushing and self._loop is not None:
                self._flushing = True
                self._loop.call_soon(self._flush)
        # Last: what they do are events too, and everybody hears the cause first.
        residents = self._residents
        if kind in residents:
            for resident in residents[kind]:
                resident(event)

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to hand over events in a loop, and to use its clock."""
        self._loop = loop
        self._time = clock_of(loop)
        self._flushing = True
        loop.call_soon(self._flush)

    def close(self) -> None:
        """Hand over what waits: the robot has stopped, and ends in time."""
        for listener in self._listeners:
            self._tell(listener, LAST)
            listener.dropped += len(listener.waiting)
            listener.waiting.clear()
        self._loop = None

    def _flush(self) -> None:
        self._flushing = False
        loop = self._loop
        if loop is None:
            return
        for listener in self._listeners:
            self._tell(listener, SLICE)
        if any(listener.waiting for listener in self._listeners) and not self._flushing:
            self._flushing = True
            loop.call_soon(self._flush)

    def _tell(self, listener: Listener, seconds: float) -> None:
        waiting, function = listener.waiting, listener.function
        end = time.perf_counter() + seconds
        failed: BaseException | None = None
        here.is_telling = True
        try:
            while waiting:
                event = waiting.popleft()
                listener.heard += 1
                function(event)
                if time.perf_counter() >= end and not listener.is_waited_for:
                    break
        except (Exception, asyncio.CancelledError) as error:  # it is somebody else's
            failed = error
        finally:
            here.is_telling = False
        if failed is not None:
            self.forget(listener)
            self.ended_listeners += 1
            _log.error(
                "journal: a listener raised at event %d (%s) and is ended: %s",
                event.number,
                event.kind,
                describe(failed),
                exc_info=failed,
            )

    # Counters.

    def count(self, group: str, counted: Counted) -> None:
        """Have the counters of a group of components read by `counts`.

        Args:
            group: A name for the group, such as ``"sensors"``.
            counted: Returns the name of each component with its counters.
        """
        self._counted[group] = counted

    def counts(self) -> dict[str, dict[str, int]]:
        """Return every counter of every bound, by component.

        The journal's own are under ``"journal"``: ``events``, ``dropped``, and how
        many listeners were ``ended``.
        """
        sums: dict[str, collections.Counter[str]] = {}
        for counted in self._counted.values():
            for component, counters in counted():
                sums.setdefault(component, collections.Counter()).update(counters)
        found = {component: dict(each) for component, each in sums.items()}
        found["journal"] = {
            "events": self.number,
            "dropped": self.dropped + sum(each.dropped for each in self._listeners),
            "ended": self.ended_listeners,
        }
        return found
