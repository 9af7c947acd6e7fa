"""Everything that esair raises, under one root.

Each error is also the built-in that people expect, so a robot script can catch
it broadly (``except TimeoutError``) or exactly (``except esair.StaleReadingError``)::

    EsairError
    ├── ConfigError              ValueError       the robot is described wrongly
    ├── NameTakenError           ValueError       two components, one name
    ├── UnknownNameError         LookupError      nobody has that name
    ├── NotRegisteredError       PermissionError  used before it was registered
    ├── AccessDeniedError        PermissionError  a rule says no
    ├── ResourceRemovedError     ConnectionError  the user took the resource away
    ├── DeviceLostError          ConnectionError  unplugged; it may come back
    ├── DeviceFaultError         OSError          the device answered wrongly
    ├── DriverStuckError         TimeoutError     a driver call did not return
    │   └── NoTurnError                           its bus had no time for it
    ├── StaleReadingError        TimeoutError     no reading that is fresh enough
    ├── BadValueError            ValueError       a value that must not be sent
    ├── BehaviorUnavailableError TimeoutError     busy for the whole interval
    ├── BehaviorRemovedError                      the other behavior is gone
    ├── BehaviorFailedError                       the other behavior crashed
    ├── ProcessDiedError         ConnectionError  the process of a component died
    ├── RefusedError                              an ask that its peer refused
    ├── OutcomeUnknownError      ConnectionError  an ask whose answer was lost
    ├── CircularRequestError                      a request that waits for itself
    ├── BusyError                                 a bound is reached
    ├── StoppingError                             the robot starts or stops
    ├── HaltedError              PermissionError  the robot is halted
    ├── WrongLoopError           RuntimeError     used from a foreign event loop
    ├── RecordingError           OSError          a recording cannot be written
    └── RecordingBrokenError     ValueError       a recording cannot be read
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from traceback import TracebackException


class EsairError(Exception):
    """The root of every error that esair raises. It can be copied and pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self.args, self.__dict__)


class ConfigError(EsairError, ValueError):
    """A robot, a component or a setting is described wrongly.

    Attributes:
        component: The name of the component, or of the file.
        field: The field in question, as a dotted path; empty for the whole.
    """

    def __init__(self, component: str, field: str, message: str) -> None:
        where = f"{component}: {field}" if field else component
        super().__init__(f"{where}: {message}")
        self.component = component
        self.field = field


class NameTakenError(EsairError, ValueError):
    """Two components would have the same name."""

    def __init__(self, kind: str, name: str) -> None:
        super().__init__(
            f"a {kind} named {name!r} is already there: "
            f"choose another name=, or use replace({name!r}, ...)"
        )
        self.kind = kind
        self.name = name


class UnknownNameError(EsairError, LookupError):
    """Nobody has the name; the nearest names are in the message.

    Args:
        kind: What should have the name: a behavior, a resource.
        name: The name.
        known: The names that there are.
        user: Who uses the name, such as ``"avoid.sonar"``; empty if it is the caller.
    """

    def __init__(
        self, kind: str, name: str, known: Iterable[str] = (), *, user: str = ""
    ) -> None:
        told = f"no {kind} is named {name!r}{hint_for(name, sorted(known))}"
        super().__init__(f"{user}: {told}" if user else told)
        self.kind = kind
        self.name = name


class NotRegisteredError(EsairError, PermissionError):
    """A behavior used a resource that it had not registered."""

    def __init__(self, behavior: str, resource: str, detail: str = "") -> None:
        super().__init__(
            f"{behavior!r} uses {resource!r}: register it first"
            + (f" ({detail})" if detail else "")
        )
        self.behavior = behavior
        self.resource = resource


class AccessDeniedError(EsairError, PermissionError):
    """A rule denies what a behavior asked for.

    Attributes:
        asked: What was asked for, such as ``"WRITE"``.
        rule: The rule that denied it, in words.
    """

    def __init__(self, behavior: str, resource: str, asked: str, rule: str) -> None:
        super().__init__(f"{behavior!r} may not {asked} {resource!r}: {rule}")
        self.behavior = behavior
        self.resource = resource
        self.asked = asked
        self.rule = rule


