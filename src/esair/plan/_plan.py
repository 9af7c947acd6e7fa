"""A robot as the rulebook sees it, and what is said about it: one sentence for each finding."""

from __future__ import annotations

import contextlib
import enum
import functools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs

from esair.actions import Behavior, Derived, Need, Reaction, Writes
from esair.connections import Applied
from esair.exceptions import ConfigError, EsairError
from esair.messages import NO_MODES, BehaviorsPolicy, Modes, Policy
from esair.resources import APPLIED, Actuator, Resource

if TYPE_CHECKING:
    from esair.buses import Bus

Port = tuple[str, Behavior | Reaction, str, Need]
"""The name of an action, the action, the name of its port, and what that is for."""


@attrs.frozen(kw_only=True, eq=False, slots=False)
class Plan:
    """What a robot is made of: from a script, from a file, or of one that runs.

    Anything may stand in the lists of parts: what does not belong there is found.
    Its tables are made of them when they are asked for. The plan of a robot that runs
    begins with empty lists, and lives as long as the robot: what comes and goes changes
    its own entries in the tables, and nothing else.

    Attributes:
        name: The name of the robot.
        resources: The sensors and actuators.
        behaviors: The behaviors and reactions.
        policies: Who may do what with a resource.
        modes: Who runs when.
        buses: Buses by name, if they have places of their own, as in a file.
        missing: Parts that were named and could not be made, for reasons that were
            told already: their names, and the kind of each (``sensor``, ``actuator``,
            ``behavior``).
        implied: Names of resources that come with another part: nobody has to use them.
        watchdog: Whether a second process makes safe what this one cannot.
        writers: In a robot that runs, tells who is registered to write an actuator;
            None if whoever declares it will be.
    """

    name: str = "robot"
    resources: Sequence[Any] = ()
    behaviors: Sequence[Any] = ()
    policies: Sequence[Any] = ()
    modes: Modes = NO_MODES
    buses: Mapping[str, Bus] = attrs.field(factory=dict)
    missing: Mapping[str, str] = attrs.field(factory=dict)
    implied: Collection[str] = ()
    watchdog: bool = False
    writers: Callable[[str], Sequence[str]] | None = None

    @functools.cached_property
    def resource_of(self) -> dict[str, Resource]:
        """The sound resources by name; the first one, if several have one name."""
        found: dict[str, Resource] = {}
        for each in self.resources:
            if isinstance(each, Resource) and (name := name_of(each)):
                found.setdefault(name, each)
        return found

    @functools.cached_property
    def derived_of(self) -> dict[str, Derived[Any]]:
        """The sensors that are computed of others, by name."""
        found = self.resource_of.items()
        return {name: each for name, each in found if isinstance(each, Derived)}

    def provided(self, need: Need) -> Resource | None:
        """Return what a port is for: a resource, or the last command of an actuator."""
        found = self.resource_of.get(need.resource)
        if found is None and need.provider != need.resource:
            actuator = self.resource_of.get(need.provider)
            if isinstance(actuator, Actuator):
                return Applied(actuator)
        return found

    @functools.cached_property
    def action_of(self) -> dict[str, Behavior | Reaction]:
        """The behaviors and reactions by name; the first one, if several have it."""
        found: dict[str, Behavior | Reaction] = {}
        for each in self.behaviors:
            if isinstance(each, Behavior | Reaction) and (name := name_of(each)):
                found.setdefault(name, each)
        return found

    @functools.cached_property
    def policy_of(self) -> dict[str, Policy]:
        """The policies by the name of their resource; the last one counts."""
        return {each.resource: each for each in self.policies if type(each) is Policy}

    @functools.cached_property
    def resource_names(self) -> dict[str, None]:
        """The names of all resources, also of those that could not be made."""
        missing = [name for name, kind in self.missing.items() if kind != "behavior"]
        return dict.fromkeys([*self.resource_of, *missing])

    @functools.cached_property
    def action_names(self) -> dict[str, None]:
        """The names of all actions, also of those that could not be made."""
        missing = [name for name, kind in self.missing.items() if kind == "behavior"]
        return dict.fromkeys([*self.action_of, *missing])

    def needs(self) -> Iterator[Port]:
        """Yield each port of each action."""
        for name, action in self.action_of.items():
            for attribute, need in action.needs.items():
                yield name, action, attribute, need

    @functools.cached_property
    def needs_of(self) -> dict[str, dict[tuple[str, str], Port]]:
        """The ports by the name of what they are for."""
        found: dict[str, dict[tuple[str, str], Port]] = {}
        for port in self.needs():
            found.setdefault(port[-1].resource, {})[port[0], port[2]] = port
        return found

    @functools.cached_property
    def claims(self) -> dict[tuple[int, str], str]:
        """Who has something of a bus for itself alone: the first one, if several do."""
        found: dict[tuple[int, str], str] = {}
        for name, each in self.resource_of.items():
            if each.claim is not None:
                found.setdefault((id(each.bus), each.claim), name)
        return found

    def users_of(self, resource: str) -> dict[str, None]:
        """Return the names of the actions that use a resource, or its last command."""
        return {
            user: None
            for part in (resource, resource + APPLIED)
            for user, _ in self.needs_of.get(part, ())
        }

    def writes_of(self, resource: str) -> dict[str, Writes[Any]]:
        """Return who writes an actuator, by name: the port of the highest priority."""
        found: dict[str, Writes[Any]] = {}
        for name, _, _, need in self.needs_of.get(resource, {}).values():
            # A priority that is none is a mistake that is told.
            if isinstance(need, Writes) and type(need.priority) is int:
                known = found.get(name)
                if known is None or need.priority > known.priority:
                    found[name] = need
        return found

    # Of a robot that runs.

    def enter_resource(self, resource: Resource) -> None:
        """Take a resource in, or put it in the place of the one that has its name."""
        name = resource.name
        self._unclaim(self.resource_of.get(name))
        self.resource_of[name] = resource
        self.resource_names[name] = None
        if isinstance(resource, Derived):
            self.derived_of[name] = resource
        if resource.claim is not None:
            self.claims.setdefault((id(resource.bus), resource.claim), name)

    def leave_resource(self, name: str) -> None:
        self._unclaim(self.resource_of.pop(name))
        del self.resource_names[name]

    def _unclaim(self, resource: Resource | None) -> None:
        if resource is None:
            return
        if isinstance(resource, Derived):
            self.derived_of.pop(resource.name, None)
        claimed = resource.claim and (id(resource.bus), resource.claim)
        if claimed and self.claims.get(claimed) == resource.name:
            del self.claims[claimed]

    def enter_action(self, action: Behavior | Reaction) -> None:
        """Take an action in, or put it in the place of the one that has its name."""
        name = action.name
        if name in self.action_of:
            self._unlist(self.action_of[name])
        self.action_of[name] = action
        self.action_names[name] = None
        for attribute, need in action.needs.items():
            port = name, action, attribute, need
            self.needs_of.setdefault(need.resource, {})[name, attribute] = port

    def leave_action(self, name: str) -> None:
        self._unlist(self.action_of.pop(name))
        del self.action_names[name]

    def _unlist(self, action: Behavior | Reaction) -> None:
        for attribute, need in action.needs.items():
            ports = self.needs_of[need.resource]
            del ports[action.name, attribute]
            if not ports:
                del self.needs_of[need.resource]

    @contextlib.contextmanager
    def as_if(self, resource: object, instead_of: Resource | None) -> Iterator[None]:
        """Have a resource in the table of names while it is examined."""
        name = name_of(resource) or ""
        before = self.resource_of.get(name)
        if not isinstance(resource, Resource) or not name or before is not instead_of:
            yield  # it is no resource, or the name is taken
            return
        self.resource_of[name] = resource
        self.resource_names[name] = None
        try:
            yield
        finally:
            if before is not None:
                self.resource_of[name] = before
            else:
                del self.resource_of[name], self.resource_names[name]


