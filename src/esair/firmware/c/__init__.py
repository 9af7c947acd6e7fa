"""Reactions on chips without Python: from a ``robot.toml`` to C99.

`build` translates the reactions of a robot, typed by their readings and commands, and puts
them on a core that decides as `esair.minimal` does. What cannot be translated is refused
with file, line and the way to write it.
"""

from esair.firmware.c._build import TARGETS, Translated, build

__all__ = ["TARGETS", "Translated", "build"]
