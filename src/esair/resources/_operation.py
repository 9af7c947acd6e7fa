"""Operations: the methods of a resource that people may call by name."""

from __future__ import annotations

import inspect
import math
import typing
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, TypeVar, overload

import attrs

from esair import abc
from esair.exceptions import BadValueError, UnknownNameError, did_you_mean
from esair.values import (
    checked_class,
    hints_of,
    is_positive,
    once_for_class,
    passes_as,
    type_name,
)

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
        fits = False
        for kind in _alternatives(self.type):
            if kind is type(None):
                fits = fits or value is None
                continue
            if kind in {int, float} and passes_as(value, kind):
                value = kind(value)
            elif kind in {int, float}:
                continue
            cls = checked_class(kind)
            fits = fits or cls is None or isinstance(value, cls)
        if not fits:
            raise ValueError(f"expected {type_name(self.type)}, not {value!r:.80}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"expected a finite number, not {value}")
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
            told = "; ".join(f"{name}: {text}" for name, text in mistakes.items())
            refusal = BadValueError(component, self.name, told)
            refusal.field = ", ".join(f"{self.name}.{name}" for name in mistakes)
            raise refusal
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

    An actuator is made safe before and after it. What makes the actuator safe while
    it runs (a halt, a blind hold, a guard) ends it by a cancellation: write one that
    moves as ``async def``, for a plain one keeps the safe command waiting.

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
        setattr(method, _MARK, deadline)
        return method

    return mark if function is None else mark(function)


@once_for_class
def operations_of(component: type[abc.Resource]) -> Mapping[str, Operation]:
    """Return the operations that a class of resources declares, by name."""
    return MappingProxyType(
        {name: _described(component, name, each) for name, each in _marked(component)}
    )


def operation_of(resource: abc.Resource, name: str) -> Operation:
    known = operations_of(type(resource))
    if name not in known:
        raise UnknownNameError("operation", name, known, user=resource.name)
    return known[name]


def wrong_operations(component: type[abc.Resource]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the operations of a class: the method, and what."""
    for name, marked in _marked(component):
        function = getattr(component, name)
        deadline = getattr(marked, _MARK)
        if name in _OWN or name == "stream":
            yield name, "a method that esair calls by itself is no operation"
        elif name.startswith("_"):
            yield name, "an operation has a name without an underscore before it"
        if not inspect.isfunction(function):
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


def _marked(component: type[Any]) -> Iterator[tuple[str, Any]]:
    """Yield the names of operations, and the nearest method that is marked as one.

    A subclass that overrides the method need not mark it again.
    """
    seen = set()
    for cls in component.__mro__:
        for name, value in vars(cls).items():
            if name not in seen and hasattr(value, _MARK):
                seen.add(name)
                yield name, value


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


def _alternatives(kind: Any) -> tuple[Any, ...]:
    arguments = typing.get_args(kind)
    return arguments if type(None) in arguments else (kind,)
