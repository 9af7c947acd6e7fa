"""The drivers for boards on MicroPython, over simulated pins."""

import shutil
from pathlib import Path

import pytest
from tests.boards import pio
from tests.minimal.hw.board import Board, why_not

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

import esair.boards.encoder as encoder_module
from esair.boards.encoder import QuadratureEncoder
from esair.boards.imu import Imu
from esair.boards.motor import HBridge, TwoWheels
from esair.boards.uart import UartNumbers

motor = opened(HBridge(10, 11))
for speed in (0.5, -1.0, 0.0):
    motor.write(speed)
motor.close()
print(stand_in.outputs[10], stand_in.outputs[11])
wheels = opened(TwoWheels((12, 13), (14, 15)))
wheels.write((1.0, -2.0))
print([stand_in.outputs[pin][-1] for pin in (12, 13, 14, 15)])

def turned():
    stand_in.inputs.update({20: 1, 21: 1})
    encoder = opened(QuadratureEncoder(20, 21, per_count=2))
    found = []
    for edges in (7, -10, 0, 300):
        stand_in.turn(20, 21, edges)
        found.append(encoder.read())
    encoder.close()
    stand_in.turn(20, 21, 4)
    print(type(encoder_of[0]).__name__, found, encoder.read())

encoder_of = []
count_with = encoder_module._counter
def seen(unit, a, b):
    encoder_of[:] = [count_with(unit, a, b)]
    return encoder_of[0]
encoder_module._counter = seen
turned()
import pio
sys.modules["rp2"] = pio
turned()
stand_in.Encoder = stand_in.HardwareEncoder
turned()
line = opened(UartNumbers(1))
stand_in.received[1] = b"1,2\\n3.5,-4\\n5"
print(line.read())
stand_in.received[1] = b",6\\n"
print(line.read())
try:
    line.read()
except OSError as error:
    print(error)
stand_in.chips[0x68] = {0x75: 0x68, 0x3B: 0x20, 0x43: 0xFF, 0x44: 0xBE}
imu = opened(Imu(scl=5, sda=4))
print([round(each, 3) for each in imu.read()], imu.is_set_up())
stand_in.chips[0x68][0x1B] = 0
print(imu.is_set_up())
try:
    opened(I2CRegister(0x68, 0, scl=5, sda=4, frequency=100000))
except ValueError as error:
    print(error)
"""

SAID = [
    "3.0",
    "True",
    "False",
    "-2.0",
    "2330.0",
    "1.715",
    "1.0",
    "96",
    "no echo pulse began: is it connected?",
    "[1, 0] [1500000, 1000000, 0]",
    "[0, 32767, 0, 0, 0, 0] [0, 0, 65535, 0, 0, 0]",
    "[65535, 0, 0, 65535]",
    "_PinCounter [14, -6, -6, 594] 594",
    "PioCounter [14, -6, -6, 594] 594",
    "HardwareEncoder [14, -6, -6, 594] 594",
    "(3.5, -4.0)",
    "(5.0, 6.0)",
    "no line has come",
    "[9.807, 0.0, 0.0, -0.018, 0.0, 0.0] True",
    "False",
    "frequency: the bus runs with 400000 Hz already",
]


def put_on(board: Path) -> None:
    """Copy the drivers, and what stands for ``rp2``."""
    shutil.copytree(
        Path(esair.boards.__file__).parent,
        board / "esair" / "boards",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    shutil.copy(pio.__file__, board)


@pytest.mark.real_clock
@pytest.mark.promise("MIN-1")
def test_every_driver_runs_on_micropython(micropython, board) -> None:
    """The same files read and write the same."""
    put_on(board)

    printed = micropython.run(board, USE).splitlines()

    assert printed == SAID


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-1")
def test_every_driver_runs_on_a_small_board(board) -> None:
    """With 32-bit words and single floats."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    put_on(board)
    with Board(board) as small:
        printed = small.run(USE).splitlines()

    assert printed == SAID
