"""Which parts of a robot fit into ESAIR MIN, and why the others do not."""

from __future__ import annotations

import inspect
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import attrs

from esair import minimal
from esair.actions import Behavior, MinimalReaction, Reaction
from esair.config import Description, load, tables_of
from esair.resources import Actuator, MinimalActuator, MinimalSensor, Sensor

Misfit = Callable[[str, str], None]
Mistakes = Iterator[tuple[str, str]]

_FASTEST = 1000.0  # Hz: MIN counts whole milliseconds
_LONGEST = 2**29 / 1000  # seconds, half of what a board's counter holds
_METHODS = ("open", "close", "read", "write")
_NOT_ATTRIBUTES = frozenset({"driver", "sim", "bus", "restart", "reads", "writes"})


@attrs.frozen
class Part:
    """A component that fits.

    Attributes:
        kind: ``sensor``, ``actuator`` or ``behavior``, as the table in the file.
        name: Its name.
        made: It, as `esair.minimal.Loop` takes it.
        table: What the file says about it.
    """

    kind: str
    name: str
    made: Any
    table: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Where it is in the file."""
        return f"{self.kind}.{self.name}"

    @property
    def variable(self) -> str:
        """What it is called in a program: no keyword, and no other name."""
        return f"{self.kind}_{self.name}"


def fitting_parts(path: Path, described: Description, misfit: Misfit) -> list[Part]:
    with path.open("rb") as file:
        tables = tomllib.load(file)
    told = (
        "MIN has no buses: write a plain Sensor or Actuator over machine, as those in "
    )
    for name in described.buses:
        misfit(f"bus.{name}", told + "esair.boards")
    told = "MIN checks no rights: a reaction has the profile of its class"
    for name in described.policies:
        misfit(f"access.{name}", told)
    for name in described.robot.get("modes", ()):
        misfit(f"mode.{name}", "MIN has no modes: all reactions run, always")
    parts = []
    for name, resource in described.resources.items():
        kind = "sensor" if isinstance(resource, Sensor) else "actuator"
        made: Any = resource
        if isinstance(resource, MinimalSensor | MinimalActuator):
            made = resource.device
        elif not isinstance(resource, Sensor | Actuator):
            continue
        table = tables[kind][name]
        part = Part(kind, name, made, _values(table))
        if told := next(_of_std(resource, made), ""):
            misfit(part.key, told)
        else:
            parts.append(part)
    for name, action in described.behaviors.items():
        key = f"behavior.{name}"
        table = tables["behavior"][name]
        for word in ("restart", "reads", "writes", "guards"):
            if word in table:
                misfit(f"{key}.{word}", "MIN has only what the class says")
        if isinstance(action, Behavior):
            misfit(key, "it is a behavior: MIN has reactions, and nothing that waits")
        elif isinstance(action, Reaction):
            whole = action.reaction if isinstance(action, MinimalReaction) else action
            parts.append(Part("behavior", name, whole, _values(table)))
    return parts


def _of_std(resource: Any, made: Any) -> Iterator[str]:
    """Yield what of a device only STD has."""
    base: Any = Sensor if isinstance(resource, Sensor) else Actuator
    if resource.bus is not None:
        yield "it is on a bus of STD: MIN has devices over machine only"
    if base is Sensor and resource.pushes:
        yield "it has a stream: MIN reads its sensors in each step"
    for word in ("max_repeat", "limits") if base is Sensor else ("safe_moves",):
        if getattr(resource, word, None):
            yield f"{word}: only STD has it"
    for name in ("identify", "apply", "check") if made is resource else ():
        has = getattr(type(made), name, None)
        if hasattr(base, name) and has is not getattr(base, name):
            yield f"it has {name}: only STD calls it"


def _values(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in _NOT_ATTRIBUTES}


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
    elif round(value * 1000) == 0:
        yield field, f"expected {unit} >= 0.001, as MIN counts them, not {value!r}"


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


def loop_mistakes(parts: list[Part], rate: float, misfit: Misfit) -> None:
    """Tell what the loop itself would refuse."""
    for field, told in _number("rate", rate, _FASTEST, "Hz"):
        misfit("", f"loop: {field}: {told}")
        return
    for part in parts:
        if part.made.name != part.name:  # the file's name is what its adapter has
            part.made.name = part.name
        for field, told in mistakes_in(part.made, rate):
            misfit(part.key, f"{field}: {told}")


def rate_of(parts: list[Part]) -> float:
    """Return the steps per second that the parts ask for; 50 if they do not."""
    rates = [part.made.rate for part in parts if getattr(part.made, "rate", None)]
    return float(max(rates, default=50.0))


def uneven_rates(parts: list[Part], rate: float) -> Iterator[str]:
    """Yield what is to be said of each rate that does not divide that of the loop.

    A part of such a rate has its turns now more, now fewer steps apart, and decides
    otherwise than in STD.
    """
    every = round(rate * 1000)
    paces = {
        part.key: round(part.made.rate * 1000)
        for part in parts
        if getattr(part.made, "rate", None) and part.made.rate < rate
    }
    common = math.lcm(every, *paces.values()) / 1000
    for key, pace in paces.items():
        if every % pace:
            steps = every // pace
            even = [each for each in range(1, every + 1) if every % each == 0]
            told = (
                f"{key}: {pace / 1000:g} Hz does not divide the {rate:g} steps per second: "
                f"its turns come {steps} or {steps + 1} steps apart: take "
                f"{min(even, key=lambda each: abs(each - pace)) / 1000:g} Hz"
            )
            yield told + (f", or --rate {common:g}" if common <= 1000 else "")


def uneven_on_boards(path: Path) -> Iterator[str]:
    """Yield the same for each board of a robot.toml, at the rate that it is built for.

    What is wrong with its file is not told here.
    """
    for name, table in tables_of(path).get("board", {}).items():
        inner = Path(table["robot"])
        inner = inner if inner.is_absolute() else path.parent / inner
        parts = fitting_parts(inner, load(inner), lambda _key, _reason: None)
        for told in uneven_rates(parts, rate_of(parts)):
            yield f"board.{name}: {told}"
