"""What the rulebook lets pass, and only a board cannot do."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

from esair import minimal

_FASTEST = 1000.0  # Hz: MIN counts whole milliseconds
_LONGEST = 2**29 / 1000  # seconds, half of what a board's counter holds
_METHODS = ("open", "close", "read", "write")

Mistakes = Iterator[tuple[str, str]]


def wrong_rate(rate: float) -> str | None:
    """Say what is wrong with the steps per second of a loop."""
    return next((told for _, told in _number("rate", rate, _FASTEST, "Hz")), None)


def mistakes_in(part: Any, rate: float) -> Mistakes:
    """Yield each field of a part that a board cannot do, and why.

    Args:
        part: A sensor, actuator or reaction that the rulebook has nothing against.
        rate: Steps per second of its loop.
    """
    for name in _METHODS:
        method = getattr(part, name, None)
        module = getattr(method, "__module__", None) or ""
        # Those of STD itself do nothing: they are left out, not refused.
        if not module.startswith("esair.") and (
            inspect.iscoroutinefunction(method) or inspect.isasyncgenfunction(method)
        ):
            yield name, "expected a plain method, not async"
    if hasattr(part, "write"):
        yield from _in_actuator(part, rate)
    elif part.rate is not None:
        yield from _number("rate", part.rate, rate, "Hz")
    if hasattr(part, "react"):
        yield from _in_ports(part)


def _number(field: str, value: Any, most: float, unit: str = "seconds") -> Mistakes:
    if not 0 < value <= most * 1.0001:
        yield field, f"expected {unit} > 0, at most {most:g}, not {value!r}"


def _in_actuator(part: Any, rate: float) -> Mistakes:
    found = [*_number("command_timeout", part.command_timeout, _LONGEST)]
    if part.command_timeout < 1.0 / rate:
        found.append(("command_timeout", "shorter than one step"))
    if getattr(part, "slew", None) is not None:
        found.append(("slew", "only STD has it"))
    if part.clamp and isinstance(part.limits, dict):
        found.append(("clamp", "only STD has it for fields"))
    flat = part.safe if isinstance(part.safe, tuple) else (part.safe,)
    if not all(isinstance(each, bool | int | float | str) for each in flat):
        kinds = "a number, a truth value, a text, or a flat tuple of them"
        found.append(("safe", f"a command of MIN is {kinds}, not {part.safe!r}"))
    yield from found
    if not found:
        try:
            loop = minimal.Loop(actuators=[part], rate=rate)
            loop.outputs[part.name].checked(part.safe)
        except Exception as error:
            yield "safe or limits", repr(error)


def _in_ports(part: Any) -> Mistakes:
    actuators: set[str] = set()
    for key, need in minimal.declared(part):
        if getattr(need, "configure", False):
            yield f"{key}.configure", "only STD has it"
        for field in ("max_age", "hold"):
            if (seconds := getattr(need, field, None)) is not None:
                yield from _number(f"{key}.{field}", seconds, _LONGEST)
        if not hasattr(need, "max_age"):
            if (name := need.name or key) in actuators:
                yield key, f"{name} has another port already"
            actuators.add(name)
