"""Which parts of a robot fit into ESAIR MIN, and why the others do not."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import attrs

from esair.actions import Behavior, MinimalReaction, Reaction
from esair.config import Description, load, tables_of
from esair.firmware._mistakes import mistakes_in, wrong_rate
from esair.resources import Actuator, MinimalActuator, MinimalSensor, Resource, Sensor

Misfit = Callable[[str, str], None]

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
    """Return the parts that fit; tell about the others."""
    with path.open("rb") as file:
        tables = tomllib.load(file)
    for name in described.buses:
        misfit(
            f"bus.{name}",
            "MIN has no buses: write a plain Sensor or Actuator over machine, as those "
            "in esair.boards",
        )
    for name in described.policies:
        misfit(
            f"access.{name}",
            "MIN checks no rights: a reaction has the profile of its class",
        )
    parts = []
    for name, resource in described.resources.items():
        kind = "sensor" if isinstance(resource, Sensor) else "actuator"
        made: Any = resource
        if isinstance(resource, MinimalSensor | MinimalActuator):
            made = resource.device
        elif not isinstance(resource, Sensor | Actuator):
            continue
        table = tables[kind][name]
        if _is_plain(f"{kind}.{name}", resource, made, misfit):
            parts.append(Part(kind, name, made, _values(table)))
    for name, action in described.behaviors.items():
        key = f"behavior.{name}"
        table = tables["behavior"][name]
        for word in ("restart", "reads", "writes"):
            if word in table:
                misfit(f"{key}.{word}", "MIN has only what the class says")
        if isinstance(action, Behavior):
            misfit(key, "it is a behavior: MIN has reactions, and nothing that waits")
        elif isinstance(action, Reaction):
            whole = action.reaction if isinstance(action, MinimalReaction) else action
            parts.append(Part("behavior", name, whole, _values(table)))
    return parts


def _is_plain(key: str, resource: Any, made: Any, misfit: Misfit) -> bool:
    if resource.bus is not None:
        misfit(key, "it is on a bus of STD: MIN has devices over machine only")
        return False
    if isinstance(resource, Sensor) and resource.pushes:
        misfit(key, "it has a stream: MIN reads its sensors in each step")
        return False
    if getattr(resource, "max_repeat", None) is not None:
        misfit(key, "max_repeat: only STD watches for frozen values")
        return False
    for name in ("identify", "apply") if made is resource else ():
        if getattr(type(made), name) is not getattr(Resource, name):
            misfit(key, f"it has {name}: only STD calls it")
            return False
    return True


def _values(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in _NOT_ATTRIBUTES}


def loop_mistakes(parts: list[Part], rate: float, misfit: Misfit) -> None:
    """Tell what the loop itself would refuse."""
    if told := wrong_rate(rate):
        misfit("", f"loop: rate: {told}")
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
            told = (
                f"{key}: {pace / 1000:g} Hz does not divide the {rate:g} steps per second: "
                f"its turns come {steps} or {steps + 1} steps apart: take "
                f"{rate / round(every / pace):g} Hz"
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
