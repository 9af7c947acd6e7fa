"""A reaction on a really small board: a micro:bit with 9.5 KB of memory, in QEMU."""

import importlib.util
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from esair import firmware
from esair.exceptions import ConfigError

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-1", "MIN-2")]

LEFT, RIGHT, CABLE = 17, 26, 1
"""The ports of the inputs: of pin5, pin11 and pin2."""

PORT, STARBOARD = 3, 2
"""The ports of the outputs: of pin0 and pin1."""

PARTS = '''
"""Two light switches and two motors on the pins of a micro:bit."""

from esair.minimal import Actuator, Reaction, Sensor, reads, writes


class Eye(Sensor):
    """High in the light; its cable has a contact of its own."""

    def __init__(self, number: int) -> None:
        self.number = number

    def open(self) -> None:
        import microbit

        self.pin = getattr(microbit, "pin%d" % self.number)
        self.cable = microbit.pin2

    def read(self) -> int:
        if not self.cable.read_digital():
            raise OSError("unplugged")
        return self.pin.read_digital()


class Motor(Actuator):
    """On or off."""

    safe = 0

    def __init__(self, number: int) -> None:
        self.number = number

    def open(self) -> None:
        import microbit

        self.pin = getattr(microbit, "pin%d" % self.number)

    def write(self, command: int) -> None:
        self.pin.write_digital(command)


class Steer(Reaction):
    """Turn to the light: each eye drives the motor of the other side."""

    left = reads(int, max_age=0.1)
    right = reads(int, max_age=0.1)
    port = writes(int)
    starboard = writes(int)

    def react(self, left: int, right: int) -> "dict[str, int]":
        return {"port": right, "starboard": left}
'''

ROBOT = """
    [sensor.left]
    driver = "eyes_of_a_microbit:Eye"
    number = 5
    [sensor.right]
    driver = "eyes_of_a_microbit:Eye"
    number = 11
    [actuator.port]
    driver = "eyes_of_a_microbit:Motor"
    number = 0
    [actuator.starboard]
    driver = "eyes_of_a_microbit:Motor"
    number = 1
    [behavior.steer]
    driver = "eyes_of_a_microbit:Steer"
"""


def built(folder: Path, parts: str = PARTS) -> firmware.Built:
    pytest.importorskip("python_minifier")
    (folder / "eyes_of_a_microbit.py").write_text(parts)
    (folder / "robot.toml").write_text(textwrap.dedent(ROBOT))
    sys.modules.pop("eyes_of_a_microbit", None)
    return firmware.build(
        folder / "robot.toml", folder / "board", board="microbit", rate=100
    )


