"""Who may use what, and whether a command may leave now; and the halt.

A right has a number that only grows, and is made void once: the supervisor writes the table
of them, the connections read it. `verdict` is pure: it looks at the gate of an actuator and
at its hold, and changes neither. It is asked by a write, by a write that has waited, by the
look at what stands, by operations, and by whoever wants to know why. The halt is the latch
that shuts every gate, and what it reports.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import itertools
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple, Self

import attrs

from esair.exceptions import (
    BusyError,
    DeviceLostError,
    EsairError,
    NotRegisteredError,
    StoppingError,
    in_short,
)
from esair.journal import Journal, Kind
from esair.loop import REACHED, ask_outside, clock_beside
from esair.messages import Access, Refused, ResourceState, Why
from esair.values import check_moment

if TYPE_CHECKING:
    from esair.connections._device import Device
    from esair.connections._protection import Protection


LIMIT = 65_536  # how many registrations there may be at a time


class Terms(NamedTuple):
    """Who may do what with a resource, with which priority, and for how long at a time."""

    behavior: str
    resource: str
    access: Access
    priority: int = 0
    hold: float | None = None


class Registration:
    """The right of one behavior to use one resource. Only the supervisor issues it.

    Its number only grows: a right that was revoked never comes back, and whoever
    still holds one is refused at the connection.

    Attributes:
        number: Unique in a robot, and higher than that of all before.
        behavior: The name of the behavior.
        resource: The name of the resource.
        access: What the behavior may do.
        priority: With which priority it writes; higher wins.
        hold: For how long a write holds the actuator, in seconds; None for the
            actuator's command timeout.
        terms: By which terms it was issued.
    """

    access: Access
    behavior: str
    hold: float | None
    number: int
    priority: int
    reason: Callable[[], EsairError] | None
    resource: str
    terms: Terms
    usable: bool

    __slots__ = (*Terms._fields, "number", "reason", "terms", "usable")

    def __init__(self, number: int, terms: Terms) -> None:
        write = super().__setattr__
        for name, value in zip(Terms._fields, terms, strict=True):
            write(name, value)
        write("terms", terms)
        write("number", number)
        write("usable", bool(terms.access & (Access.READ | Access.WRITE)))
        write("reason", None)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{self!r} cannot be changed: register again")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"{self!r} cannot be changed: register again")

    def end(self, reason: Callable[[], EsairError] | None) -> None:
        """Make it void; nothing makes it valid again."""
        super().__setattr__("usable", False)
        super().__setattr__("reason", reason)

    def __repr__(self) -> str:
        return (
            f"<Registration {self.number}: {self.behavior} may {self.access} "
            f"{self.resource}>"
        )


class Registrations:
    """The one table of all registrations of a robot."""

    def __init__(self, journal: Journal | None = None) -> None:
        self.journal: Journal = Journal() if journal is None else journal
        """Where the connections tell what flows."""
        self._numbers = itertools.count(1)
        self.live: dict[int, Registration] = {}  # what is valid now, by number
        self._of_resource: dict[str, dict[int, Registration]] = {}
        self.halt: Halt | None = None
        """Set while the robot is halted: no command passes, whoever asks."""

    def __len__(self) -> int:
        return len(self.live)

    def __iter__(self) -> Iterator[Registration]:
        return iter(tuple(self.live.values()))

    def issue(self, terms: Terms) -> Registration:
        """Enter a new registration; the caller has checked that it is allowed."""
        if len(self.live) >= LIMIT:
            raise BusyError("resources", "number of registrations", LIMIT)
        registration = Registration(next(self._numbers), terms)
        self.live[registration.number] = registration
        of_resource = self._of_resource.setdefault(registration.resource, {})
        of_resource[registration.number] = registration
        if self.journal.heard.registered:
            self.journal.publish(Kind.REGISTERED, *terms[:3])
        return registration

    def revoke(
        self, registration: Registration, reason: Callable[[], EsairError] | None = None
    ) -> bool:
        if self.live.get(registration.number) is not registration:
            return False
        del self.live[registration.number]
        of_resource = self._of_resource[registration.resource]
        del of_resource[registration.number]
        if not of_resource:
            del self._of_resource[registration.resource]
        registration.end(reason)
        if self.journal.heard.revoked:
            self.journal.publish(Kind.REVOKED, *registration.terms[:3])
        return True

    def find(self, terms: Terms) -> Registration | None:
        """Return the registration with exactly these terms, if there is one."""
        there = self._of_resource.get(terms.resource, {})
        return next((r for r in there.values() if r.terms == terms), None)

    def of_resource(self, resource: str) -> list[Registration]:
        return list(self._of_resource.get(resource, {}).values())

    def check(self, registration: Registration) -> None:
        """Pass if this is one of the table's own registrations, valid and for data."""
        if (
            not isinstance(registration, Registration)
            or self.live.get(registration.number) is not registration
            or not registration.usable
        ):
            raise self.refusal(registration)

    def refusal(self, registration: Registration) -> EsairError:
        """Make the error for the use of a registration that does not allow it."""
        is_live = self.live.get(getattr(registration, "number", 0)) is registration
        return refusal(registration, is_live=is_live)


