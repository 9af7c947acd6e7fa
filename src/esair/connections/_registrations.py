"""Who may use what. The supervisor writes this table, the connections read it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import NamedTuple

from esair.connections._gate import Halt
from esair.exceptions import BusyError, EsairError, NotRegisteredError
from esair.journal import Journal, Kind
from esair.messages import Access

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
        if not isinstance(registration, Registration):
            return NotRegisteredError(
                "?", "?", f"{registration!r:.80} is no registration"
            )
        if registration.reason is not None:
            return registration.reason()
        detail = "its registration was revoked"
        if self.live.get(registration.number) is registration:
            detail = f"its registration is for {registration.access} only"
        return NotRegisteredError(registration.behavior, registration.resource, detail)


def run_ended(behavior: str, resource: str = "robot") -> NotRegisteredError:
    """Make the error for what has outlived the run that it was begun in."""
    return NotRegisteredError(behavior, resource, "this run of it has ended")