def name_of(component: object) -> str | None:
    """Return the name of a component; None if it has none that is good."""
    try:
        name = component.name  # type: ignore[attr-defined]
    except (EsairError, AttributeError):
        return None
    return name if isinstance(name, str) else None


class Severity(enum.Enum):
    """How bad a finding is."""

    ERROR = "error"
    """The robot does not start."""
    WARNING = "warning"
    """The robot starts, and may not do what was meant."""


@attrs.frozen
class Finding:
    """One thing that the rulebook says about a robot.

    Attributes:
        severity: How bad it is.
        rule: Which rule found it, in one word: ``declaration`` (a component is
            declared wrongly), ``name``, ``claim``, ``need`` (nobody provides what an
            action reads or writes), ``denied`` (a policy denies it), ``rights`` (a
            policy that does not fit the robot), ``time`` (times that can never be
            met), ``placement`` (what cannot live in a process of its own), ``protect``
            (what moves without protection, and protection that is not what it seems),
            ``mode`` (a mode that names nobody, or that the robot never comes to),
            ``starve`` (actions keep each other from an actuator), ``silent`` (a sensor
            that may never speak), ``unused``, ``port``, ``load`` (a bus is
            asked for more than it can do).
        component: The name of the component; ``"policy of 'wheels'"`` for a policy.
        field: The field in question, as a dotted path; empty for the whole.
        wrong: What is wrong.
        advice: What to do; empty if that is said by what was expected.
        subject: The component, policy or bus itself; None for the robot.
        cause: The error, if it is not a plain `ConfigError`.
    """

    severity: Severity
    rule: str
    component: str
    field: str
    wrong: str
    advice: str = ""
    subject: object = attrs.field(default=None, eq=False, repr=False)
    cause: EsairError | None = attrs.field(default=None, eq=False, repr=False)

    @property
    def is_error(self) -> bool:
        """Whether the robot does not start."""
        return self.severity is Severity.ERROR

    @property
    def text(self) -> str:
        """What is wrong, and what to do, in one sentence."""
        return f"{self.wrong}: {self.advice}" if self.advice else self.wrong

    def error(self) -> EsairError:
        """Return what is raised for it."""
        return self.cause or ConfigError(self.component, self.field, self.text)


