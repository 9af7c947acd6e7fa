"""The rover of ``esair demo``: its devices, its behaviors, and the show.

It pretends no hardware: what is behind its buses is `esair.sim`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.loading import late, of_extra

with of_extra("sim"):
    from esair.demo._devices import Bumper, Odometry, RangeFinder, Travel, Wheels
    from esair.demo._journeys import Charge, Explore, Home
    from esair.demo._mapper import Belief, Mapper
    from esair.demo._reactions import Avoid, Brake, Bump
    from esair.demo._values import Scan, Touch, Twist

if TYPE_CHECKING:
    from esair.demo._show import demo, repeat

__all__ = [
    "Avoid",
    "Belief",
    "Brake",
    "Bump",
    "Bumper",
    "Charge",
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

# What draws and prints is loaded by who looks.
__getattr__, _ = late(__name__, {"_show": "demo repeat"})
