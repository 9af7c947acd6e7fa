"""The program of a board that is too small to wire a loop itself."""

# ruff: noqa: SLF001
# What a loop is made of is nobody else's business; here it is written down.

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from esair import minimal
from esair.firmware._fit import Part
from esair.firmware._main_file import Imports, literal, made

_NOTHING = (minimal._Device.open, minimal._Device.close)
_MADE_THERE = frozenset({"step", "_tasks"})


def wired_file(
    parts: list[Part],
    keywords: Mapping[str, frozenset[str]],
    rate: float,
) -> str:
    """Return a program that begins where an `esair.minimal.Loop` is ready to run.

    A loop is made here, with all checks, and what it is made of is written down.

    Args:
        parts: What is wired.
        keywords: Which keys of each part its constructor takes.
        rate: Steps per second.
    """
    imports = Imports(rename=False)  # a small board has one namespace
    imports.add("esair.minimal", "_Runner")
    reactions, sensors, actuators = (
        [part.made for part in parts if part.kind == kind]
        for kind in ("behavior", "sensor", "actuator")
    )
    loop = minimal.Loop(reactions, sensors, actuators, rate=rate)
    loop._opened = [
        each for each in loop._opened if getattr(each, "__func__", None) not in _NOTHING
    ]
    loop._closed = [each for each in loop._closed if type(each).close not in _NOTHING]
    state = {key: value for key, value in vars(loop).items() if key not in _MADE_THERE}
    nodes = [*loop._inputs, *loop._outputs, *loop._tasks]
    nodes += [port for task in loop._tasks for port in task.ports]
    names = {id(part.made): part.variable for part in parts}
    names |= {id(node): f"_{i}" for i, node in enumerate(nodes)}

    def written(value: Any) -> str:
        if id(value) in names:
            return names[id(value)]
        owner = names.get(id(getattr(value, "__self__", None)))
        if owner is not None:  # a bound method
            return f"{owner}.{value.__name__}"
        if isinstance(value, type):
            return value.__name__
        if type(value) in {tuple, list}:
            return f"({''.join(written(each) + ',' for each in value)})"
        return literal(value, parts[0], "", imports)

    def lines() -> Iterator[str]:
        yield "class _Node: pass"
        for part in parts:
            yield from made(part, keywords, imports)
        for node in nodes:
            yield f"{names[id(node)]} = _Node()"
        yield "loop = _Runner()"
        for name, thing in [
            *((names[id(each)], vars(each)) for each in nodes),
            ("loop", state),
        ]:
            for key, value in thing.items():
                yield f"{name}.{key} = {written(value)}"
        yield minimal.step_text(loop._inputs, loop._tasks, loop._paced, quick=False)
        given = [names[id(each)] for each in [*loop._inputs, *loop._tasks]]
        yield f"loop.step = make(loop, {', '.join(given)})"
        yield "loop.run()"

    body = "\n".join(lines())
    return "\n".join([*imports.lines(), body, ""])
