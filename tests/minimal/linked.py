"""A robot on a board: its files, and a MicroPython that runs it on a cable."""

import atexit
import functools
import shutil
import sys
import tempfile
import textwrap
from pathlib import Path
from typing import Any

from tests.minimal.cable import Cable

from esair import firmware

PARTS = """
from esair.minimal import Actuator, Reaction, Sensor, guards, reads, writes


def number(path):
    with open(path) as file:
        return float(file.read())


class Bumper(Sensor):
    def read(self):
        return number("bumper.txt") > 0


class Light(Sensor):
    rate = 10

    def read(self):
        return number("light.txt")


class Wheels(Actuator):
    safe = (0.0, 0.0)
    command_timeout = 0.3

    def write(self, command):
        with open("told.txt", "a") as file:
            file.write("%s %s\\n" % command)


class Avoid(Reaction):
    bumper = reads(bool)
    wheels = writes(tuple, priority=10)

    def react(self, bumper):
        return (-0.5, -0.5) if bumper else None


class Slow(Reaction):
    bumper = reads(bool)
    wheels = guards(tuple)

    def react(self, bumper, wheels):
        return tuple([max(-0.5, min(0.5, each)) for each in wheels])
"""

ROBOT = """
[sensor.bumper]
driver = "linked_parts:Bumper"
rate = 50
[sensor.light]
driver = "linked_parts:Light"
[actuator.wheels]
driver = "linked_parts:Wheels"
[behavior.avoid]
driver = "linked_parts:Avoid"
[behavior.slow]
driver = "linked_parts:Slow"
"""


class Plugged:
    """A board that runs a built folder, with its link, at the end of a cable."""

    def __init__(self, cable: Cable, files: Path) -> None:
        self.cable = cable
        self.folder = cable.folder
        self.port = cable.port
        shutil.copytree(files, self.folder, dirs_exist_ok=True)
        self.bump(False)
        (self.folder / "light.txt").write_text("0.5")
        (self.folder / "told.txt").write_text("")

    def plug(self) -> None:
        """Let the board start; its port appears."""
        (self.folder / "told.txt").write_text("")
        self.cable.power()

    def unplug(self) -> None:
        """Cut its power: the port is gone."""
        self.cable.power(on=False)

    def bump(self, yes: bool) -> None:
        """Press the bumper, or let it go."""
        (self.folder / "new.txt").write_text("1" if yes else "0")
        (self.folder / "new.txt").rename(self.folder / "bumper.txt")

    @property
    def told(self) -> list[tuple[float, ...]]:
        """What the wheels were told."""
        lines = (self.folder / "told.txt").read_text().splitlines()
        return [tuple(map(float, each.split())) for each in lines if each.count(" ")]


def built(folder: Path, **options: Any) -> Path:
    """Build the robot; the options are those of `firmware.build`."""
    sys.modules.pop("linked_parts", None)  # of another test
    once = _built_once(tuple(options.items()))
    sys.modules.pop("linked_parts", None)
    shutil.copytree(once, folder, dirs_exist_ok=True)
    return folder / "built"


@functools.cache
def _built_once(options: tuple[tuple[str, Any], ...]) -> Path:
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "linked_parts.py").write_text(textwrap.dedent(PARTS))
    (folder / "base.toml").write_text(ROBOT)
    firmware.build(folder / "base.toml", folder / "built", rate=50, **dict(options))
    return folder
