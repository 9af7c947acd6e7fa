"""The board of a linked world: it takes what has come and says something at each step.

It is imported by the tests, and copied to MicroPython as it is, where `serve` reads a world
and then, for each step, what has come over the line.
"""

# ruff: noqa: B905, RUF005, T201 - MicroPython's language; it prints what it says
# mypy: disable-error-code="import-not-found"

import json
import sys
from binascii import hexlify, unhexlify

import natural

from esair.boards import link
from esair.boards.line import Line
from esair.minimal import Loop


class Linked:
    """A board with the reactions of a world that live there, step by step."""

    def __init__(self, world):
        self.told = {}  # type: ignore[var-annotated]
        reactions, sensors, actuators = natural.make_parts(world, self.tell)
        here = [
            each
            for each, about in zip(reactions, world["reactions"])
            if not about.get("host")
        ]
        orders = link.from_host(tuple(actuators))
        sensors = sensors + [link.Host(link.HOST)]
        self.loop = Loop(here + orders, sensors, actuators, rate=natural.RATE)
        self.loop.say = str
        self.come, self.said = b"", b""
        streams = self.came, self.read, lambda _ms: (1,), self.write
        self.line = Line(streams=streams)
        self.link = link.Link(self.loop, orders, "power-on", False, self.line)

    def tell(self, name, command):
        self.told.setdefault(name, []).append([self.loop.now_ms, command])

    def came(self, _ms):
        return self.come[:1]

    def read(self, into):
        into[0] = self.come[0]
        self.come = self.come[1:]
        return 1

    def write(self, data, at, count):
        self.said += bytes(data[at : at + count])

    def step(self, data):
        """Make a step with what has come; return what is said."""
        self.come += data
        self.loop.step()
        self.link()
        self.line.flush()
        said, self.said = self.said, b""
        return said

    def end(self):
        """Return what each actuator was told, and when, in ms."""
        return self.told


def serve():
    """Play worlds: each a line of JSON, then a line for each step, then ``end``."""
    board = None
    while True:
        line = sys.stdin.readline().strip()
        if line[:1] == "{":
            board = Linked(json.loads(line))
        elif line == "end":
            print(json.dumps(board.end()))
        elif line[:1] == ":":
            print(":" + hexlify(board.step(unhexlify(line[1:]))).decode())
        else:
            return
