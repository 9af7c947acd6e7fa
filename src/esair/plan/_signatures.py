"""How the methods of a component are called, and whether they can be."""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from esair.actions import (
    Behavior,
    Derived,
    MinimalReaction,
    Need,
    Reaction,
    Reads,
    Writes,
)
from esair.messages import Reading
from esair.resources import Actuator, Sensor, settings_of
from esair.values import hints_of, same_type, type_name

_RESOURCE = ("open", "close", "identify")
_BEHAVIOR = ("setup", "run", "teardown", "provide")


def wrong_signatures(
    resource: Sensor[Any] | Actuator[Any],
) -> Iterator[tuple[str, str]]:
    """Yield each method of a resource that cannot be called, and what was expected."""
    for field in _RESOURCE:
        method = getattr(resource, field)
        if told := _cannot(method):
            yield field, f"expected a method without parameters: {told}"
        elif yields(method):
            yield field, "expected a method that does not yield"
    changes = dict.fromkeys(settings_of(type(resource)))
    if told := _cannot(resource.apply, **changes):
        yield "apply", f"expected a method that takes its settings by name: {told}"
    if isinstance(resource, Actuator):
        if told := _cannot(resource.write, None):
            yield "write", f"expected a method with one parameter, the command: {told}"
        elif yields(resource.write):
            yield "write", "expected a method that does not yield"
        return
    if resource.can_be_asked:
        if told := _cannot(resource.read):
            yield "read", f"expected a method without parameters: {told}"
        elif yields(resource.read):
            yield "read", "expected a method that returns one value: name it stream"
    if resource.pushes:
        if told := _cannot(resource.stream):
            yield "stream", f"expected a method without parameters: {told}"
        elif inspect.iscoroutinefunction(resource.stream):
            yield "stream", "expected a method that yields its values"


def wrong_methods(behavior: Behavior) -> Iterator[tuple[str, str]]:
    """Yield each method of a behavior that cannot be called, and what was expected."""
    for field in _BEHAVIOR:
        method = getattr(behavior, field)
        if getattr(type(behavior), field) is getattr(Behavior, field):
            continue
        if told := _cannot(method):
            yield field, f"expected a method without parameters: {told}"
        elif yields(method):
            yield field, "expected a method that does not yield"


def wrong_react(reaction: Reaction) -> Iterator[str]:
    """Yield what is wrong with ``react``: its kind, its parameters, their types."""
    if getattr(reaction.react, "__func__", None) is Reaction.react:
        yield "a reaction must have a react method"
    else:
        kind = "readings and the command" if reaction.guarded else "readings"
        yield from _wrong_step(reaction.react, _given(reaction), kind)


def wrong_compute(derived: Derived[Any]) -> Iterator[str]:
    """Yield what is wrong with ``compute``: its kind, its parameters, their types."""
    if getattr(derived.compute, "__func__", None) is Derived.compute:
        yield "a derived sensor must have a compute method"
        return
    wrong = list(_wrong_step(derived.compute, derived.inputs, "readings"))
    yield from wrong or _mistyped(derived.compute, derived.inputs)


def _wrong_step(
    step: Callable[..., Any], given: Mapping[str, Need], kind: str
) -> Iterator[str]:
    if inspect.iscoroutinefunction(step):
        yield "expected a plain function, not async"
    elif yields(step):
        yield "expected a plain function that does not yield"
    elif told := _cannot(step, **dict.fromkeys(given)):
        names = ", ".join(given) or "none"
        yield f"its parameters must be its {kind} ({names}): {told}"


def wrong_blind(guard: Reaction, port: str) -> str | None:
    """Say what is wrong with the ``blind`` of a guard."""
    if inspect.iscoroutinefunction(guard.blind):
        return "expected a plain function"
    if told := _cannot(guard.blind, **{port: None}):
        return f"its parameter must be the command ({port}): {told}"
    return None


def _given(reaction: Reaction) -> dict[str, Need]:
    """Return the ports that give ``react`` its parameters."""
    return {
        name: need
        for name, need in reaction.needs.items()
        if not isinstance(need, Writes)
    }


def wrong_types(reaction: Reaction) -> Iterator[str]:
    """Yield each annotated parameter of ``react`` that its port does not fit."""
    if isinstance(reaction, MinimalReaction):
        return  # its types are for readers only
    yield from _mistyped(reaction.react, _given(reaction))


def _mistyped(step: Callable[..., Any], given: Mapping[str, Need]) -> Iterator[str]:
    hints = hints_of(inspect.unwrap(step))
    for name, need in given.items():
        hint = hints.get(name, Any)
        if typing.get_origin(hint) is typing.Annotated:
            hint = typing.get_args(hint)[0]
        if not same_type(need.type, _value_of(hint)):
            doing = "reads" if isinstance(need, Reads) else "guards"
            yield (
                f"its parameter {name!r} is a {_text(hint)}, but the port {name!r} "
                f"{doing} {type_name(need.type)}: annotate it as {type_name(need.type)}"
            )


def _value_of(hint: Any) -> Any:
    """Return the type of the value in ``T | None``, or ``Reading[T]``."""
    if typing.get_origin(hint) in {typing.Union, types.UnionType}:
        parts = tuple(_value_of(part) for part in typing.get_args(hint))
        return typing.Union[parts]  # noqa: UP007 - the parts are known now only
    if typing.get_origin(hint) is Reading:
        return typing.get_args(hint)[0]
    return Any if hint is Reading or isinstance(hint, typing.TypeVar) else hint


def _text(hint: Any) -> str:
    return type_name(hint) if inspect.isclass(hint) else str(hint).replace("esair.", "")


def yields(method: Callable[..., Any]) -> bool:
    """Tell whether a method is a generator, and so would do nothing when called."""
    return inspect.isgeneratorfunction(method) or inspect.isasyncgenfunction(method)


def _cannot(method: Callable[..., Any], *values: object, **named: object) -> str | None:
    """Say why a method cannot be called so; None if it can, or if nobody knows."""
    try:
        signature = inspect.signature(method)
    except ValueError:  # of a class written in C, say
        return None
    except TypeError as error:
        return str(error)
    try:
        signature.bind(*values, **named)
    except TypeError as error:
        return str(error)
    return None
