"""The journal of a robot: it numbers the events and hands them to who listens."""

from __future__ import annotations

import asyncio
import collections
import enum
import functools
import inspect
import logging
import math
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from esair.exceptions import ConfigError, describe, hint_for
from esair.loop import clock_of


class Kind(enum.StrEnum):
    """What happened; beside each, what ``component``, ``peer`` and ``value`` are."""

    READING = "reading"
    """A sensor has given a value: the sensor, nobody, the `Reading`."""
    COMMAND = "command"
    """A command was asked for: the actuator, who asked, the command."""
    REFUSED = "refused"
    """It was refused: the actuator, who asked, the `Refused`."""
    SENT = "sent"
    """It left for the device: the actuator, who asked, the command as it left."""
    APPLIED = "applied"
    """The device took it: the actuator, who asked, what was applied."""
    SAFE = "safe"
    """The device was told its safe command: the actuator, nobody, the command."""
    UNANSWERED = "unanswered"
    """A command or a safe command met an error: the actuator, nobody, the command."""
    PUT = "put"
    """Data was delivered by a put: the receiver, the sender, the data."""
    GOT = "got"
    """Data was delivered by a get: the receiver, the giver, the data."""
    ASKED = "asked"
    """A request was made: who is asked, the asker, the request."""
    ANSWERED = "answered"
    """A request has its outcome: who was asked, the asker, the answer or error."""
    REGISTERED = "registered"
    """A right was given: the behavior, the resource, the `Access`."""
    REVOKED = "revoked"
    """A right was taken: the behavior, the resource, the `Access`."""
    CONFIGURED = "configured"
    """Settings were applied: the resource, who asked, the settings."""
    OPERATED = "operated"
    """An operation of a resource has ended: the resource, who asked, its result."""
    ADDED = "added"
    """A component became part of the robot: its name, "resource" or "behavior"."""
    REMOVED = "removed"
    """A component is no part of the robot any more: its name, as `ADDED`."""
    UP = "up"
    """A device is ready: its name."""
    DOWN = "down"
    """A device is not there: its name, nobody, the error."""
    RUNNING = "running"
    """A behavior or reaction runs: its name."""
    PARKED = "parked"
    """A component waits for what is not there: its name."""
    CRASHED = "crashed"
    """A component raised: its name, nobody, the error."""
    RESTARTED = "restarted"
    """A component begins anew after a crash: its name."""
    FAILED = "failed"
    """A component is given up: its name, nobody, the error."""
    FINISHED = "finished"
    """A behavior has come to its own end: its name."""
    MODE = "mode"
    """The robot goes to a mode: its name, nobody, the mode before; why is the text."""
    HALTED = "halted"
    """The robot was halted: who did it; the reason is the text."""
    RESUMED = "resumed"
    """The user has ended all halts."""
    OPERATOR = "operator"
    """An operator did something: what it was done to, who, the act."""
    LOG = "log"
    """A line of esair's log: the logger; the line is the text."""

    @classmethod
    def _missing_(cls, value: object) -> Kind:
        told = f"there is no kind {value!r:.80}{hint_for(str(value), map(str, cls))}"
        raise ConfigError("journal", "kinds", told)


class Event(NamedTuple):
    """One effect. It is never changed.

    Attributes:
        number: 1 for the first event of a robot, then one more each time; where one
            is missing, a listener was too slow for it.
        time: When, in seconds of the event loop's clock.
        kind: What happened.
        component: The name of the component it happened to.
        peer: The name of the other one, if there is one.
        value: What it is about, as `Kind` tells; as it was handed over, never copied.
        text: Why, in words for people, where there is more to say.
    """

    number: int
    time: float
    kind: Kind
    component: str
    peer: str = ""
    value: Any = None
    text: str = ""


BACKLOG = 4096
"""How many events may wait for one listener; the oldest are dropped, and counted."""

SLICE = 0.001
"""How long one listener may take in one turn before its other events wait, in s."""

LAST = 0.5
"""How long one listener may take at the end before its other events are dropped, in s."""

_event = functools.partial(tuple.__new__, Event)
"""Makes an event of its fields without the checks of its arguments, which are here."""

_clock = time.perf_counter

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


class Heard:
    """Whether anybody listens to a kind of which there is much: each by its value.

    What tells of them looks here first; it is one object for the life of its journal.
    """

    __slots__ = (
        "answered",
        "applied",
        "asked",
        "command",
        "got",
        "log",
        "put",
        "reading",
        "refused",
        "registered",
        "revoked",
        "safe",
        "sent",
        "unanswered",
    )

    if TYPE_CHECKING:

        def __getattr__(self, kind: str) -> bool: ...

    def __init__(self) -> None:
        self.are(())

    def are(self, kinds: Collection[Kind]) -> None:
        """Have these heard from now on, and no others."""
        for kind in self.__slots__:
            setattr(self, kind, kind in kinds)


