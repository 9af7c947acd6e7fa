"""``[board.NAME]``: a microcontroller in a robot.toml, and its program put on it."""

import contextlib
import os
import pty
import struct
import threading
import time
import tty
from collections.abc import Iterator

import pytest
from tests.minimal.linked import built
from tests.minimal.test_link import last, until

import esair
from esair import firmware
from esair.boards import link
from esair.config import check, load
from esair.drivers.board import wire
from esair.exceptions import ConfigError

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-4", "MIN-5")]

EXPLORE = """
import esair


class Explore(esair.Behavior):
    wheels = esair.writes(tuple)
    bumper = esair.reads(object)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write((1.0, 0.25))
"""

HOST = """
[board.base]
port = "{port}"
robot = "base.toml"

[behavior.explore]
driver = "roaming:Explore"
"""


async def test_a_table_makes_the_board_a_part_of_the_robot(
    plugged, tmp_path, way
) -> None:
    """Its sensors and actuators by their names; unplugged, and back."""
    board = plugged
    name = f"roaming_{way.replace(' ', '_')}"  # one of each name a process
    (tmp_path / f"{name}.py").write_text(EXPLORE)
    host = HOST.format(port=board.port).replace("roaming", name)
    (tmp_path / "robot.toml").write_text(host)
    robot = esair.Robot.from_config(tmp_path / "robot.toml")
    async with robot:
        await until(lambda: last(board) == (0.5, 0.25))
        board.bump(True)
        await until(lambda: last(board) == (-0.5, -0.5))
        board.bump(False)
        await until(lambda: last(board) == (0.5, 0.25))
        board.unplug()
        wheels = robot.resources.query
        await until(lambda: wheels("wheels").state is not esair.ResourceState.READY)
        board.plug()
        await until(lambda: last(board) == (0.5, 0.25), seconds=20.0)
    await until(lambda: last(board) == (0.0, 0.0))


def test_what_a_table_stands_for(tmp_path) -> None:
    """A bus and a state of its name, each part, and keys that are added to one."""
    built(tmp_path)
    (tmp_path / "robot.toml").write_text(
        '[board.base]\nport = "/dev/ttyACM0"\nrobot = "base.toml"\n'
        "[actuator.wheels]\ncommand_timeout = 0.25\n"
    )
    described = load(tmp_path / "robot.toml")

    assert set(described.buses) == {"base"}
    assert set(described.resources) == {"base", "bumper", "light", "wheels"}
    wheels = described.resources["wheels"]
    assert isinstance(wheels, esair.Actuator)
    assert wheels.safe == (0.0, 0.0)
    assert wheels.command_timeout == 0.25
    assert wheels.own_guards == ("avoid", "slow")


def test_what_stays_on_the_board_is_in_the_table_of_safety(tmp_path) -> None:
    """Its guard and its reaction protect the wheels; nobody here has to read the rest."""
    built(tmp_path)
    (tmp_path / "roaming.py").write_text(EXPLORE)
    (tmp_path / "robot.toml").write_text(HOST.format(port="/dev/ttyACM0"))
    report = check(tmp_path / "robot.toml")

    (wheels,) = report.actuators
    assert [each.reaction for each in wheels.guards] == ["avoid", "slow"]
    assert not [each for each in report.findings if each.rule in {"protect", "unused"}]


def test_what_a_board_stands_for_has_its_line(tmp_path) -> None:
    """The bus of its name is in no line of the file."""
    built(tmp_path)
    (tmp_path / "robot.toml").write_text(
        '\n\n[board.base]\nport = ""\nrobot = "base.toml"\n'
        '[actuator.wheels]\nown_guards = "slow"\n'
    )
    found = {each.key: each.line for each in check(tmp_path / "robot.toml").findings}

    assert found["actuator.wheels.own_guards"] == 7
    assert {line for key, line in found.items() if "base" in key} == {3}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[board.base]\nrobot = "base.toml"', "'port' is missing: expected its serial"),
        ('[board.base]\nport = "x"', "'robot' is missing: expected the file"),
        (
            '[board.base]\nport = 3\nrobot = "base.toml"',
            "board.base.port: expected a string, not 3",
        ),
        (
            '[board.base]\nport = "x"\nrobot = "gone.toml"',
            "gone.toml: there is no such file",
        ),
        (
            '[board.base]\nport = "x"\nrobot = "base.toml"\n'
            '[board.arm]\nport = "x"\nrobot = "base.toml"',
            "board.arm.port: 'x' is the port of the bus 'base' already",
        ),
        (
            '[bus.gps]\ntype = "serial"\nport = "x"\nframing = "lines"\n'
            '[board.base]\nport = "x"\nrobot = "base.toml"',
            "board.base.port: 'x' is the port of the bus 'gps' already",
        ),
        (
            '[board.base]\nport = "x"\nrobot = "base.toml"\nbaud = 3',
            "there is no such key",
        ),
        (
            '[board.base]\nport = "x"\nrobot = "base.toml"\n'
            '[sensor.bumper]\ndriver = "linked_parts:Bumper"',
            "the board has a sensor of this name",
        ),
    ],
)
def test_mistakes_in_a_table_are_told(tmp_path, text, message) -> None:
    """With the key, and what was expected."""
    built(tmp_path)
    (tmp_path / "robot.toml").write_text(text + "\n")

    with pytest.raises(ExceptionGroup) as caught:
        load(tmp_path / "robot.toml")
    assert message in " ".join(map(str, caught.value.exceptions))


