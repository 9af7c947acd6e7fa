"""The file that a board starts: it makes the parts, wires them, and runs the loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from esair.exceptions import ConfigError
from esair.firmware._fit import Part


def main_file(
    source: str,
    parts: list[Part],
    keywords: Mapping[str, frozenset[str]],
    rate: float,
    watchdog: float | None,
) -> str:
    """Return the text of ``main.py``.

    Args:
        source: The file that the wiring comes from.
        parts: What is wired.
        keywords: Which keys of each part its constructor takes.
        rate: Steps per second.
        watchdog: The time-out of the hardware watchdog, in seconds.
    """
    imports: dict[str, set[str]] = {}
    body = []
    for part in parts:
        cls = type(part.made)
        imports.setdefault(cls.__module__, set()).add(cls.__qualname__)
        taken = ", ".join(
            f"{key}={_literal(value, part, key, imports)}"
            for key, value in part.table.items()
            if key in keywords[part.key]
        )
        body.append(f"{part.name} = {cls.__qualname__}({taken})")
        body.append(f'{part.name}.name = "{part.name}"')
        body += [
            f"{part.name}.{key} = {_literal(getattr(part.made, key), part, key, imports)}"
            for key in part.table
            if key not in keywords[part.key]
        ]
    lists = {
        word: ", ".join(part.name for part in parts if part.kind == kind)
        for word, kind in (
            ("reactions", "behavior"),
            ("sensors", "sensor"),
            ("actuators", "actuator"),
        )
    }
    feed = ""
    if watchdog is not None:
        imports.setdefault("machine", set()).add("WDT")
        feed = f"feed=WDT(timeout={round(watchdog * 1000)}).feed"
    lines = [f"# Made by `esair min build` from {source}: change that, and make it anew."]
    lines.append("from esair.minimal import Loop")
    lines += [
        f"from {module} import {', '.join(sorted(names))}"
        for module, names in sorted(imports.items())
    ]
    lines += ["", *body, "", "_loop = Loop("]
    lines += [f"    {word}=[{names}]," for word, names in lists.items()]
    lines += [f"    rate={rate:g},", ")", f"_loop.run({feed})", ""]
    return "\n".join(lines)


def _literal(
    value: Any, part: Part, key: str, imports: dict[str, set[str]]
) -> str:
    """Write a value as Python, with the import that it needs."""

    def write(one: Any) -> str:
        if one is None or type(one) in {bool, int, float, str}:
            return repr(one)
        if type(one) is list or type(one) is tuple:  # the file has no tuples
            inside = ", ".join(map(write, one))
            return f"({inside},)" if len(one) == 1 else f"({inside})"
        if type(one) is dict:
            pairs = (f"{write(each)}: {write(one[each])}" for each in one)
            return "{" + ", ".join(pairs) + "}"
        if isinstance(one, tuple) and hasattr(one, "_fields"):
            cls = type(one)
            imports.setdefault(cls.__module__, set()).add(cls.__qualname__)
            return f"{cls.__qualname__}({', '.join(map(write, one))})"
        raise ConfigError(
            part.key, key, f"MIN takes plain values from the file, not {one!r:.80}"
        )

    return write(value)
