"""The rover of ``esair demo``: its devices, its behaviors, and the show.

It pretends no hardware: what is behind its buses is `esair.sim`.
"""

from __future__ import annotations

from pathlib import Path

from esair.demo._devices import Bumper, Odometry, RangeFinder, Travel, Wheels
from esair.demo._journeys import Explore, Home
from esair.demo._mapper import Belief, Mapper
from esair.demo._reactions import Avoid, Bump
from esair.demo._values import Scan, Touch, Twist

__all__ = [
    "Avoid",
    "Belief",
    "Bump",
    "Bumper",
    "Explore",
    "Home",
    "Mapper",
    "Odometry",
    "RangeFinder",
    "Scan",
    "Touch",
    "Travel",
    "Twist",
    "Wheels",
    "demo",
]


def demo(
    *,
    fast: bool = False,
    seed: int = 0,
    out: Path | None = None,
    duration: float = 36.0,
    record: Path | None = None,
) -> int:
    """Let the rover explore an arena while things go wrong on purpose.

    Args:
        fast: Run on a virtual clock, with the wires in memory.
        seed: The same number gives the same run (with ``fast``, to the last command).
        out: Where the picture of the run goes (PNG); ``demo.png`` if None.
        duration: When the rover is called home at last, in seconds.
        record: Where every CAN frame is written to, in candump's format.

    Returns:
        The exit code: 0, or 130 after Ctrl-C.
    """
    from esair.demo._show import show

    return show(
        fast=fast,
        seed=seed,
        out=out or Path("demo.png"),
        duration=duration,
        record=record,
    )