def refusal(registration: object, *, is_live: bool = False) -> EsairError:
    """Make the error for the use of a registration that does not allow it."""
    if not isinstance(registration, Registration):
        told = f"{registration!r:.80} is no registration: resources.register gives one"
        return NotRegisteredError("somebody", "a resource", told)
    if registration.reason is not None:
        return registration.reason()
    detail = "its registration was revoked"
    if is_live:
        detail = f"its registration is for {registration.access} only"
    return NotRegisteredError(registration.behavior, registration.resource, detail)


def run_ended(behavior: str, resource: str = "robot") -> NotRegisteredError:
    """Make the error for what has outlived the run that it was begun in."""
    return NotRegisteredError(behavior, resource, "this run of it has ended")


HALT = "halt"  # who holds every actuator of a robot that is halted
HALT_PRIORITY = sys.maxsize  # with which priority: nobody's is higher


class Halt(NamedTuple):
    """Why and since when a robot is halted.

    Attributes:
        reason: Why, in the words of whoever halted it.
        since: Since when, on the event loop's clock (seconds).
    """

    reason: str
    since: float


class LastCommand(NamedTuple):
    """What an actuator was told last.

    Attributes:
        resource: The name of the actuator.
        command: The last command that was handed to its driver; None if there was none.
        safe: Whether that was its safe command.
        answered: Whether the driver took it without an error, and no call from before
            is alive that could undo it.
        error: Why not, in words; empty if it did.
    """

    resource: str
    command: object
    safe: bool
    answered: bool
    error: str = ""

    def __str__(self) -> str:
        answer = "answered" if self.answered else f"NOT ANSWERED ({self.error})"
        told = f"{'safe ' if self.safe else ''}{self.command!r}"
        if self.command is None:
            told = "nothing was sent"
        return f"{self.resource}: {told}: {answer}"


class Halting:
    """What each actuator is told because of a halt, and whether it answered.

    Await it in the event loop, or call `result` in a thread.
    """

    def __init__(self) -> None:
        self._outcome: concurrent.futures.Future[tuple[LastCommand, ...]] = (
            concurrent.futures.Future()
        )

    def __await__(self) -> Generator[object, None, tuple[LastCommand, ...]]:
        return asyncio.shield(asyncio.wrap_future(self._outcome)).__await__()

    def done(self) -> bool:
        """Whether every actuator has answered, or has missed its deadline."""
        return self._outcome.done()

    def result(self, timeout: float | None = None) -> tuple[LastCommand, ...]:
        """Wait in a thread; in the event loop await the object instead.

        Raises:
            TimeoutError: It took longer than *timeout* seconds.
        """
        return self._outcome.result(timeout)

    def settle(self, told: Iterable[LastCommand]) -> None:
        """Say what each actuator was told; only the first time counts."""
        if not self._outcome.done():
            self._outcome.set_result(tuple(told))


