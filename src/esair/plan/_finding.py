"""What the rulebook says about a robot: one sentence for each finding."""

from __future__ import annotations

import enum
import functools
from collections.abc import Iterable

import attrs

from esair.exceptions import ConfigError, EsairError
from esair.messages import BehaviorsPolicy, Policy
from esair.plan._plan import name_of


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