@pytest.mark.long
def test_a_folder_is_put_on_a_board_and_again(machine, tmp_path, capsys) -> None:
    """Copied, compared, reset, ready; a program that runs there is stopped first."""
    from esair.cli import main

    folder = built(tmp_path)
    (machine.folder / "bumper.txt").write_text("0")
    for _ in range(2):
        with pytest.raises(SystemExit) as ended:
            main(["min", "deploy", str(folder), "--port", machine.port])
        said = capsys.readouterr().out
        assert not ended.value.code, said
        assert "are on the board: esair: ready, soft reset, not armed" in said
        slot = machine.folder / machine.slot
        assert (slot / "main.py").read_text() == (folder / "main.py").read_text()
        assert (slot / "esair" / "minimal.mpy").is_file()


@pytest.mark.long
def test_a_program_that_moves_is_made_safe_before_the_next_one(
    machine, tmp_path
) -> None:
    """It listens to nobody: Ctrl-C ends it, and its last command is the safe one."""
    folder, second = built(tmp_path, arm="always"), tmp_path / "second"
    second.mkdir()
    (second / "main.py").write_text("print('esair: ready, and moves nothing')\n")
    (machine.folder / "bumper.txt").write_text("1")
    done = firmware.deploy(folder, port=machine.port)
    assert done.ready == "esair: ready, soft reset, armed"
    told = machine.folder / "told.txt"
    while not told.exists() or "-0.5 -0.5\n" not in told.read_text():
        time.sleep(0.02)  # it moves a moment later
    done = firmware.deploy(second, port=machine.port)
    assert done.ready == "esair: ready, and moves nothing"
    assert told.read_text().endswith("-0.5 -0.5\n0.0 0.0\n")


@pytest.mark.long
def test_a_linked_board_is_stopped_and_watched(linked_machine, tmp_path) -> None:
    """It takes no Ctrl-C, but the word of the link; its beats are told in words."""
    machine = linked_machine
    folder = built(tmp_path, link=True)
    for name in ("bumper.txt", "light.txt"):
        (machine.folder / name).write_text("0")
    for _ in range(2):
        done = firmware.deploy(folder, port=machine.port)
        assert done.ready.startswith("esair: ready, soft reset")
    told: list[object] = []
    firmware.monitor(machine.port, told.append, seconds=2.0)
    (machine.folder / "bumper.txt").unlink()
    firmware.monitor(machine.port, told.append, seconds=1.0)

    text = "\n".join(map(str, told))
    assert "esair: started by soft reset, not armed, " in text
    assert "last: bumper: OSError" in text


def test_without_a_board_it_is_said_so(tmp_path) -> None:
    """No port, no folder, nobody who answers."""
    (tmp_path / "main.py").write_text("")
    with pytest.raises(ConfigError, match="there is no /dev/ttyACM99"):
        firmware.deploy(tmp_path, port="/dev/ttyACM99")
    with pytest.raises(ConfigError, match="there is no main"):
        firmware.deploy(tmp_path / "gone", port="/dev/ttyACM99")
    with pytest.raises(ConfigError, match="there is no /dev/ttyACM99"):
        firmware.monitor("/dev/ttyACM99", print)


def test_a_board_whose_rates_do_not_fit_is_told_by_check(
    tmp_path, capsys, monkeypatch
) -> None:
    """At the rate that it is built for: its fastest."""
    from esair.cli import main

    monkeypatch.setenv("COLUMNS", "300")  # each finding in one line

    built(tmp_path)
    text = (tmp_path / "base.toml").read_text()
    (tmp_path / "base.toml").write_text(text.replace("rate = 50", "rate = 25"))
    (tmp_path / "strolling.py").write_text(EXPLORE)  # one of each name a process
    host = HOST.format(port="/dev/ttyACM0").replace("roaming", "strolling")
    (tmp_path / "robot.toml").write_text(host)
    with pytest.raises(SystemExit):
        main(["check", str(tmp_path / "robot.toml")])

    said = " ".join(capsys.readouterr().out.split())
    assert "board.base: sensor.light: 10 Hz does not divide the 25 steps" in said
    assert "take 12.5 Hz, or --rate 50" in said


def test_a_sensor_may_be_called_host(plugged, tmp_path) -> None:
    """The names of the link can be those of no part."""
    names = plugged.folder / "main.py"
    assert "Host(HOST)" in names.read_text()
    assert link.HOST == "<host>"


@contextlib.contextmanager
def beating(beat: bytes) -> Iterator[str]:
    """A port at which a board says this again and again."""
    mine, other = pty.openpty()
    tty.setraw(other)
    over = threading.Event()

    def say() -> None:
        while not over.wait(0.05):
            os.write(mine, wire.stuffed(beat))

    thread = threading.Thread(target=say)
    thread.start()
    try:
        yield os.ttyname(other)
    finally:
        over.set()
        thread.join()
        os.close(mine)
        os.close(other)


@pytest.mark.parametrize(
    "beat", [b"b\x05" + bytes(24), b"B\0[7, 0]", b"B\0[1, 500, 25]"]
)
def test_a_board_of_another_version_is_refused_in_one_sentence(beat) -> None:
    """By `monitor`, too: of the next version, and of the first."""
    with (
        beating(beat) as port,
        pytest.raises(ConfigError, match=r"speaks version \d of the link, this"),
    ):
        firmware.monitor(port, print, seconds=5.0)


def test_a_board_of_the_version_before_is_watched() -> None:
    """Its beats have the number before, and are the same."""
    state = struct.pack("<BBBBHIIIIHH", 98, 3, 1, 255, 0, 500, 0, 3, 1, 0, 0)
    told: list[object] = []
    with beating(state + b"imu: OSError()") as port:
        firmware.monitor(port, told.append, seconds=0.5)

    assert told == [
        "esair: started by another cause, armed, 0 late, 3 refused, 1 faults, "
        "last: imu: OSError()"
    ]