class Stopped(tuple[LastCommand, ...]):
    """After the stop: what each actuator was told last, and why the robot stopped.

    Attributes:
        reason: Why it stopped; if it was halted then, also why.
        recording: What its recording lacks, in words; empty if nothing.
    """

    reason: str
    recording: str = ""

    def __new__(cls, told: Iterable[LastCommand] = (), reason: str = "") -> Self:
        """Make a report of what each actuator was told."""
        report = super().__new__(cls, told)
        report.reason = reason
        return report

    def __repr__(self) -> str:
        return f"Stopped({super().__repr__()}, reason={self.reason!r})"


USER = "user"  # who holds an actuator that is being replaced

READY = ResourceState.READY  # hot


class BeingReplacedError(DeviceLostError):
    """The user is about to put another device in its place; no device was lost."""


@attrs.define(eq=False)
class Gate:
    """What can keep every command from one actuator, whoever holds it.

    Whatever shuts it raises one of the two numbers in the same step, so that a thread
    which is about to call the driver needs to look at those alone (`ticket`).

    """

    device: Device
    holds: tuple[Protection, ...] = ()
    """The blind holds in force, the highest first."""
    latched: bool = False
    """The robot stops: only the safe command leaves from now on."""
    halts: int = 0
    """Grows with each halt: a command from before is never sent after it."""
    fence: int = 0
    """Grows when the actuator is made safe, or is gone, or is about to go: what was begun
    before leaves no more."""
    since: float = 0.0
    """Since when it is being replaced, on the event loop's clock (seconds)."""

    @property
    def numbers(self) -> tuple[int, int]:
        """Both: what was begun under others must not leave."""
        return self.halts, self.fence

    def ticket(
        self,
        right: Registration | None,
        expires: float | None = None,
        numbers: tuple[int, int] | None = None,
    ) -> Callable[[], bool]:
        """Return what a thread asks just before it calls the driver.

        It looks at the clock itself: that of the turns stands still meanwhile. The
        numbers are those of when the command was looked at; of now if it is None.
        """
        numbers = numbers or self.numbers
        return lambda: (
            numbers == self.numbers
            and (right is None or right.usable)
            and (expires is None or clock_beside(self.device.loop)() <= expires)
        )

    @property
    def is_plain(self) -> bool:
        """Whether only a right that is void, or a holder, can be in a command's way."""
        device = self.device
        return (
            device.state is READY
            and device.error is None
            and not self.latched
            and not self.holds
            and device.registrations.halt is None
        )


@attrs.define(eq=False)
class Hold:
    """Who holds one actuator and until when, and whose will it does."""

    holder: Registration | None = None  # who wrote last; None if it was given back
    since: float = 0.0  # since when that is the holder
    before: int = 0  # the number of the right whose command stood then; 0 for nobody's
    begun: float = 0.0  # when it wrote last, or when its operation must have ended
    seconds: float = 0.0  # for how long it holds it after that
    writer: Registration | None = None  # whose command stands; None if it is nobody's
    written: float = 0.0  # when somebody has written last

    @property
    def until(self) -> float:
        """When the hold is over, on the loop's clock."""
        return self.begun + self.seconds

    def present(self, now: float) -> Registration | None:
        """Return who holds it now; None when the hold is over."""
        return self.holder if now + REACHED < self.begun + self.seconds else None

    def takes_over(self, right: Registration, now: float | None) -> bool:
        """Tell whether a write at this moment has taken over what another has moved."""
        return self.since == now and self.before not in {0, right.number}

    def keeps_away(self, right: Registration, now: float) -> bool:
        """Tell whether the holder is in the way of somebody's command."""
        holder = self.holder
        return (
            holder is not None
            and holder is not right
            and now + REACHED < self.begun + self.seconds
            and right.priority <= holder.priority
            and holder.behavior != right.behavior
        )

    def refusal(self, holder: Registration) -> Refused:
        """Make the answer for a command that the holder keeps away."""
        rule = rule_of(holder)
        return Refused(holder.behavior, holder.priority, rule, self.since, self.until)