def mistake(
    rule: str,
    subject: object,
    field: str,
    wrong: str,
    advice: str = "",
    *,
    of: str = "",
    cause: EsairError | None = None,
    severity: Severity = Severity.ERROR,
) -> Finding:
    """Make a finding that stops the start, of a subject or of what is said to be."""
    of = of or _called(subject)
    return Finding(severity, rule, of, field, wrong, advice, subject, cause)


warning = functools.partial(mistake, severity=Severity.WARNING)
"""Makes a finding that stops nothing."""


def _called(subject: object) -> str:
    if isinstance(subject, BehaviorsPolicy):
        return "policy of behaviors"
    if isinstance(subject, Policy):
        return f"policy of {subject.resource!r}"
    return name_of(subject) or ""


def because(rule: str, subject: object, error: EsairError) -> Finding:
    """Make a finding of an error that says which field of which component is wrong."""
    component = str(getattr(error, "component", ""))
    field = str(getattr(error, "field", ""))
    text = str(error).removeprefix(f"{component}: ").removeprefix(f"{field}: ")
    cause = None if type(error) is ConfigError else error
    return mistake(rule, subject, field, text, of=component, cause=cause)


def errors_in(findings: Iterable[Finding]) -> list[EsairError]:
    """Return an error for each finding that stops the start."""
    return [finding.error() for finding in findings if finding.is_error]


def refuse(findings: Iterable[Finding], title: str) -> None:
    """Raise the mistakes among findings: one as it is, several in a group.

    Raises:
        EsairError: The one mistake.
        ExceptionGroup: All mistakes, if there are several.
    """
    errors = errors_in(findings)
    if len(errors) == 1:
        raise errors[0]
    if errors:
        raise ExceptionGroup(title, errors)