def harness():
    path = Path(__file__).parent / "hw" / "microbit.py"
    spec = importlib.util.spec_from_file_location("hw_microbit", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def copied(tmp_path_factory) -> Iterator:
    """A board with the program, in the dark."""
    hw = harness()
    if hw.missing():
        pytest.skip(hw.missing())
    folder = built(tmp_path_factory.mktemp("robot")).folder
    with hw.Microbit() as board:
        board.copy(folder)
        yield board


@pytest.fixture
def board(copied) -> Iterator:
    """The board with its program running, in the light, its motors on."""
    for pin in (LEFT, RIGHT, CABLE):
        copied.drive(pin, 1)
    copied.restart()
    assert copied.wait_for(lambda: motors(copied) == (1, 1)), copied.interrupt()
    yield copied
    if copied.running:
        copied.interrupt()


def motors(board) -> tuple[int, int]:
    return board.output(PORT), board.output(STARBOARD)


def test_it_decides_right(board) -> None:
    """Each combination of the two sensors moves the two actuators as it should."""
    for left, right in [(0, 0), (0, 1), (1, 0), (1, 1), (0, 0), (1, 1)]:
        board.drive(LEFT, left)
        board.drive(RIGHT, right)
        assert board.wait_for(lambda: motors(board) == (right, left))  # noqa: B023


def test_a_sensor_that_fails_stops_the_motors(board) -> None:
    """Both eyes see light, but give no reading: safe. They come back: on it goes."""
    board.drive(CABLE, 0)
    assert board.wait_for(lambda: motors(board) == (0, 0))
    board.drive(CABLE, 1)
    assert board.wait_for(lambda: motors(board) == (1, 1))

    assert "KeyboardInterrupt" in board.interrupt()
    name, error, faults = board.run(
        "print(loop.fault[0], loop.fault[1], loop.faults)"
    ).split()
    assert (name, error) in {("left", "unplugged"), ("right", "unplugged")}
    assert int(faults) >= 2


def test_the_end_of_the_program_stops_the_motors(board) -> None:
    """Ctrl-C: the motors have their safe command when the prompt is there."""
    assert motors(board) == (1, 1)
    assert "KeyboardInterrupt" in board.interrupt()
    assert motors(board) == (0, 0)


def test_the_end_of_the_steps_stops_the_motors(board) -> None:
    """So does the end of a run that was told how long to be."""
    board.interrupt()
    assert board.run("loop.run(20); print('end')") == "end\n"
    assert motors(board) == (0, 0)


MEASURE = """
from utime import ticks_us, ticks_diff
late, begin = loop.late, ticks_us()
loop.run(200)
print(ticks_diff(ticks_us(), begin), loop.late - late)
"""


def test_a_loop_of_10_ms_does_not_drift(board) -> None:
    """After 200 steps it is where 200 steps of 10 ms end; late ones are counted."""
    board.interrupt()
    for _ in range(3):  # QEMU may have to wait for its turn in the last step of a run
        microseconds, late = map(int, board.run(MEASURE).split())
        # The last step begins at 199 periods, and ends before the period does, or late.
        over = microseconds - (199 + late) * 10_000
        assert over >= 0
        if over < 30_000 and late < 200:  # most steps are in time
            return
    pytest.fail(f"{over} microseconds too long, {late} steps late")


def test_there_is_room_left(board) -> None:
    """A board that runs has a kilobyte for what the parts do."""
    board.interrupt()
    free = int(board.run("import gc; gc.collect(); print(gc.mem_free())"))
    assert free > 1000


MORE = '''

class Watch(Reaction):
    """Away from the dark; it goes before the others."""

    left = reads(int)
    port = writes(int, priority=5)

    def react(self, left: int) -> "int | None":
        return None if left else 1


class Rest(Reaction):
    """Slowly on."""

    rate = 20
    port = writes(int, priority=-1)

    def react(self) -> int:
        return 1
'''


def test_two_reactions_at_one_actuator_fit(tmp_path) -> None:
    """Priorities are what a small board has them for."""
    pytest.importorskip("python_minifier")
    (tmp_path / "two_of_a_microbit.py").write_text(PARTS + MORE)
    robot = textwrap.dedent(ROBOT).replace("eyes_of", "two_of")
    left, _, rest = robot.partition("[sensor.right]")
    port = rest[rest.index("[actuator.port]") : rest.index("[actuator.starboard]")]
    (tmp_path / "robot.toml").write_text(
        left
        + port
        + "[behavior.watch]\ndriver = 'two_of_a_microbit:Watch'\n"
        + "[behavior.rest]\ndriver = 'two_of_a_microbit:Rest'\n"
    )
    built = firmware.build(
        tmp_path / "robot.toml", tmp_path / "board", board="microbit", rate=100
    )
    assert built.files.keys() == {"main.py", "program.py"}


TOO_LONG = "def more(x):\n" + "    x += x * x\n" * 150 + "    return x\n"
TOO_MANY = "".join(
    f"def more_{i}(x):\n    return more(x) + more_{i + 1}(x) * {i}\n" for i in range(50)
)
TOO_MANY += "def more_50(x):\n    return x\nmore = more_0\n"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            TOO_LONG,
            r"more: stripped it has \d+ characters, .* compiles \d+ at once",
        ),
        (
            TOO_MANY,
            r"it has \d+ characters, .* takes \d+: esair.minimal \d+, .*main.py \d+",
        ),
    ],
)
def test_what_is_too_large_is_told(tmp_path, more, message) -> None:
    """The error says how large it is, how large it may be, and what takes the room."""
    parts = PARTS.replace("write_digital(command)", "write_digital(more(command))")
    parts = parts.replace("class Eye", f"{more}\n\nclass Eye")

    with pytest.raises(ConfigError, match=message):
        built(tmp_path, parts)
    assert not (tmp_path / "board").exists()


def test_what_its_language_lacks_is_told(tmp_path) -> None:
    """Its MicroPython is old: no f-strings, no walrus, no property, no async."""
    wrong = 'write_digital(int(f"{command}"))'

    with pytest.raises(ConfigError, match="Motor: a micro:bit knows no f-strings"):
        built(tmp_path, PARTS.replace("write_digital(command)", wrong))


def test_two_things_of_a_name_are_told(tmp_path) -> None:
    """All modules share one namespace there: the error names both."""
    (tmp_path / "beside_the_eyes.py").write_text("def _doubled(x):\n    return x + x\n")
    more = "import beside_the_eyes\n\n\ndef _doubled(x):\n    return x\n"
    parts = PARTS.replace("class Eye", f"{more}\n\nclass Eye").replace(
        "write_digital(command)",
        "write_digital(_doubled(beside_the_eyes._doubled(command)))",
    )

    with pytest.raises(ConfigError, match="has a '_doubled' too"):
        built(tmp_path, parts)