class ResourceRemovedError(EsairError, ConnectionError):
    """The user removed or replaced the resource; the registration is void."""

    def __init__(self, resource: str) -> None:
        super().__init__(
            f"resource {resource!r} was removed: register again once it is back"
        )
        self.resource = resource


class DeviceLostError(EsairError, ConnectionError):
    """The device is not there. It is reopened by itself when it comes back.

    Drivers raise it too, to say that their device is gone. From a write it says if
    nobody can know whether the command was applied.

    Attributes:
        resource: The name of the sensor or actuator.
        detail: What is known about it, in words; empty if nothing is.
    """

    def __init__(self, resource: str, detail: str = "") -> None:
        super().__init__(
            f"device of {resource!r} is lost" + (f": {detail}" if detail else "")
        )
        self.resource = resource
        self.detail = detail


class DeviceFaultError(EsairError, OSError):
    """The device, or its driver, did something it must not do."""

    def __init__(self, resource: str, detail: str) -> None:
        super().__init__(f"device of {resource!r} is at fault: {detail}")
        self.resource = resource


class DriverStuckError(EsairError, TimeoutError):
    """A driver call did not return within its deadline."""

    def __init__(self, resource: str, call: str, seconds: float) -> None:
        super().__init__(
            f"driver of {resource!r} is stuck: {call} did not return in {seconds:g} s"
        )
        self.resource = resource
        self.call = call
        self.seconds = seconds


class NoTurnError(DriverStuckError):
    """A call got no turn on its bus: it was not made, and the device was not asked."""

    def __init__(self, resource: str, call: str, seconds: float) -> None:
        super().__init__(resource, call, seconds)
        self.args: tuple[str] = (
            f"{call} of {resource!r} got no turn on its bus in {seconds:g} s: "
            "the bus is asked for more than it can do, or is held up",
        )


class StaleReadingError(EsairError, TimeoutError):
    """There is no reading that is fresh enough.

    Attributes:
        age: Age of the newest reading in seconds; None if there never was one.
        limit: What was asked for, in seconds: the greatest age, or, if the device
            did not answer in time, that time.
    """

    def __init__(
        self, resource: str, age: float | None, limit: float, *, silent: bool = False
    ) -> None:
        newest = (
            "there is no reading yet" if age is None else f"newest is {age:.3g} s old"
        )
        missed = "the device did not answer in" if silent else "limit"
        super().__init__(
            f"no fresh reading of {resource!r}: {newest}, {missed} {round(limit, 4):g} s"
        )
        self.resource = resource
        self.age = age
        self.limit = limit


class BadValueError(EsairError, ValueError):
    """A value of the wrong type, not finite, or outside its limits."""

    def __init__(self, component: str, field: str, message: str) -> None:
        super().__init__(
            f"{component}: {field}: {message}" if field else f"{component}: {message}"
        )
        self.component = component
        self.field = field


class BehaviorUnavailableError(EsairError, TimeoutError):
    """A behavior could not receive, or send, for the whole interval.

    Attributes:
        state: What it was doing when the interval was over.
    """

    def __init__(
        self, behavior: str, request: str, interval: float, state: str
    ) -> None:
        super().__init__(
            f"{behavior!r} could not {request} for {interval:g} s (it is {state})"
        )
        self.behavior = behavior
        self.interval = interval
        self.state = state


class BehaviorRemovedError(EsairError):
    """The behavior was removed while something waited for it, or used it.

    Attributes:
        data: What a cancelled put wanted to hand over; None else.
    """

    def __init__(self, behavior: str, data: object = None) -> None:
        super().__init__(f"behavior {behavior!r} was removed")
        self.behavior = behavior
        self.data = data


class BehaviorFailedError(EsairError):
    """The behavior crashed; its error is the cause."""

    def __init__(self, behavior: str, detail: str = "") -> None:
        super().__init__(
            f"behavior {behavior!r} failed" + (f": {detail}" if detail else "")
        )
        self.behavior = behavior
        self.detail = detail


