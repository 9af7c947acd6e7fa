"""The rover of ``esair demo``: its devices, its behaviors, and the show.

It pretends no hardware: what is behind its buses is `esair.sim`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from esair.demo._devices import Bumper, Odometry, RangeFinder, Travel, Wheels
from esair.demo._journeys import Explore, Home
from esair.demo._mapper import Belief, Mapper
from esair.demo._reactions import Avoid, Brake, Bump
from esair.demo._values import Scan, Touch, Twist

if TYPE_CHECKING:
    from esair.replay import Outcome, Replay

__all__ = [
    "Avoid",
    "Belief",
    "Brake",
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
    "repeat",
]


def repeat(recorded: Replay, *, seed: int, duration: float) -> Outcome:
    """Repeat a show that was recorded, for ``esair replay``; a fast one with its world.

    Args:
        recorded: The recording.
        seed: That of the show.
        duration: That of the show, in seconds.
    """
    from esair.demo._show import repeat as again

    return again(recorded, seed=seed, duration=duration)


def demo(
    *,
    fast: bool = False,
    seed: int = 0,
    out: Path | None = None,
    duration: float = 36.0,
    record: Path | None = None,
    kill: bool = False,
) -> int:
    """Let the rover explore an arena while things go wrong on purpose.

    Args:
        fast: Run on a virtual clock, with the wires in memory.
        seed: The same number gives the same run (with ``fast``, to the last command).
        out: Where the picture of the run goes (PNG); ``demo.png`` if None.
        duration: When the rover is called home at last, in seconds.
        record: Where the recording goes (MCAP); needs ``esair[record]``.
        kill: Instead of all that, kill a robot's process while it drives, and show when
            its wheels had their safe frame.

    Returns:
        The exit code: 0, 1 if something did not happen as it should, or 130 after
        Ctrl-C.
    """
    if kill:
        from rich.console import Console

        from esair.demo._kill import kill as show_a_death

        return show_a_death(Console(highlight=False))
    from esair.demo._show import show

    return show(
        fast=fast,
        seed=seed,
        out=out or Path("demo.png"),
        duration=duration,
        record=record,
    )
