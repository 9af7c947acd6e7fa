"""A robot on a board: its files, and a MicroPython that runs it on a pseudo-terminal."""

import os
import pty
import subprocess
import sys
import textwrap
import tty
from pathlib import Path

from esair import firmware
from esair.boards import stand_in

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

RUN = """
import sys
sys.path.append("esair/boards")
import stand_in
sys.modules["machine"] = stand_in
import main
"""


class Plugged:
    """The folder of a board, and a MicroPython that runs it on a pseudo-terminal."""

    def __init__(self, program: str, folder: Path) -> None:
        self._program = program
        self.folder = folder
        self.port = folder / "tty"
        self.process: subprocess.Popen[bytes] | None = None
        self._ends: list[int] = []

    def plug(self) -> None:
        """Let the board start; its port appears."""
        (self.folder / "told.txt").write_text("")
        mine, other = pty.openpty()
        tty.setraw(other)
        self._ends = [mine, other]
        self.process = subprocess.Popen(
            [self._program, "run.py"], cwd=self.folder, stdin=mine, stdout=mine
        )
        self.port.unlink(missing_ok=True)
        self.port.symlink_to(os.ttyname(other))

    def unplug(self) -> None:
        """Cut its power: the port is gone."""
        self.port.unlink(missing_ok=True)
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None
        for each in self._ends:
            os.close(each)
        self._ends = []

    def bump(self, yes: bool) -> None:
        """Press the bumper, or let it go."""
        (self.folder / "new.txt").write_text("1" if yes else "0")
        (self.folder / "new.txt").rename(self.folder / "bumper.txt")

    @property
    def told(self) -> list[tuple[float, ...]]:
        """What the wheels were told."""
        lines = (self.folder / "told.txt").read_text().splitlines()
        return [tuple(map(float, each.split())) for each in lines if each.count(" ")]


def built(folder: Path, *, link: bool = False, arm: str = "host") -> Path:
    sys.modules.pop("linked_parts", None)  # of another test
    (folder / "linked_parts.py").write_text(textwrap.dedent(PARTS))
    (folder / "base.toml").write_text(ROBOT)
    firmware.build(folder / "base.toml", folder / "built", rate=50, link=link, arm=arm)
    return folder / "built"


def plug_in(program: str, folder: Path) -> Plugged:
    """Build the robot in a folder, with its link, and let it start."""
    there = built(folder, link=True)
    board = Plugged(program, there)
    board.bump(False)
    (there / "light.txt").write_text("0.5")
    (there / "esair" / "boards" / "stand_in.py").write_text(
        Path(stand_in.__file__).read_text()
    )
    (there / "run.py").write_text(RUN)
    board.plug()
    return board
