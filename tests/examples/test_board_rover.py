"""The rover with its wheels on a board: an emulated 32-bit one, on a terminal."""

import asyncio
import os
import pty
import shutil
import subprocess
import sys
import tempfile
import tty
from pathlib import Path
from typing import Any

import pytest
from tests.minimal.hw.board import EMULATOR, FIRMWARE, why_not
from tests.minimal.test_link import until

import esair
from esair import firmware
from esair.boards import stand_in
from esair.config import build, load

pytestmark = [pytest.mark.long, pytest.mark.real_clock, pytest.mark.promise("MIN-4")]

EXAMPLE = Path(__file__).parents[2] / "examples" / "board_rover"

WORLD = """
import sys
from machine import mem32
from time import sleep_ms
from esair import minimal
from esair.boards import stand_in
sys.modules["machine"] = stand_in
from esair.boards import line
from esair.minimal import Loop

mem32[0x4002801c] = 24999

def ticks():
    "A counter of the board: the emulator leaves out ticks when its computer is busy."
    return mem32[0x40028018]

def sleep(ms):
    end = ticks() + ms
    while ticks() < end:
        sleep_ms(1)

minimal._ticks = ticks
minimal._sleep = sleep

came, read, takes, write = line._streams()
ring = bytearray()
one = bytearray(1)

def arrive():
    "A board's interrupts fill a buffer; the emulated port holds one byte."
    got = True
    while got and len(ring) < 256:
        got = False
        for _ in came(1):
            got = bool(read(one))
            ring.extend(one)

def buffered(_):
    return (0,) if ring else ()

def take(into):
    global ring
    into[0] = ring[0]
    ring = ring[1:]
    return 1

line._streams = lambda: (buffered, take, takes, write)

x = 0.0
turned = 0

def move():
    "The wheels turn the encoder; there is a wall at 0.2 m."
    global x, turned
    duty = [stand_in.outputs[pin][-1] for pin in (6, 7, 8, 9)]
    for each in stand_in.outputs.values():
        del each[:-1]
    x += (duty[0] - duty[1] + duty[2] - duty[3]) / 2 / 65535 * 0.5 * 0.02
    edges = int(x * 1000) - turned
    stand_in.turn(2, 3, edges)
    turned += edges
    stand_in.inputs[14] = 0 if x >= 0.2 else 1

stand_in.inputs.update({2: 0, 3: 0, 14: 1})
run = Loop.run

def run_in_world(loop, steps=None, feed=None):
    def fed():
        move()
        arrive()
        feed()
    run(loop, steps, fed)

Loop.run = run_in_world
import main
"""


class Emulated:
    """The board with the built folder in its flash, plugged in or not."""

    def __init__(self, folder: Path, image: Path) -> None:
        self.port = folder / "tty"
        self._image = image
        self._process: subprocess.Popen[bytes] | None = None
        self._ends: list[int] = []

    def plug(self) -> None:
        mine, other = pty.openpty()
        tty.setraw(mine)
        tty.setraw(other)
        self._ends = [mine, other]
        self._process = subprocess.Popen(
            [
                *(EMULATOR, "-machine", "mps2-an385", "-nographic", "-monitor", "none"),
                *("-semihosting", "-serial", "stdio", "-kernel", str(FIRMWARE)),
                *("-device", f"loader,file={self._image},addr=0x21000000"),
            ],
            stdin=mine,
            stdout=mine,
            stderr=subprocess.DEVNULL,
        )
        text = b""
        while not text.endswith(b">>> "):
            text += os.read(other, 1)
        os.write(other, b"import world\r")
        self.port.symlink_to(os.ttyname(other))

    def unplug(self) -> None:
        self.port.unlink(missing_ok=True)
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        for each in self._ends:
            os.close(each)
        self._ends = []


def image_of(folder: Path) -> Path:
    shutil.copy(stand_in.__file__, folder / "esair" / "boards" / "stand_in.py")
    (folder / "world.py").write_text(WORLD)
    shutil.rmtree(folder / "compiled", ignore_errors=True)
    image = folder.parent / "files.romfs"
    pack = [sys.executable, "-m", "mpremote", "romfs", "-o", str(image), "--no-mpy"]
    subprocess.run([*pack, "build", str(folder)], check=True, capture_output=True)
    return image


async def test_its_reflexes_are_on_the_board_and_it_comes_back(tmp_path) -> None:
    """It drives to the wall, backs off by itself, is unplugged, and drives again."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    example = tmp_path / "example"
    shutil.copytree(EXAMPLE, example)
    built = firmware.build(
        example / "base.toml", tmp_path / "built", board="pico", link=True, watchdog=2.0
    )
    assert built.trial is None or built.trial.pins.keys() == {2, 3, 6, 7, 8, 9, 14}
    with tempfile.TemporaryDirectory() as short:
        board = Emulated(Path(short), image_of(tmp_path / "built"))
        text = (example / "robot.toml").read_text()
        (example / "robot.toml").write_text(
            text.replace("usb:2e8a:0005", str(board.port))
        )
        board.plug()
        try:
            await drives(board, example / "robot.toml")
        finally:
            board.unplug()


async def drives(board: Emulated, file: Path) -> None:
    class Watch(esair.Behavior):
        encoder = esair.reads(object)
        path: list[float]

        async def run(self) -> None:
            self.path = []
            async for reading in self.encoder:
                self.path.append(float(str(reading)))

    described = load(file)
    explore: Any = described.behaviors["explore"]
    robot = build(described)
    watch = Watch()
    async with robot:
        await robot.behaviors.add(watch)
        await until(lambda: explore.touched >= 2, seconds=90.0)
        assert 0.19 < max(watch.path) < 0.25  # on the board: no delay of a computer
        wall = next(n for n, place in enumerate(watch.path) if place > 0.19)
        assert min(watch.path[wall:]) < 0.17
        board.unplug()
        query = robot.resources.query
        await until(lambda: query("encoder").state is not esair.ResourceState.READY)
        watch.path.clear()
        board.plug()
        await until(
            lambda: bool(watch.path) and watch.path[-1] > watch.path[0] + 0.02,
            seconds=90.0,
        )
        await asyncio.sleep(0)
