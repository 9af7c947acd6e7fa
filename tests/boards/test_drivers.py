"""The drivers for boards, on the stand-in for ``machine``."""

import sys

import pytest

import esair
from esair.boards import stand_in
from esair.boards.analog import AnalogIn
from esair.boards.digital import DigitalIn, DigitalOut
from esair.boards.i2c_register import I2CRegister
from esair.boards.servo import PwmServo
from esair.boards.uart import UartNumbers
from esair.boards.ultrasonic import UltrasonicRange
from esair.minimal import Actuator, Loop, Reaction, reads, writes
from esair.testing import FakeActuator


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    """A board without anything connected."""
    for each in ("inputs", "outputs", "analog", "echoes", "chips", "received"):
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


@pytest.mark.parametrize(
    ("pull", "level"), [("up", True), ("down", False), ("", False)]
)
def test_a_pull_holds_an_open_input(machine, pull, level) -> None:
    """Nothing is connected: the pull says what is read."""
    assert opened(DigitalIn(4, pull)).read() is level


def test_a_board_without_a_pull_down(machine, monkeypatch) -> None:
    """Its other pull works all the same."""
    monkeypatch.delattr(machine.Pin, "PULL_DOWN")

    assert opened(DigitalIn(4, "up")).read() is True
    with pytest.raises(AttributeError, match="PULL_DOWN"):
        opened(DigitalIn(4, "down"))


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


def test_a_servo_has_its_own_range_of_pulses(machine) -> None:
    """And what is outside -1.0 to 1.0 does not get to it."""
    servo = PwmServo(6, pulse_us=(500, 2500), name="servo")

    class Swing(Reaction):
        dial = reads(float)
        servo = writes(float)

        def react(self, dial: float) -> float:
            return dial

    loop = Loop([Swing()], [AnalogIn(26, 2.0, name="dial")], [servo])
    machine.analog[26] = 65535
    loop.step()  # 2.0: refused
    machine.analog[26] = 32767
    loop.step()
    loop.close()

    assert [each // 1000 for each in machine.outputs[6]] == [
        1500, 1500, 2499, 1500, 0,
    ]  # fmt: skip
    assert loop.faults == 1


def test_an_analog_input_gives_volts(machine) -> None:
    """Full scale is the reference, times the factor of the divider."""
    machine.analog[26] = 65535
    part = opened(AnalogIn(26, reference=3.3, factor=3.0))

    assert part.read() == pytest.approx(9.9)


def test_an_echo_is_a_distance(machine) -> None:
    """The sound goes there and back; out of reach is as far as it looks."""
    part = opened(UltrasonicRange(2, 3, reach=2.0))
    machine.echoes[3] = 5831
    assert part.read() == pytest.approx(1.0, abs=1e-3)

    machine.echoes[3] = 30000
    assert part.read() == 2.0
    assert machine.outputs[2] == [0, 1, 0, 1, 0]


@pytest.mark.virtual_clock
async def test_an_open_room_blinds_nobody(machine) -> None:
    """No echo is a reading like any other, in STD and in MIN: who reads it drives on."""
    machine.echoes[3] = 38000
    sonar, wheels = (
        UltrasonicRange(2, 3, name="sonar"),
        FakeActuator("wheels", safe=0.0),
    )

    class Cruise(Reaction):
        sonar = reads(float)
        wheels = writes(float)

        def react(self, sonar: float) -> float:
            return min(sonar, 1.0)

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Cruise()]) as robot:
        await wheels.until(1.0, timeout=1.0)
        assert robot.resources.query("sonar").faults == 0

    class Motor(Actuator):
        safe = 0.0
        told: tuple[float, ...] = ()

        def write(self, command: float) -> None:
            self.told += (command,)

    motor = Motor(name="wheels")
    sonar = UltrasonicRange(2, 3, name="sonar")
    loop = Loop([Cruise()], [sonar], [motor])
    loop.step()
    assert motor.told[-1] == 1.0
    assert loop.faults == 0


def test_an_old_pulse_is_not_taken_for_a_short_one(machine) -> None:
    """Without an echo the pin stays high for a while; nothing is measured meanwhile."""
    part = opened(UltrasonicRange(2, 3, reach=2.0))
    machine.echoes[3] = 38000
    assert part.read() == 2.0
    machine.inputs[3] = 1
    machine.echoes[3] = 1000  # what is left of the pulse
    assert part.read() == 2.0
    assert machine.outputs[2] == [0, 1, 0]  # it was not triggered again

    with pytest.raises(OSError, match="the echo pin is high"):
        part.read()  # it is stuck

    machine.inputs[3] = 0
    assert part.read() == pytest.approx(0.1715)


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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PwmServo(16, frequency=0), "pulse_us"),
        (lambda: PwmServo(16, frequency=500), "pulse_us"),
        (lambda: PwmServo(16, pulse_us=(-1, 2000)), "pulse_us"),
        (lambda: I2CRegister(0x148, 0), "address"),
        (lambda: I2CRegister(0x48, 0, size=0), "size"),
    ],
)
def test_what_no_part_can_do_is_refused(make, message) -> None:
    """Pulses longer than their period, an address of 8 bits, a number of no bytes."""
    with pytest.raises(ValueError, match=message):
        make()


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


def test_a_register_that_browned_out_is_set_up_again(machine) -> None:
    """What it was set up with is asked back, but for what says something else at once."""
    chip = machine.chips[0x48] = {}
    part = opened(I2CRegister(0x48, 0x10, setup=((0x01, 0x60), (0x02, 0x80))))
    assert part.is_set_up()
    chip[0x01] = 0
    assert not part.is_set_up()
    part.open()
    assert part.is_set_up()

    class Clears(dict[int, int]):
        """A bit that starts something is clear when it is asked."""

        def __setitem__(self, key: int, value: int) -> None:
            super().__setitem__(key, 0 if key == 0x02 else value)

    machine.chips[0x48] = Clears()
    part.open()
    assert part.is_set_up()


@pytest.mark.parametrize("before", [b"", b"1," * 200], ids=["opened", "overlong"])
def test_the_rest_of_a_line_is_no_line(machine, before) -> None:
    """The port was opened amid 0.35, or a line is too long: what is left of it is no 35."""
    line = opened(UartNumbers(1))
    machine.received[1] = b"\n" * bool(before) + before
    with pytest.raises(OSError, match="no line"):
        line.read()
    machine.received[1] = b"35\n"
    with pytest.raises(OSError, match="no line"):
        line.read()
    machine.received[1] = b"0.36\n0.3"

    assert line.read() == (0.36,)
    machine.received[1] = b"7\n"
    assert line.read() == (0.37,)
