"""A microcontroller of the robot: its table stands for a bus and each of its parts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from esair.actions import Reaction
from esair.config._draft import Draft, Part
from esair.config._mistakes import dotted, show, unknown
from esair.config._source import Source, read_source
from esair.config._tables import named_tables
from esair.exceptions import ConfigError
from esair.resources import Actuator, Sensor

KEYS: Final = {"port": str, "robot": str, "baudrate": int, "arm": bool}
"""What a table ``[board.NAME]`` may say, and of which type."""

_DRIVERS: Final = "esair.drivers.board"


def add_boards(source: Source, make: Callable[[Source], Draft]) -> None:
    """Write the tables that the boards of a file stand for.

    A board has a bus and a sensor (how it is) of its own name, and its sensors and
    actuators have the names of its own file. A table of such a name adds keys to it.
    """
    for name, table in named_tables(source, "board"):
        if _is_sound(source, name, table):
            _add_board(source, name, table, make)


def _is_sound(source: Source, name: str, table: dict[str, Any]) -> bool:
    add, sound = source.mistakes.add, True
    for key, value in table.items():
        where = dotted("board", name, key)
        if key not in KEYS:
            add(where, unknown("key", key, KEYS))
        elif type(value) is not KEYS[key]:
            add(where, f"expected {_WORDS[KEYS[key]]}, not {show(value)}")
        else:
            continue
        sound = False
    for key, what in (
        ("port", "the serial port of the board, such as 'usb:2e8a:0005'"),
        ("robot", "the file that its firmware is built from, such as 'base.toml'"),
    ):
        if key not in table:
            add(dotted("board", name, key), f"expected {what}")
            sound = False
    if name in source.data.get("bus", {}):
        add(dotted("bus", name), f"the board {name!r} has a bus of this name already")
        sound = False
    return sound


_WORDS: Final = {str: "a string", int: "a whole number", bool: "true or false"}


def _add_board(
    source: Source, name: str, table: dict[str, Any], make: Callable[[Source], Draft]
) -> None:
    where = dotted("board", name, "robot")
    try:
        inner = read_source(source.folder / table["robot"])
        parts = make(inner).parts
        inner.mistakes.raise_all()
    except ConfigError as error:
        source.mistakes.add(where, str(error))
        return
    except ExceptionGroup as group:
        for each in group.exceptions:
            source.mistakes.add(where, str(each))
        return
    bus = {"type": "serial", "port": table["port"], "framing": "cobs"}
    if "baudrate" in table:
        bus["baudrate"] = table["baudrate"]
    source.data.setdefault("bus", {})[name] = bus
    source.mistakes.lines.put(dotted("bus", name), dotted("board", name))
    state = {"driver": f"{_DRIVERS}:Board"}
    if "arm" in table:
        state["arm"] = table["arm"]
    _add(source, "sensor", name, {**state, "bus": name}, name)
    for part in parts:
        found = _table_of(part, parts)
        if found is not None:
            _add(source, part.kind, part.name, {**found, "bus": name}, name)


def _table_of(part: Part, parts: list[Part]) -> dict[str, Any] | None:
    if isinstance(part.made, Sensor):
        return {"driver": f"{_DRIVERS}:BoardSensor"}
    if not isinstance(part.made, Actuator):
        return None
    actuator = part.made
    safe = actuator.safe
    return {
        "driver": f"{_DRIVERS}:BoardActuator",
        "safe": list(safe) if isinstance(safe, tuple) else safe,
        "command_timeout": actuator.command_timeout,
        "own_guards": [
            each.name
            for each in parts
            if isinstance(each.made, Reaction)
            and any(need.resource == part.name for need in each.made.needs.values())
        ],
    }


def _add(
    source: Source, kind: str, name: str, table: dict[str, Any], board: str
) -> None:
    source.mistakes.lines.put(dotted(kind, name), dotted("board", board))
    tables = source.data.setdefault(kind, {})
    given = tables.get(name, {})
    if not isinstance(given, dict):
        return  # told already
    if "driver" in given:
        source.mistakes.add(
            dotted(kind, name), f"the board has a {kind} of this name: take another"
        )
        return
    tables[name] = {**table, **given}
    source.implied.add(name)
