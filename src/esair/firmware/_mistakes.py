"""What is wrong with the parts of an `esair.minimal.Loop`, told where there is room."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

from esair import minimal

_FASTEST = 1000.0  # Hz: MIN counts whole milliseconds
_LONGEST = 2**29 / 1000  # seconds, half of what a board's counter holds


def mistakes(
    reactions: Sequence[Any],
    sensors: Sequence[Any],
    actuators: Sequence[Any],
    rate: float,
) -> list[str]:
    """Return what is wrong with the parts of a loop, and how they fit together.

    Args:
        reactions: As `esair.minimal.Loop` takes them.
        sensors: The same.
        actuators: The same.
        rate: Steps per second.

    Returns:
        One line for each mistake, which begins with the name of the part.
    """
    found = [
        f"{each.__name__}: expected an object, not a class"
        for each in (*reactions, *sensors, *actuators)
        if isinstance(each, type)
    ]
    found += _duration("loop", "rate", rate, _FASTEST, "Hz")
    if found:
        return found
    devices = [*sensors, *actuators]
    for part in (*reactions, *devices):
        minimal.give_name(part)
    for group in (list(reactions), devices):
        found += _names([part.name for part in group])
    for part in devices:
        found += _async(part, "open") + _async(part, "close")
    for part in (*sensors, *reactions):
        pace = getattr(part, "rate", None)
        if pace is not None:
            found += _duration(part.name, "rate", pace, rate, "Hz")
    for part in sensors:
        found += _method(part, "read", minimal.Sensor)
    for part in actuators:
        found += _method(part, "write", minimal.Actuator) + _actuator(part, rate)
    for part in reactions:
        found += _method(part, "react", minimal.Reaction)
        found += _profile(part, sensors, actuators)
    return found


def _names(names: list[str]) -> list[str]:
    found = [
        f"{name}: there are two of this name"
        for name in sorted(set(names))
        if names.count(name) > 1
    ]
    for name in names:
        letters = name.replace("_", "")
        small = all(each.islower() or each.isdigit() for each in letters)
        if not small or not name[0].islower():
            found.append(f"{name}: a name has small letters, digits and _")
    return found


def _duration(
    name: str, field: str, value: object, most: float, unit: str = "seconds"
) -> list[str]:
    if isinstance(value, int | float) and 0 < value <= most * 1.0001:
        return []
    return [f"{name}: {field}: expected {unit} > 0, at most {most:g}, not {value!r}"]


def _method(part: Any, name: str, base: type) -> list[str]:
    method = getattr(part, name, None)
    is_empty = getattr(method, "__func__", None) is getattr(base, name)
    if is_empty or not callable(method):
        return [f"{part.name}: it must have a method {name}"]
    return _async(part, name)


def _async(part: Any, name: str) -> list[str]:
    method = getattr(part, name, None)
    module = getattr(method, "__module__", None) or ""
    # Those of STD itself do nothing: they are left out, not refused.
    if module.startswith("esair."):
        return []
    if inspect.iscoroutinefunction(method) or inspect.isasyncgenfunction(method):
        return [f"{part.name}: {name}: expected a plain method, not async"]
    return []


def _actuator(part: Any, rate: float) -> list[str]:
    name = part.name
    if not hasattr(part, "safe"):
        return [f"{name}: safe: an actuator must declare its safe command"]
    found = _duration(name, "command_timeout", part.command_timeout, _LONGEST)
    if not found and part.command_timeout < 1.0 / rate:
        found.append(f"{name}: command_timeout: shorter than one step")
    if getattr(part, "slew", None) is not None:
        found.append(f"{name}: slew: only STD has it")
    if part.clamp and isinstance(part.limits, dict):
        found.append(f"{name}: clamp: only STD has it for fields")
    flat = part.safe if isinstance(part.safe, tuple) else (part.safe,)
    if not all(isinstance(each, bool | int | float | str) for each in flat):
        kinds = "a number, a truth value, a text, or a flat tuple of them"
        found.append(f"{name}: safe: a command of MIN is {kinds}, not {part.safe!r}")
    if not found:
        try:
            loop = minimal.Loop(actuators=[part], rate=rate)
            loop.outputs[name].checked(part.safe)
        except Exception as error:
            found.append(f"{name}: safe or limits: {error!r}")
    return found


def _profile(part: Any, sensors: Sequence[Any], actuators: Sequence[Any]) -> list[str]:
    found: list[str] = []
    taken: list[str] = []
    written: list[str] = []
    guarded = 0
    for key, need in minimal.declared(part):
        where = f"{part.name}: {key}"
        is_read = hasattr(need, "max_age")
        kind, known = ("sensor", sensors) if is_read else ("actuator", actuators)
        name, names = need.name or key, [each.name for each in known]
        if name not in names:
            found.append(f"{where}: there is no {kind} {name!r}, only {names}")
        if getattr(need, "configure", False):
            found.append(f"{where}: configure: only STD has it")
        seconds = getattr(need, "max_age" if is_read else "hold", None)
        if seconds is not None:
            field = "max_age" if is_read else "hold"
            found += _duration(where, field, seconds, _LONGEST)
        if is_read:
            taken.append(key)
        elif hasattr(need, "latch"):
            guarded += 1
            taken.append(key)
        else:
            written.append(name)
    if guarded > 1 or (guarded and written):
        found.append(f"{part.name}: a guard has one port of guards(), and no writes()")
    if len(set(written)) < len(written):
        found.append(f"{part.name}: two ports for one actuator")
    if len(taken) == guarded and part.rate is None:
        found.append(f"{part.name}: rate: it reads nothing, so it needs one")
    return found + _parameters(part, taken)


def _parameters(part: Any, taken: list[str]) -> list[str]:
    """Tell whether ``react`` can be called with what it reads, by name."""
    try:
        signature = inspect.signature(part.react)
    except (TypeError, ValueError):
        return []
    kinds = {each.kind for each in signature.parameters.values()}
    if inspect.Parameter.VAR_KEYWORD in kinds and type(part).react in {
        minimal.Reaction.react
    }:
        return []  # it has no react: told already
    try:
        signature.bind(**dict.fromkeys(taken))
    except TypeError:
        names = list(signature.parameters)
        return [
            f"{part.name}: react: its parameters {names} must be its readings {taken}"
        ]
    return []
