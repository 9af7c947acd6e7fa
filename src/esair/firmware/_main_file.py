"""The file that a board starts: it makes the parts, wires them, and runs the loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from esair.exceptions import ConfigError
from esair.firmware._fit import Part


class Imports:
    def __init__(self) -> None:
        self._owners: dict[str, tuple[str, str]] = {}
        """The module of each name in the file, and what it is called there."""

    def add(self, module: str, name: str) -> str:
        """Return what a name of a module, or a class in a class, is called in the file."""
        first, dot, rest = name.partition(".")
        called, number = first, 1
        while self._owners.setdefault(called, (module, first)) != (module, first):
            number += 1
            called = f"{first}_{number}"
        return called + dot + rest

    def lines(self) -> list[str]:
        names: dict[str, list[str]] = {}
        for called, (module, name) in sorted(self._owners.items()):
            text = name if called == name else f"{name} as {called}"
            names.setdefault(module, []).append(text)
        return [
            f"from {module} import {', '.join(each)}"
            for module, each in sorted(names.items())
        ]


def main_file(
    source: str,
    parts: list[Part],
    keywords: Mapping[str, frozenset[str]],
    rate: float,
    watchdog: int,
    arm: str | int,
    link: bool,
) -> str:
    """Return the text of ``main.py``.

    Args:
        source: The file that the wiring comes from.
        parts: What is wired.
        keywords: Which keys of each part its constructor takes.
        rate: Steps per second.
        watchdog: The time-out of the hardware watchdog, in milliseconds; 0 for none.
        arm: As `esair.boards.start.Start` takes it.
        link: Whether it is a part of a robot on a computer.
    """
    imports = Imports()
    imports.add("esair.minimal", "Loop")
    start = imports.add("esair.boards.start", "Start")
    body = [line for part in parts for line in made(part, keywords, imports)]
    orders = ""
    if link:
        host = imports.add("esair.boards.link", "Host")
        body.append(f"_computer = {host}({imports.add('esair.boards.link', 'HOST')})")
        moved = "".join(
            f"{each.variable}, " for each in parts if each.kind == "actuator"
        )
        body.append(
            f"_host = {imports.add('esair.boards.link', 'from_host')}(({moved}))"
        )
        orders = f", {imports.add('esair.boards.link', 'Link')}, _host"
    body += ["", "_loop = Loop("]
    for word, kind in (
        ("reactions", "behavior"),
        ("sensors", "sensor"),
        ("actuators", "actuator"),
    ):
        names = ", ".join(part.variable for part in parts if part.kind == kind)
        if link and kind == "sensor":
            names += ", _computer" if names else "_computer"
        more = " + _host" if link and kind == "behavior" else ""
        body.append(f"    {word}=[{names}]{more},")
    devices = "".join(f"{each.variable}, " for each in parts if each.kind != "behavior")
    body += [
        f"    rate={rate:.10g},",
        "    armed=False,",
        ")",
        f"_loop.run(feed={start}(_loop, {arm!r}, {watchdog}, ({devices}){orders}))",
        "",
    ]
    first = f"# Made by `esair min build` from {source}: change that, and make it anew."
    return "\n".join([first, *imports.lines(), "", *body])


def made(
    part: Part, keywords: Mapping[str, frozenset[str]], imports: Imports
) -> list[str]:
    cls = type(part.made)
    taken = ", ".join(
        f"{key}={literal(value, part, key, imports)}"
        for key, value in part.table.items()
        if key in keywords[part.key]
    )
    this = part.variable
    lines = [f"{this} = {imports.add(cls.__module__, cls.__qualname__)}({taken})"]
    lines.append(f'{this}.name = "{part.name}"')
    lines += [
        f"{this}.{key} = {literal(getattr(part.made, key), part, key, imports)}"
        for key in part.table
        if key not in keywords[part.key]
    ]
    return lines


def literal(value: Any, part: Part, key: str, imports: Imports) -> str:
    """Write a value as Python, with the import that it needs.

    Raises:
        ConfigError: It is nothing that can be written.
    """

    def write(one: Any) -> str:
        if one is None or type(one) in {bool, int, float, str}:
            text = repr(one)
            return f'float("{text}")' if text[-3:] in {"inf", "nan"} else text
        if type(one) is list or type(one) is tuple:  # the file has no tuples
            inside = ", ".join(map(write, one))
            return f"({inside},)" if len(one) == 1 else f"({inside})"
        if type(one) is dict:
            pairs = (f"{write(each)}: {write(one[each])}" for each in one)
            return "{" + ", ".join(pairs) + "}"
        if isinstance(one, tuple) and hasattr(one, "_fields"):
            name = imports.add(type(one).__module__, type(one).__qualname__)
            return f"{name}({', '.join(map(write, one))})"
        raise ConfigError(
            part.key, key, f"MIN takes plain values from the file, not {one!r:.80}"
        )

    return write(value)
