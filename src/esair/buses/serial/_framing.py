"""From what a configuration says about messages to the framing that cuts them out."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from esair.exceptions import ConfigError, did_you_mean, hint_for
from esair.framing import FRAMINGS, Cobs, Framing, Lines


def make_framing(owner: str, described: Framing | str | Mapping[str, Any]) -> Framing:
    """Return a new framing: from another one, a name, or a table with parameters."""
    if isinstance(described, Framing):
        return described.fresh()
    table = {"type": described} if isinstance(described, str) else described
    if not isinstance(table, Mapping):
        raise ConfigError(owner, "framing", f"expected {_names()}, not {table!r:.80}")
    if "type" not in table:
        raise ConfigError(owner, "framing", f"'type' is missing: expected {_names()}")
    name = table["type"]
    if not isinstance(name, str) or name not in FRAMINGS:
        hint = did_you_mean(str(name), FRAMINGS)
        raise ConfigError(
            owner, "framing", f"expected {_names()}, not {name!r:.80}{hint}"
        )
    framing: Any = FRAMINGS[name]
    parameters = {key: value for key, value in table.items() if key != "type"}
    known = list(inspect.signature(framing).parameters)
    for key in parameters:
        if key not in known:
            hint = hint_for(key, known, "it has")
            raise ConfigError(owner, "framing", f"{name} has no {key!r:.80}{hint}")
    try:
        made: Framing = framing(**parameters)
    except ConfigError as error:
        message = str(error).removeprefix(f"framing: {error.field}: ")
        raise ConfigError(owner, "framing", f"{error.field}: {message}") from error
    return made


def resync_bytes(framing: Framing) -> bytes:
    """Return what ends a message that was cut, where the framing has such a thing.

    Without it the other end takes the next message for the rest of the one before.
    """
    return framing.delimiter if isinstance(framing, Lines | Cobs) else b""


def _names() -> str:
    return "one of " + ", ".join(repr(name) for name in FRAMINGS)
