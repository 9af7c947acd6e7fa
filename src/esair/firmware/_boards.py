"""What is known about the boards that MIN is built for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import attrs


@attrs.frozen
class Board:
    """A kind of board with MicroPython.

    Attributes:
        name: What it is called.
        pins: The numbers of the pins that a program may use.
        inputs: Those of them that cannot be driven.
        memory: What MicroPython leaves free after its start, about, in kilobytes.
        watchdog: The longest time-out of its hardware watchdog, in seconds.
    """

    name: str
    pins: frozenset[int]
    inputs: frozenset[int]
    memory: int
    watchdog: float


def _numbers(*ranges: tuple[int, int]) -> frozenset[int]:
    return frozenset(n for first, last in ranges for n in range(first, last + 1))


_RP_PINS: Final = _numbers((0, 22), (25, 28))

_ALL: Final = (
    Board("pico", _RP_PINS, frozenset(), 190, 8.388),
    Board("pico2", _RP_PINS, frozenset(), 450, 8.388),
    # 6 to 11 are those of its flash.
    Board(
        "esp32",
        _numbers((0, 5), (12, 23), (25, 27), (32, 39)),
        _numbers((34, 39)),
        110,
        3600.0,
    ),
    # 26 to 32 are those of its flash, 33 to 37 of its larger memory.
    Board("esp32s3", _numbers((0, 21), (38, 48)), frozenset(), 200, 3600.0),
)

BOARDS: Final[Mapping[str, Board]] = {each.name: each for each in _ALL}
"""The boards that can be built for, by name."""