class ProcessDiedError(EsairError, ConnectionError):
    """The process in which a component was placed has died, or hung and was killed.

    Attributes:
        component: The name of the component.
        code: Its exit code; below 0 the number of the signal; None if nobody knows.
        words: The last lines that it has written, such as the stack where it hung.
    """

    def __init__(
        self, component: str, how: str, code: int | None = None, words: str = ""
    ) -> None:
        told = f"; its last words: {words}" if words else ""
        super().__init__(f"the process of {component!r} {how}{told}")
        self.component = component
        self.code = code
        self.words = words


class RefusedError(EsairError):
    """A behavior refused what it was asked; one that answers requests may raise it.

    Attributes:
        reason: Why, in words.
        behavior: Who refused; empty where it is raised to refuse.
    """

    def __init__(self, reason: str, behavior: str = "") -> None:
        super().__init__(f"{behavior!r} refused: {reason}" if behavior else reason)
        self.reason = reason
        self.behavior = behavior


class OutcomeUnknownError(EsairError, ConnectionError):
    """A request reached another robot, perhaps, and its answer was lost.

    It may have been done, or half of it, or not at all: nothing here knows. Ask what is
    the case there before it is asked again.

    Attributes:
        behavior: The behavior that was asked.
        detail: What has happened.
    """

    def __init__(self, behavior: str, detail: str) -> None:
        told = f"it is not known what became of a request to {behavior!r}: {detail}"
        super().__init__(told)
        self.behavior = behavior
        self.detail = detail


class CircularRequestError(EsairError):
    """A get, or an ask, that would wait for itself.

    Attributes:
        path: The names on the circle, the first one again at the end.
    """

    def __init__(self, path: Iterable[str]) -> None:
        self.path: tuple[str, ...] = tuple(path)
        super().__init__(f"a circle of requests: {' -> '.join(self.path)}")


class BusyError(EsairError):
    """A bound is reached; nothing was done.

    Attributes:
        bound: The name of the bound.
        limit: Its value.
    """

    def __init__(self, component: str, bound: str, limit: object) -> None:
        super().__init__(f"{component}: {bound} is reached ({limit}): try again later")
        self.component = component
        self.bound = bound
        self.limit = limit


class StoppingError(EsairError):
    """The robot is not running: it has not started, is stopping, or has stopped."""

    def __init__(self, component: str, phase: str) -> None:
        super().__init__(f"{component} takes no requests: it is {phase}")
        self.component = component
        self.phase = phase


class HaltedError(EsairError, PermissionError):
    """The robot is halted: nothing moves until the user's `Robot.resume`.

    Attributes:
        resource: What was to be used.
        reason: Why the robot is halted.
    """

    def __init__(self, resource: str, reason: str) -> None:
        super().__init__(
            f"{resource!r} must not move: the robot is halted: {reason} "
            "(robot.resume() ends the halt)"
        )
        self.resource = resource
        self.reason = reason


class WrongLoopError(EsairError, RuntimeError):
    """A port was used from another event loop than its robot's; nothing was done.

    Attributes:
        behavior: Whose port it is.
        resource: What was to be used.
    """

    def __init__(self, behavior: str, resource: str) -> None:
        super().__init__(
            f"{behavior!r} uses {resource!r} outside of its robot's event loop: in a "
            "thread use the ports of an esair.ThreadBehavior, or "
            "asyncio.run_coroutine_threadsafe(..., the robot's loop)"
        )
        self.behavior = behavior
        self.resource = resource


class RecordingError(EsairError, OSError):
    """A recording cannot be written; the robot goes on without it.

    Attributes:
        path: The file of the recording.
    """

    def __init__(self, path: str, detail: str) -> None:
        super().__init__(f"recording {path}: {detail}")
        self.path = path


class RecordingBrokenError(EsairError, ValueError):
    """A file is no recording, or not a whole one.

    Attributes:
        path: The file.
    """

    def __init__(self, path: str, detail: str) -> None:
        super().__init__(f"recording {path}: {detail}")
        self.path = path


