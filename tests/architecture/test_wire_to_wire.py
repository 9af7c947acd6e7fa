"""The way of one reading, from the bytes of a sensor to the command at a driver.

``pytest tests/architecture/test_wire_to_wire.py -s`` prints each call on the way, by turn.
"""

from __future__ import annotations

import asyncio
import os
import sys
import tty
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import pytest

import esair
from esair.buses import SerialBus
from esair.drivers.line import LineActuator, LineSensor
from esair.loop import TurnLoop, turn_of

ROOT = Path(esair.__file__).parent

CALLS = 63
"""How many calls of Python functions of esair lie between the two at most."""

FILES = 17
"""In how many files they are at most."""

TURNS = (2, 3)

BEGIN = "SerialBus._received"
"""What is called with the bytes."""


class Call(NamedTuple):
    """One call on the way."""

    turn: int
    file: str
    function: str


class Drive(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar / 2


class Wheels(LineActuator):
    """Tells when a command is at the driver; it goes to the wire then."""

    arrived: asyncio.Event

    async def write(self, command: float) -> float | None:
        if command:  # a busy machine's time-out has it told to be safe in between
            sys.setprofile(None)
            self.arrived.set()
        return await super().write(command)


async def way_of_a_reading() -> list[Call]:
    """Return the calls for one reading: the shortest way of ten.

    Beside some of them stands what comes now and then: a look at the computer's sleep, a
    stall of a busy machine.
    """
    board, port = os.openpty()
    tty.setraw(port)
    os.set_blocking(board, False)
    bus = SerialBus(name="line", port=os.ttyname(port))
    wheels = Wheels(name="wheels", bus=bus, safe=0.0)
    wheels.arrived = asyncio.Event()
    sonar = LineSensor(name="sonar", bus=bus, key="range")
    turn = turn_of(asyncio.get_running_loop())
    found: list[Call] = []
    ways: list[list[Call]] = []

    def see(frame: FrameType, event: str, _argument: object) -> None:
        file = Path(frame.f_code.co_filename)
        if event == "call" and file.is_relative_to(ROOT):
            name = str(file.relative_to(ROOT))
            found.append(Call(turn.number, name, frame.f_code.co_qualname))

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Drive()]):
        for number in range(10):
            await asyncio.sleep(0.03)
            found.clear()
            wheels.arrived.clear()
            os.write(board, f"range={0.5 + number}\n".encode())
            sys.setprofile(see)
            await asyncio.wait_for(wheels.arrived.wait(), 5.0)
            begin = next(i for i, each in enumerate(found) if each.function == BEGIN)
            ways.append(found[begin:])
    os.close(board)
    os.close(port)
    return min(ways, key=len)


@pytest.mark.real_clock
@pytest.mark.promise("TURN-7")
def test_a_reading_comes_to_the_driver_by_few_hands() -> None:
    """Counted on the loop that ships, from the bytes to the command at the driver."""
    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        way: list[Call] = runner.run(way_of_a_reading())
    files = {each.file for each in way}
    turns = way[-1].turn - way[0].turn + 1
    for each in way:
        print(f"{each.turn - way[0].turn + 1} {each.file:40} {each.function}")  # noqa: T201
    print(f"{len(way)} calls in {len(files)} files, {turns} turns")  # noqa: T201
    assert turns in TURNS
    assert len(way) <= CALLS
    assert len(files) <= FILES
