"""A microcontroller of the robot: its table stands for a bus and each of its parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import attrs

from esair.actions import Reaction
from esair.config._draft import Draft, Part
from esair.config._mistakes import dotted
from esair.config._records import WORDS
from esair.config._source import Source, read_source
from esair.config._tables import named_tables
from esair.config._values import INVALID
from esair.exceptions import ConfigError
from esair.resources import Actuator, Sensor


@attrs.frozen
class _Board:
    """A table ``[board.NAME]``."""

    port: str = attrs.field(metadata={WORDS: "its serial port, as 'usb:2e8a:0005'"})
    robot: Path = attrs.field(
        metadata={WORDS: "the file that its firmware is built from, as 'base.toml'"}
    )
    baudrate: int | None = None
    arm: bool | None = None


_DRIVERS: Final = "esair.drivers.board"


def add_boards(source: Source, make: Callable[[Source], Draft]) -> None:
    """Write the tables that the boards of a file stand for.

    A board has a bus and a sensor (how it is) of its own name, and its sensors and
    actuators have the names of its own file. A table of such a name adds keys to it.
    """
    for name, table in named_tables(source, "board"):
        key = dotted("board", name)
        board = source.convert(table, _Board, key)
        if name in source.data.get("bus", {}):
            told = f"the board {name!r} has a bus of this name already"
            source.mistakes.add(dotted("bus", name), told)
        elif board is not INVALID:
            _add_board(source, name, board, make)


def _add_board(
    source: Source, name: str, board: _Board, make: Callable[[Source], Draft]
) -> None:
    where = dotted("board", name, "robot")
    try:
        inner = read_source(board.robot)
        parts = make(inner).parts
        inner.mistakes.raise_all()
    except ConfigError as error:
        source.mistakes.add(where, str(error))
        return
    except ExceptionGroup as group:
        for each in group.exceptions:
            source.mistakes.add(where, str(each))
        return
    bus: dict[str, Any] = {"type": "serial", "port": board.port, "framing": "cobs"}
    if board.baudrate is not None:
        bus["baudrate"] = board.baudrate
    source.data.setdefault("bus", {})[name] = bus
    source.mistakes.lines.put(dotted("bus", name), dotted("board", name))
    state: dict[str, Any] = {"driver": f"{_DRIVERS}:Board"}
    if board.arm is not None:
        state["arm"] = board.arm
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