def _restored(
    cls: type[EsairError], args: tuple[Any, ...], state: dict[str, Any]
) -> EsairError:
    error = cls.__new__(cls, *args)
    error.args = args
    error.__dict__.update(state)
    return error


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the nearest known word, or nothing."""
    import difflib  # only when something went wrong

    nearest = difflib.get_close_matches(str(word), list(known), n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else ""


def hint_for(word: str, known: Iterable[str], has: str = "there are") -> str:
    """Return ``"; did you mean 'x'?"``, or else which words are known: the first 24."""
    names = list(known)
    shown = ", ".join(names[:24]) + (", ..." if len(names) > 24 else "")
    return did_you_mean(word, names) or f"; {has} {shown or 'none'}"


def lookable(error: BaseException) -> BaseException:
    """Return an error that can be asked for its class: one of a user's may raise then."""
    try:
        isinstance(error, EsairError)
    except BaseException:
        return RuntimeError(f"{describe(error)} (an error that cannot be looked at)")
    return error


def describe(error: BaseException) -> str:
    """Name an error in one line, even one whose own ``__str__`` raises.

    What cannot be printed is escaped: the text may be that of a device. The class of a
    loss is left out: its text says it, once for each bus that is between.
    """
    try:
        text = printable(" ".join(str(error).split()))
    except BaseException:  # a user's __str__ may raise anything
        text = "(its text cannot be shown)"
    if text and issubclass(type(error), DeviceLostError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def in_short(error: BaseException) -> str:
    """Say what is wrong in one line, where the device stands beside it."""
    if not isinstance(error, EsairError):
        return describe(error)
    lost = isinstance(error, DeviceLostError) and error.detail
    return printable(" ".join((lost or str(error)).split()))


def line_of(error: BaseException) -> str:
    """Return the last line of the user's own code that an error came by; or nothing.

    Of a behavior that failed it is where that has failed, not where it was met.
    """
    import linecache
    import os
    import traceback

    ours = (os.path.dirname(__file__) + os.sep, os.path.dirname(os.__file__), "<")
    while isinstance(error, BehaviorFailedError) and error.__cause__:
        error = error.__cause__
    place = ""
    for frame, number in traceback.walk_tb(error.__traceback__):
        file, name = frame.f_code.co_filename, frame.f_code.co_name
        is_own = "-packages" not in file  # else it counts where nothing else is
        if (is_own or not place) and not file.startswith(ours):
            text = linecache.getline(file, number).strip()
            place = printable(f"{file}, line {number}, in {name}: {text}")
    return vars(error).get("_line") or place  # it has come from another process


def wants_traceback() -> bool:
    """Tell whether this program shall show how its errors came about."""
    import os
    import sys

    return "--traceback" in sys.argv or bool(os.environ.get("ESAIR_TRACEBACK"))


def told_traceback(error: BaseException) -> str:
    """Return a traceback as Python prints it; what the errors say is escaped.

    Their texts may be those of a device: none begins a line of its own.
    """
    import traceback  # only when something went wrong

    found = traceback.TracebackException.from_exception(error, compact=True)
    return "\n".join(_traceback_lines(found, GROUPS))


GROUPS = 8
"""How deep groups of errors are told."""


def _traceback_lines(found: TracebackException, depth: int) -> list[str]:
    chain: list[tuple[str, Any]] = []
    each: Any = found
    told = ""
    while each is not None:
        chain.append((told, each))
        if each.__cause__ is not None:
            told = (
                "The above exception was the direct cause of the following exception:"
            )
            each = each.__cause__
        else:
            told = "During handling of the above exception, another exception occurred:"
            each = None if each.__suppress_context__ else each.__context__
    lines: list[str] = []
    for told, each in reversed(chain):
        notes = each.__notes__ if isinstance(each.__notes__, list) else []
        each.__notes__ = [printable(note) for note in notes if isinstance(note, str)]
        if each.stack:
            lines.append("Traceback (most recent call last):")
        for frame in each.stack.format():
            lines += map(printable, frame.rstrip("\n").split("\n"))
        lines += [printable(line.rstrip("\n")) for line in each.format_exception_only()]
        for inner in (each.exceptions or ()) if depth else ():
            lines += [f"  | {line}" for line in _traceback_lines(inner, depth - 1)]
        if told:
            lines += ["", told, ""]
    return lines


def printable(text: str) -> str:
    """Return a text from outside so that a terminal or a log can show it.

    Line ends, escapes, and what turns the direction of writing are shown as their
    numbers: nothing that a device, a file or a client says can forge a line.
    """
    if text.isprintable():
        return text
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode("ascii")
        for each in text
    )
