"""Messages and signals of a DBC file, found by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools.database
from cantools.database.can import Database, Message, Signal

from esair.drivers._files import described
from esair.drivers.dbc._codec import MessageCodec
from esair.exceptions import ConfigError, hint_for


def find_message(component: str, database: Path | str, name: str) -> Message:
    """Return a message of a file.

    Raises:
        ConfigError: The file cannot be read, or has no such message.
    """
    path = Path(database)
    found: Any = described(component, "database", path, cantools.database.load_file)
    if not isinstance(found, Database):
        raise ConfigError(component, "database", f"{path} describes no CAN messages")
    by_name: dict[str, Message] = {each.name: each for each in found.messages}
    if name not in by_name:
        hint = hint_for(name, sorted(by_name))
        raise ConfigError(
            component, "message", f"{path.name} has no message {name!r}{hint}"
        )
    if by_name[name].is_container:
        raise ConfigError(component, "message", f"{name!r} is a container of messages")
    return by_name[name]


def find_signal(component: str, field: str, codec: MessageCodec, name: str) -> Signal:
    """Return a signal of a message.

    Raises:
        ConfigError: There is no such signal.
    """
    if name not in codec.signals:
        hint = hint_for(name, sorted(codec.signals))
        raise ConfigError(
            component, field, f"{codec.message.name} has no signal {name!r}{hint}"
        )
    return codec.signals[name]


def modulus_of(component: str, codec: MessageCodec, name: str | None) -> int:
    """Return where a signal that counts frames begins anew; 1 if there is none."""
    if name is None:
        return 1
    signal = find_signal(component, "sequence", codec, name)
    plain = (signal.scale, signal.offset) == (1, 0)
    if signal.is_float or signal.is_signed or not plain:
        raise ConfigError(
            component, "sequence", f"{name!r} is no unsigned whole number"
        )
    highest = (1 << signal.length) - 1
    return int(highest if signal.maximum is None else min(signal.maximum, highest)) + 1
