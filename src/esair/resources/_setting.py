"""What a resource declares: settings, which can be configured, and operations, to be called."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from types import MappingProxyType
from typing import Any, TypeVar, cast, overload

import attrs

from esair import abc
from esair.exceptions import BadValueError, UnknownNameError, did_you_mean
from esair.flaws import unsound
from esair.values import (
    alternatives,
    fits,
    hints_of,
    is_positive,
    once_for_class,
    passes_as,
    type_name,
)

T = TypeVar("T")

_WORDS: Mapping[type, str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "a text",
}

HIDDEN = "(secret)"  # what is shown of the value of a secret setting


@attrs.frozen
class Setting:
    """The description of a setting: its type, unit, and limits.

    Attributes:
        default: The value until somebody configures another; its type is the
            type of the setting.
        unit: The unit, such as ``"Hz"``; empty if it has none.
        min: The least value allowed.
        max: The greatest value allowed.
        choices: The only values allowed.
        doc: What the setting does, in one line.
        name: The name, as the class gives it.
        secret: Its values are never recorded and never shown.
    """

    default: Any
    unit: str = ""
    min: float | None = None
    max: float | None = None
    choices: Collection[object] | None = None
    doc: str = ""
    name: str = ""
    secret: bool = False

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", name)

    def __get__(self, instance: object, owner: type) -> Any:
        # A configured value lies in the instance and is found before this.
        return self if instance is None else self.default

    @property
    def type(self) -> type:
        """The type that values of this setting have."""
        return type(self.default)

    @property
    def flaw(self) -> str:
        """What is wrong with its limits, or its default; empty if it is sound."""
        if any(bound != bound for bound in (self.min, self.max)):  # NaN
            return "its least or greatest value is not a number"
        wrong = "" if self.default is None else self._wrong(self.default)
        shown = "; it is secret and not shown" if self.secret else f": {wrong}"
        return f"its default is not allowed{shown}" if wrong else ""

    def check(self, component: str, value: object) -> object:
        """Return the value in the type of the setting."""
        wanted = self.type
        if type(value) is not wanted and passes_as(value, wanted):
            with contextlib.suppress(OverflowError):  # refused below
                value = wanted(value)
        if wrong := self._wrong(value):
            if self.secret:
                wrong = "its value is not allowed; it is secret and not shown"
            raise BadValueError(component, self.name, wrong)
        return value

    def _wrong(self, value: object) -> str:
        """Say what is wrong with a value; nothing if it is allowed."""
        if self.default is not None and type(value) is not self.type:
            return f"expected {self._in_words()}, not {value!r:.80}"
        if wrong := unsound(value):
            return wrong
        if self.choices is not None and value not in self.choices:
            names = ", ".join(repr(choice) for choice in self.choices)
            return f"expected one of {names}, not {value!r:.80}"
        number = cast("float", value)
        if self.min is not None and number < self.min:
            return f"expected at least {self.min}{self._in_unit()}, not {value}"
        if self.max is not None and number > self.max:
            return f"expected at most {self.max}{self._in_unit()}, not {value}"
        return ""

    def _in_words(self) -> str:
        words = _WORDS.get(self.type, self.type.__name__)
        return f"{words} in {self.unit}" if self.unit else words

    def _in_unit(self) -> str:
        return f" {self.unit}" if self.unit else ""


def setting(
    default: T,
    *,
    unit: str = "",
    min: float | None = None,  # noqa: A002 - the word that everybody expects
    max: float | None = None,  # noqa: A002 - the word that everybody expects
    choices: Collection[T] | None = None,
    doc: str = "",
    secret: bool = False,
) -> T:
    """Declare a setting of a resource, as a class attribute.

    The attribute holds the current value. It is changed by the constructor
    (``Sonar(rate=20.0)``), the configuration file, or at run time by
    ``port.configure(rate=20.0)``, which checks every value first.

    Args:
        default: The value to begin with. Its type is the type of the setting.
        unit: The unit, such as ``"Hz"``.
        min: The least value allowed.
        max: The greatest value allowed.
        choices: The only values allowed.
        doc: What the setting does, in one line.
        secret: Its values are never recorded and never shown: a password, say.

    Example:
        >>> class Sonar(esair.Sensor[float]):
        ...     rate = esair.setting(20.0, unit="Hz", min=1.0, max=50.0)
        ...     gain = esair.setting(3, min=0, max=7, doc="amplification step")
    """
    # The static type is that of the value, as with attrs.field and its kin.
    return cast("T", Setting(default, unit, min, max, choices, doc, secret=secret))


def settings_of(component: type[abc.Component]) -> dict[str, Setting]:
    """Return the settings that a class of resources declares, by name.

    What is computed is never asked, and has no rate.
    """
    found: dict[str, Setting] = {}
    for cls in reversed(component.__mro__):
        found.update(
            (name, value)
            for name, value in vars(cls).items()
            if isinstance(value, Setting)
        )
    if getattr(component, "is_computed", False):
        found.pop("rate", None)
    return found


@once_for_class
def flaws_of(component: type[abc.Resource]) -> tuple[tuple[str, str], ...]:
    """Return the settings that a class declares wrongly: what, and why."""
    flaws = ((name, each.flaw) for name, each in settings_of(component).items())
    return tuple(each for each in flaws if each[1])


def shown(resource: abc.Resource, values: Mapping[str, object]) -> dict[str, object]:
    """Return values of settings as they may be recorded and shown."""
    known = settings_of(type(resource))
    return {
        name: HIDDEN if name in known and known[name].secret else value
        for name, value in values.items()
    }


def check_settings(
    resource: abc.Resource,
    changes: Mapping[str, object],
    keywords: Collection[str] = (),
) -> dict[str, object]:
    """Return the changes in the right types, or name every mistake at once.

    A name that there is not may have been meant for one of the keywords.
    """
    known = settings_of(type(resource))
    there = f"there are {', '.join(sorted(known))}" if known else "it has none"
    checked: dict[str, object] = {}
    mistakes: dict[str, str] = {}
    for name, value in changes.items():
        if name not in known:
            hint = did_you_mean(name, [*known, *keywords]) or f"; {there}"
            if keywords and _is_declared(type(resource), name):
                told = f"it is an attribute: {resource.name}.{name} = ..."
                hint = f"; {told} after it was made, or in a subclass"
            mistakes[name] = f"there is no such setting{hint}"
            continue
        try:
            checked[name] = known[name].check(resource.name, value)
        except BadValueError as error:
            mistakes[name] = str(error).removeprefix(f"{resource.name}: {name}: ")
    if mistakes:
        raise _refusal(resource.name, "", mistakes)
    return checked


def _is_declared(cls: type, name: str) -> bool:
    """Tell whether it is an attribute that a class says something about itself with."""
    return not name.startswith("_") and any(
        name in vars(each).get("__annotations__", ()) for each in cls.__mro__
    )


def _refusal(component: str, of: str, mistakes: Mapping[str, str]) -> BadValueError:
    """Make the error that tells every mistake at once."""
    told = "; ".join(f"{name}: {text}" for name, text in mistakes.items())
    refusal = BadValueError(component, of, told)
    refusal.field = ", ".join(f"{of}.{name}".lstrip(".") for name in mistakes)
    return refusal


F = TypeVar("F", bound=Callable[..., Any])

_MARK = "__esair_operation__"

_OWN = frozenset({"open", "close", "identify", "apply", "is_set_up", "read", "write"})
"""What the supervisor and the connections call; nobody else may."""

_NAMED = frozenset(
    {inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY}
)


@attrs.frozen
class Parameter:
    """What an operation takes.

    Attributes:
        name: Its name.
        type: The type of its values.
        required: Whether it has no default.
        default: The value unless given; None if it is required.
    """

    name: str
    type: Any
    required: bool = True
    default: Any = None

    def check(self, value: object) -> object:
        """Return the value in the type of the parameter.

        Raises:
            ValueError: The type is wrong, or the number is not finite.
        """
        for kind in alternatives(self.type):
            if kind in {int, float} and passes_as(value, kind):
                value = kind(value)  # of NumPy, say
        if not fits(value, self.type):
            raise ValueError(f"expected {type_name(self.type)}, not {value!r:.80}")
        if wrong := unsound(value):
            raise ValueError(wrong)
        return value

    def __str__(self) -> str:
        text = f"{self.name}: {type_name(self.type)}"
        return text if self.required else f"{text} = {self.default!r}"


@attrs.frozen
class Operation:
    """The description of an operation.

    Attributes:
        name: The name of the method.
        parameters: What it takes, by name.
        deadline: How long it may take, in seconds; None for the resource's own.
        doc: What it does, in one line.
    """

    name: str
    parameters: tuple[Parameter, ...] = ()
    deadline: float | None = None
    doc: str = ""

    def check(self, component: str, given: Mapping[str, object]) -> dict[str, object]:
        """Return the parameters in their types, or name every mistake at once.

        Raises:
            BadValueError: One is unknown, missing, or of a wrong type.
        """
        known = {each.name: each for each in self.parameters}
        mistakes: dict[str, str] = {}
        checked: dict[str, object] = {}
        for name, value in given.items():
            if name not in known:
                hint = did_you_mean(name, known) or f"; it is {self}"
                mistakes[name] = f"there is no such parameter{hint}"
                continue
            try:
                checked[name] = known[name].check(value)
            except (ValueError, OverflowError) as error:
                mistakes[name] = str(error)
        for name, each in known.items():
            if each.required and name not in given:
                mistakes[name] = f"it is missing; it is {self}"
        if mistakes:
            raise _refusal(component, self.name, mistakes)
        return checked

    def __str__(self) -> str:
        return f"{self.name}({', '.join(map(str, self.parameters))})"


@overload
def operation(function: F, /) -> F: ...
@overload
def operation(*, deadline: float | None = None) -> Callable[[F], F]: ...
def operation(function: Any = None, /, *, deadline: float | None = None) -> Any:
    """Let people call a method of a resource by its name: `home`, `calibrate`, `zero`.

    Whoever has the CONFIGURE right calls it by ``await port.operate("home",
    speed=0.1)``. Its parameters are checked by their annotations before it begins;
    it has the device for itself; and it has one outcome, within its deadline.

    An actuator is made safe before and after it. Its guards are asked when it begins and
    while it runs: one that answers None to what was asked of the actuator last, or what
    is safe, refuses it. What makes the actuator safe while it runs (a halt, a blind
    hold, a guard), and a write of a higher priority, end it by a cancellation: write one
    that moves as ``async def``, for a plain one keeps the safe command waiting.

    Args:
        function: The method.
        deadline: How long it may take, in seconds, with the wait for its turn; the
            resource's own deadline unless given.

    Example:
        >>> class Lift(esair.Actuator[float]):
        ...     @esair.operation(deadline=5.0)
        ...     async def home(self, speed: float = 0.1) -> float:
        ...         '''Find the lower end; returns how far it was, in m.'''
    """

    def mark(method: Any) -> Any:
        setattr(getattr(method, "__func__", method), _MARK, deadline)
        return method

    return mark if function is None else mark(function)


@once_for_class
def operations_of(component: type[abc.Resource]) -> Mapping[str, Operation]:
    """Return the operations that a class of resources declares, by name."""
    marked = _marked(component)
    return MappingProxyType(
        {name: _described(component, name, each) for name, each in marked.items()}
    )


def operation_of(resource: abc.Resource, name: str) -> Operation:
    known = operations_of(type(resource))
    if name not in known:
        raise UnknownNameError("operation", name, known, user=resource.name)
    return known[name]


def wrong_operations(component: type[abc.Resource]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the operations of a class: the method, and what."""
    for name, marked in _marked(component).items():
        function = getattr(component, name)
        deadline = getattr(marked, _MARK)
        if name in _OWN or name == "stream":
            yield name, "a method that esair calls by itself is no operation"
        elif name.startswith("_"):
            yield name, "an operation has a name without an underscore before it"
        if not inspect.isfunction(inspect.getattr_static(component, name)):
            yield name, "an operation must be a method, with or without async"
            continue
        if inspect.isgeneratorfunction(function) or inspect.isasyncgenfunction(
            function
        ):
            yield name, "expected a method that does not yield"
        if deadline is not None and not is_positive(deadline):
            yield name, f"deadline: expected seconds > 0, not {deadline!r:.80}"
        hints = hints_of(function)
        for each in list(inspect.signature(function).parameters.values())[1:]:
            if each.kind not in _NAMED:
                yield name, f"its parameter {each.name!r} cannot be given by name"
            elif each.name not in hints:
                yield name, f"its parameter {each.name!r} has no type: annotate it"
            elif each.default is not each.empty:
                try:
                    Parameter(each.name, hints[each.name]).check(each.default)
                except (ValueError, OverflowError) as error:
                    yield name, f"the default of {each.name!r}: {error}"


@once_for_class
def _marked(component: type[abc.Resource]) -> Mapping[str, Any]:
    """Return the nearest method that is marked as an operation, by its name.

    A subclass that overrides the method need not mark it again.
    """
    found: dict[str, Any] = {}
    for cls in component.__mro__:
        for name, value in vars(cls).items():
            method = getattr(value, "__func__", value)  # of a staticmethod above it
            if hasattr(method, _MARK):
                found.setdefault(name, method)
    return found


def _described(component: type[Any], name: str, marked: Any) -> Operation:
    function = getattr(component, name)
    hints = hints_of(function)
    parameters = tuple(
        Parameter(
            each.name,
            hints.get(each.name, Any),
            each.default is each.empty,
            None if each.default is each.empty else each.default,
        )
        for each in list(inspect.signature(function).parameters.values())[1:]
    )
    doc = (inspect.getdoc(function) or "").partition("\n")[0]
    return Operation(name, parameters, getattr(marked, _MARK), doc)
