"""The drivers for boards on MicroPython, over simulated pins."""

import shutil
from pathlib import Path

import pytest

import esair.boards

USE = """
import sys
from esair.boards import stand_in
sys.modules["machine"] = stand_in
from esair.boards.analog import AnalogIn
from esair.boards.digital import DigitalIn, DigitalOut
from esair.boards.i2c_register import I2CRegister
from esair.boards.servo import PwmServo
from esair.boards.ultrasonic import UltrasonicRange

def opened(part):
    part.open()
    return part

stand_in.analog[26] = 65535
stand_in.chips[0x48] = {0x00: 0xFF, 0x01: 0xFE, 0x02: 0x34, 0x03: 0x12}
stand_in.echoes[3] = 10000
for part in (
    AnalogIn(26, 3.0),
    DigitalIn(4, "up"),
    DigitalIn(4, "up", True),
    I2CRegister(0x48, 0, setup=((0x10, 0x60),)),
    I2CRegister(0x48, 2, little=True, scale=0.5, scl=5, sda=4),
    UltrasonicRange(2, 3),
    UltrasonicRange(2, 3, reach=1.0),
):
    print(opened(part).read())
print(stand_in.chips[0x48][0x10])
try:
    opened(UltrasonicRange(8, 9)).read()
except OSError as error:
    print(error)
lamp, servo = opened(DigitalOut(5, True)), opened(PwmServo(6))
lamp.write(True)
servo.write(-1.0)
servo.close()
print(stand_in.outputs[5], stand_in.outputs[6])
"""


@pytest.mark.real_clock
@pytest.mark.promise("MIN-1")
def test_every_driver_runs_on_micropython(micropython, board) -> None:
    """The same files read and write the same."""
    shutil.copytree(
        Path(esair.boards.__file__).parent,
        board / "esair" / "boards",
        ignore=shutil.ignore_patterns("__pycache__"),
    )

    printed = micropython.run(board, USE).splitlines()

    assert printed == [
        "3.0",
        "True",
        "False",
        "-2.0",
        "2330.0",
        "1.715",
        "inf",
        "96",
        "no echo pulse began: is it connected?",
        "[1, 0] [1500000, 1000000, 0]",
    ]
