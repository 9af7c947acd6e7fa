"""No full garbage collection while a robot runs."""

from __future__ import annotations

import gc

_NEVER = 1_000_000

_robots = 0
_before: tuple[int, int, int] = (0, 0, 0)


def freeze_garbage() -> None:
    """Set aside all objects that live now, and collect only young ones from now on.

    A full collection stops the program for milliseconds; the youngest objects are
    still collected, which takes microseconds.
    """
    global _robots, _before
    if _robots == 0:
        _before = gc.get_threshold()
        gc.freeze()
        gc.set_threshold(_before[0], _before[1], _NEVER)
    _robots += 1


def unfreeze_garbage() -> None:
    """Undo `freeze_garbage` when the last robot has stopped."""
    global _robots
    _robots -= 1
    if _robots == 0:
        gc.set_threshold(*_before)
        gc.unfreeze()
