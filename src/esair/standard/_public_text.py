"""What a robot's file says without what nobody may read in a recording."""

from __future__ import annotations

import datetime
import json
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any, Final

from esair.resources import Resource, settings_of

_TOKENS: Final = {"token"}
"""What of the page is for its user alone."""


def public_text(text: str, resources: Iterable[Resource]) -> str:
    """Return a robot.toml without the page's token and the values of secret settings.

    Comments are gone, too: a secret may stand in one. A setting whose value is not
    there has its default.

    Args:
        text: What the file says.
        resources: Those that were made of it.
    """
    try:
        data = tomllib.loads(text)
    except ValueError:
        return ""  # it has changed since, and nobody can tell what it says
    secrets = {
        each.name: {name for name, it in settings_of(type(each)).items() if it.secret}
        for each in resources
    }
    for kind in ("sensor", "actuator"):
        tables = data.get(kind)
        for name, table in tables.items() if isinstance(tables, dict) else ():
            _drop(table, secrets.get(name, set()))
    for table in (data, data.get("robot")):
        if isinstance(table, dict):
            _drop(table.get("page"), _TOKENS)
    return "".join(_lines(data, ()))


def _drop(table: Any, names: set[str]) -> None:
    """Take keys out of a table, and of those in it: the simulated part, say."""
    if not isinstance(table, dict):
        return
    for name in names:
        table.pop(name, None)
    for each in table.values():
        _drop(each, names)


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterable[str]:
    """Yield the lines of a table in TOML."""
    inner = {name: each for name, each in table.items() if isinstance(each, dict)}
    if path and (len(inner) < len(table) or not inner):
        yield f"[{'.'.join(map(_text, path))}]\n"
    for name, value in table.items():
        if name not in inner:
            yield f"{_text(name)} = {_value(value)}\n"
    for name, each in inner.items():
        yield from _lines(each, (*path, name))


def _value(value: Any) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_text(k)} = {_value(v)}' for k, v in value.items())}}}"
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return json.dumps(value).replace("Infinity", "inf").replace("NaN", "nan")


def _text(text: str) -> str:
    """Return a text as TOML has it: as JSON does, but for one character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
