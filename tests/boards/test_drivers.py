"""The drivers for boards, on the stand-in for ``machine``."""

import math
import sys

import pytest

from esair.boards import stand_in
from esair.boards.analog import AnalogIn
from esair.boards.digital import DigitalIn, DigitalOut
from esair.boards.i2c_register import I2CRegister
from esair.boards.servo import PwmServo
from esair.boards.ultrasonic import UltrasonicRange
from esair.minimal import Loop, Reaction, reads, writes


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    """A board without anything connected."""
    for each in ("inputs", "outputs", "analog", "echoes", "chips"):
        monkeypatch.setattr(stand_in, each, {})
    monkeypatch.setitem(sys.modules, "machine", stand_in)
    return stand_in


def opened(part):
    part.open()
    return part


@pytest.mark.parametrize(("level", "inverted"), [(0, False), (1, True)])
def test_a_digital_input_is_false(machine, level, inverted) -> None:
    """Low, or high if it is inverted."""
    machine.inputs[4] = level
    part = opened(DigitalIn(4, "up", inverted))

    assert part.read() is False
    machine.inputs[4] = 1 - level
    assert part.read() is True


def test_a_wrong_pull_is_refused() -> None:
    """There are two."""
    with pytest.raises(ValueError, match="'up', 'down'"):
        DigitalIn(4, "sideways")


@pytest.mark.parametrize(
    ("options", "levels"),
    [
        ({}, [0, 1, 0]),
        ({"inverted": True}, [1, 0, 1]),
        ({"inverted": True, "safe": True}, [0, 0, 1]),
    ],
)
def test_a_digital_output_begins_safe(machine, options, levels) -> None:
    """The first level is that of the safe command, without a moment of another."""
    part = opened(DigitalOut(5, **options))
    part.write(True)
    part.write(False)

    assert machine.outputs[5] == levels


def test_a_servo_goes_where_it_is_told(machine) -> None:
    """Pulses of 1 to 2 ms; it begins at the safe position, closed it gets none."""
    part = opened(PwmServo(6, safe=0.5))
    for position in (-1.0, 0.0, 1.0):
        part.write(position)
    part.close()

    assert machine.outputs[6] == [1750000, 1000000, 1500000, 2000000, 0]


def test_an_analog_input_gives_volts(machine) -> None:
    """Full scale is the reference, times the factor of the divider."""
    machine.analog[26] = 65535
    part = opened(AnalogIn(26, reference=3.3, factor=3.0))

    assert part.read() == pytest.approx(9.9)


def test_an_echo_is_a_distance(machine) -> None:
    """The sound goes there and back; out of reach is infinite."""
    part = opened(UltrasonicRange(2, 3, reach=2.0))
    machine.echoes[3] = 5831
    assert part.read() == pytest.approx(1.0, abs=1e-3)

    machine.echoes[3] = 30000
    assert part.read() == math.inf
    assert machine.outputs[2] == [0, 1, 0, 1, 0]


def test_a_range_finder_that_is_not_there_raises(machine) -> None:
    """No pulse begins."""
    part = opened(UltrasonicRange(2, 3))

    with pytest.raises(OSError, match="no echo pulse began"):
        part.read()


@pytest.mark.parametrize(
    ("options", "data", "value"),
    [
        ({}, b"\xff\xfe", -2.0),
        ({"signed": False}, b"\xff\xfe", 65534.0),
        ({"little": True}, b"\x01\x02", 513.0),
        ({"size": 1, "scale": 0.5, "offset": 10.0}, b"\x04", 12.0),
        ({"size": 3, "scl": 5, "sda": 4}, b"\x00\x01\x00", 256.0),
    ],
)
def test_a_register_is_a_number(machine, options, data, value) -> None:
    """Any size and order, signed or not, scaled."""
    machine.chips[0x48] = dict(enumerate(data, 0x10))
    part = opened(I2CRegister(0x48, 0x10, setup=((0x01, 0x60),), **options))

    assert part.read() == value
    assert machine.chips[0x48][0x01] == 0x60


def test_an_i2c_part_that_is_gone_raises(machine) -> None:
    """The error is the bus's; the loop takes it as no reading."""
    machine.chips[0x48] = {}
    part = opened(I2CRegister(0x48, 0x10))
    del machine.chips[0x48]

    with pytest.raises(OSError, match="19"):
        part.read()


@pytest.mark.promise("MIN-1")
def test_a_reflex_over_pins(machine) -> None:
    """A button lights a lamp; at the end the lamp is dark."""

    class Light(Reaction):
        button = reads(bool)
        lamp = writes(bool)

        def react(self, button: bool) -> bool:
            return button

    loop = Loop(
        [Light()],
        [DigitalIn(1, "up", inverted=True, name="button")],
        [DigitalOut(2, name="lamp")],
    )
    machine.inputs[1] = 0
    loop.step()
    assert machine.outputs[2][-1] == 1
    loop.close()

    assert machine.outputs[2][-1] == 0
    assert loop.faults == 0