class Listener:
    """One function that hears of events.

    Attributes:
        given: How many events were for it.
        dropped: How many it was not told, because too many waited.
        is_waited_for: Whether the turn goes on until it has heard all: time is virtual.
    """

    __slots__ = (
        "_journal",
        "dropped",
        "function",
        "given",
        "is_waited_for",
        "kinds",
        "waiting",
    )

    def __init__(
        self,
        journal: Journal,
        function: Callable[[Event], object],
        kinds: frozenset[Kind],
        backlog: int,
    ) -> None:
        self._journal = journal
        self.kinds: frozenset[Kind] = kinds
        self.function: Callable[[Event], object] = function
        self.waiting: collections.deque[Event] = collections.deque(maxlen=backlog)
        self.given: int = 0
        self.dropped: int = 0
        self.is_waited_for: bool = False

    @property
    def heard(self) -> int:
        """How many events it was told."""
        return self.given - self.dropped - len(self.waiting)

    def take(self, events: list[Event]) -> None:
        """Put events into the queue; the oldest make room."""
        if len(self.kinds) < len(Kind):
            events = [event for event in events if event.kind in self.kinds]
        waiting = self.waiting
        room = (waiting.maxlen or 0) - len(waiting)
        self.given += len(events)
        self.dropped += max(0, len(events) - room)
        waiting.extend(events)

    def stop(self) -> None:
        """Hear no more; what waits is forgotten."""
        self._journal.forget(self)


class Journal:
    """What happened in a robot, in one order.

    An event is made where its effect is, and handed to the listeners at the end of
    the turn, so that a listener never runs between a check and its effect. An event
    of a kind that nobody listens to costs one look at `heard`.
    """

    def __init__(self) -> None:
        self.heard: Heard = Heard()
        """To which kinds anybody listens: what has much to tell looks here first."""
        self.number: int = 0
        """The number of the last event."""
        self._listeners: tuple[Listener, ...] = ()
        self._made: list[tuple[Any, ...]] = []
        self._keep = self._made.append  # hot: bound once
        """The events of this turn that listeners were not given yet."""
        self._residents: dict[Kind, tuple[Callable[[Event], object], ...]] = {}
        self._counted: dict[str, Counted] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._time: Callable[[], float] = time.monotonic
        self._flushing = False
        self._flush_at = 0  # from this number on it does not wait for a flush
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
            ConfigError: It is no plain function, or a kind is none.
        """
        if not callable(function) or inspect.iscoroutinefunction(function):
            told = f"expected a plain function, not {function!r:.80}"
            raise ConfigError("journal", "listen", told)
        wanted = frozenset(Kind if kinds is None else map(Kind, kinds))
        listener = Listener(self, function, wanted, backlog)
        self._are_told(*self._listeners, listener)
        return listener

    def _are_told(self, *listeners: Listener) -> None:
        self._give()  # what was before is not for one that comes
        self._listeners = listeners
        self.heard.are(frozenset[Kind]().union(*(each.kinds for each in listeners)))

    def forget(self, listener: Listener) -> None:
        """Tell a listener nothing more."""
        self._give()
        if listener in self._listeners:
            self.dropped += listener.dropped
        listener.given -= len(listener.waiting)
        self._are_told(*(each for each in self._listeners if each != listener))
        listener.waiting.clear()

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
        self.number = number = self.number + 1
        made = (number, self._time(), kind, component, peer, value, text)
        if self._listeners:
            self._keep(made)
            if number >= self._flush_at:
                self._flush_soon()
        # Last: what they do are events too, and everybody hears the cause first.
        if kind in self._residents:
            for resident in self._residents[kind]:
                resident(_event(made))

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to hand over events in a loop, and to use its clock."""
        self._loop = loop
        self._time = clock_of(loop)
        self._flushing = True
        loop.call_soon(self._flush)

    def close(self) -> None:
        """Hand over what waits: the robot has stopped, and ends in time."""
        for listener in self._listeners:
            end = _clock() + LAST
            self._give()
            while listener.waiting and (_clock() < end or listener.is_waited_for):
                self._tell(listener, end - _clock())
                self._give()
            listener.dropped += len(listener.waiting)
            listener.waiting.clear()
        self._loop = None

    def _give(self) -> None:
        """Give each listener what was made since the last time."""
        if self._made:
            events = list(map(_event, self._made))
            self._made.clear()
            for listener in self._listeners:
                listener.take(events)

    def _flush_soon(self) -> None:
        if self._flushing or self._loop is None:
            self._give()  # too many for one turn
        else:
            self._flushing = True
            self._loop.call_soon(self._flush)
        self._flush_at = self.number + BACKLOG

    def _flush(self) -> None:
        self._flushing, self._flush_at = False, 0
        if self._loop is None:
            return
        self._give()
        for listener in self._listeners:
            self._tell(listener, SLICE)
        if any(listener.waiting for listener in self._listeners):
            self._flush_soon()

    def _tell(self, listener: Listener, seconds: float) -> None:
        waiting, function, clock = listener.waiting, listener.function, _clock
        take = waiting.popleft
        end = math.inf if listener.is_waited_for else clock() + seconds
        failed: BaseException | None = None
        here.is_telling = True
        try:
            while waiting:
                event = take()
                function(event)
                if clock() >= end:
                    break
        except KeyboardInterrupt:
            raise  # it is the user's, wherever it comes
        except BaseException as error:  # somebody else's: sys.exit() in it ends nobody
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
        self._give()
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