def shut(
    gate: Gate,
    right: Registration | None,
    now: float,
    asked: int | None = None,
    *,
    operates: bool = False,
) -> Refused | EsairError | None:
    """Return what keeps every command away that somebody has a right to; or None."""
    device = gate.device
    table = device.registrations
    if right is not None and not (operates or right.usable):
        return table.refusal(right)
    if gate.latched:
        return StoppingError(device.name, "stopping")
    halt = table.halt
    if halt is None and asked is not None and asked != gate.halts:
        told = "it was asked for before the robot was halted, or its computer slept"
        halt = Halt(told, now)
    if halt is not None:
        return Refused(HALT, HALT_PRIORITY, halt.reason, halt.since, None)
    error = device.error
    if isinstance(error, BeingReplacedError):
        return Refused(USER, HALT_PRIORITY, error.detail, gate.since, None)
    if error is not None or device.state is not READY:
        return device.absence()
    return None


def lateness(device: Device, expires: float) -> float:
    """Look at the clock itself: the process may have been stopped amid this turn."""
    check_moment(device.name, "expires", expires)
    clock = clock_beside(device.loop)
    return ask_outside((device.name, "expires"), clock) - expires


def verdict(
    gate: Gate,
    hold: Hold,
    right: Registration | None,
    now: float,
    asked: int | None = None,
    *,
    operates: bool = False,
    is_still: bool = False,
) -> Refused | EsairError | None:
    """Return why a command may not leave now; None if it may.

    A refusal is false in a condition: compare what this returns with None.

    Args:
        gate: What can keep every command away.
        hold: Who holds the actuator.
        right: By which right somebody writes, or operates; None for what stands.
        now: The moment, on the loop's clock.
        asked: How many halts there were when it was asked for; as many as now if it is
            None.
        operates: It is an operation, which needs another kind of right.
        is_still: The command asks for what is safe, which no blind hold is against.
    """
    refused = shut(gate, right, now, asked, operates=operates)
    if refused is not None or right is None:
        return refused
    if not is_still:
        for each in gate.holds:
            if right.priority <= each.priority:
                return each.refusal()
    if hold.keeps_away(right, now):
        assert hold.holder is not None
        return hold.refusal(hold.holder)
    return None


def explain(
    gate: Gate,
    hold: Hold,
    now: float,
    told: object,
    *,
    is_safe: bool,
    there: Refused | None = None,
) -> Why:
    """Tell who holds an actuator, by which rule, and what would free it.

    *There* is what the robot that has it said last, if that was a refusal.
    """
    device = gate.device
    halt, error = device.registrations.halt, device.error
    holder = hold.present(now)
    blind = gate.holds[0] if gate.holds else None
    by: tuple[str, int, str, float, float | None]
    if halt is not None:
        by = HALT, HALT_PRIORITY, halt.reason, halt.since, None
        frees = "robot.resume(), by the user"
    elif isinstance(error, BeingReplacedError):
        by = USER, HALT_PRIORITY, error.detail, gate.since, None
        frees = "the device that takes its place, when it is open"
    elif error is not None or device.state is not READY:
        rule = "it is not open" if error is None else in_short(error)
        frees = "the device, when it is back"
        return Why(device.name, device.state, rule=rule, frees=frees, last=told)
    elif blind is not None and (holder is None or holder.priority <= blind.priority):
        by = blind.component, blind.priority, blind.rule, blind.since, None
        frees = f"its next decision, or a write with a priority above {blind.priority}"
    elif holder is not None and there is not None:
        by = there.holder, there.priority, there.rule, there.since, there.until
        frees = f"the robot that has it; of those here {holder.behavior} writes"
    elif holder is not None:
        by = holder.behavior, holder.priority, rule_of(holder), hold.since, hold.until
        frees = (
            f"a write with a priority above {holder.priority}, a release by "
            f"{holder.behavior}, or {hold.until - now:.3g} s without its writes"
        )
    else:
        rule = "it was told its safe command" if is_safe else "no hold is in force"
        return Why(device.name, device.state, rule=rule, last=told)
    return Why(device.name, device.state, *by)._replace(frees=frees, last=told)


def rule_of(holder: Registration) -> str:
    """Say by which rule somebody holds an actuator."""
    held_by = f"priority {holder.priority} of {holder.behavior!r}"
    return f"{held_by}, only a higher one gets through"
