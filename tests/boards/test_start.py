"""How a board starts and stays well: arming, watchdog, parts that browned out."""

import io
import os
import sys

import pytest
from tests.minimal import rules

from esair.boards import link, stand_in
from esair.boards.start import Start
from esair.drivers.board import wire
from esair.firmware._starter import starter
from esair.minimal import Loop

pytestmark = pytest.mark.promise("MIN-5")


@pytest.fixture
def pins(monkeypatch):
    """A board without anything connected."""
    for each in ("inputs", "outputs"):
        monkeypatch.setattr(stand_in, each, {})
    monkeypatch.setattr(stand_in, "fed", [])
    monkeypatch.setitem(sys.modules, "machine", stand_in)
    return stand_in


def made(*parts, **options) -> tuple[Loop, rules.Motor, Start]:
    motor = rules.Motor()
    loop = Loop([rules.Go()], [rules.Sonar(0.5)], [motor], rate=50, armed=False)
    return loop, motor, Start(loop, parts=parts, **options)


def steps(loop: Loop, start: Start, count: int) -> None:
    for _ in range(count):
        loop.step()
        start()


@pytest.mark.parametrize("cause", [1, 3])
def test_a_start_moves_nothing_unless_it_is_armed(pins, capsys, cause) -> None:
    """Whatever the reason, which is printed; a switch on a pin arms and disarms."""
    pins.cause, before = cause, pins.cause
    try:
        loop, motor, start = made(arm=14)
    finally:
        pins.cause = before
    steps(loop, start, 2)
    assert motor.told == [0.0]
    pins.inputs[14] = 0
    steps(loop, start, 2)
    assert motor.told == [0.0, 0.5]
    pins.inputs[14] = 1
    steps(loop, start, 2)
    assert motor.told == [0.0, 0.5, 0.5, 0.0]

    word = {1: "power-on", 3: "watchdog"}[cause]
    assert f"esair: ready, {word}, armed by pin 14" in capsys.readouterr().out


@pytest.mark.promise("MIN-4")
@pytest.mark.parametrize(
    ("arm", "pin", "told"),
    [
        (14, 1, [0.0]),  # the switch is open: whatever the computer says
        (14, 0, [0.0, 0.5, 0.5]),  # closed: nor does it disarm
        ("always", 1, [0.0, 0.5, 0.5, 0.5]),
        ("host", 1, [0.0, 0.5, 0.5, 0.0]),
    ],
)
def test_only_a_board_that_the_host_arms_is_armed_by_it(
    pins, monkeypatch, arm, pin, told
) -> None:
    """On the link too: a switch is there so that nobody else decides."""
    near, far = os.pipe()
    stdin = io.TextIOWrapper(io.FileIO(near))
    monkeypatch.setattr(sys, "stdin", stdin)
    pins.inputs[14] = pin
    motor = rules.Motor()
    orders = link.from_host((motor,))
    loop = Loop(
        [rules.Go(), *orders],
        [rules.Sonar(0.5), link.Host(link.HOST)],
        [motor],
        rate=50,
        armed=False,
    )
    start = Start(loop, arm=arm, link=link.Link, orders=orders)
    with stdin, io.FileIO(far, "w") as line:
        for flags in (2, None, 4):
            if flags is not None:
                line.write(wire.stuffed(bytes([ord("h"), link.VERSION, flags, 0, 0])))
            steps(loop, start, 1)
        steps(loop, start, arm == "host")

    assert motor.told == told


def test_the_host_arms_by_a_line_whatever_else_comes(pins, monkeypatch, capsys) -> None:
    """Noise ends nothing, and a flood holds up no step."""
    near, far = os.pipe()
    with io.TextIOWrapper(io.FileIO(near)) as stdin, io.FileIO(far, "w") as line:
        monkeypatch.setattr(sys, "stdin", stdin)
        loop, motor, start = made(arm="host")
        line.write(b"\xff\xfe\x03\nwho\rarm\r\n")
        steps(loop, start, 2)
        line.write(bytes(1000) + b"\n disarm\n")
        steps(loop, start, 3)
        assert motor.told == [0.0, 0.5, 0.5, 0.5, 0.5]
        steps(loop, start, 20)

    assert motor.told[-1] == 0.0
    assert capsys.readouterr().out.count("esair: ready") == 2


def test_armed_always_it_moves_at_once(pins) -> None:
    """Who wants that has said so."""
    loop, motor, start = made(arm="always", watchdog=2000)
    steps(loop, start, 2)

    assert motor.told == [0.0, 0.5, 0.5]
    assert pins.fed == [2000, 0]


def test_a_part_that_browned_out_is_set_up_again(pins) -> None:
    """It is asked once a second; what it was told last is no longer true: safe."""

    class Forgetful(rules.Motor):
        opened = 0
        there = True

        def open(self):
            self.opened += 1
            self.there = True

        def is_set_up(self):
            return self.there

    motor = Forgetful()
    loop = Loop([], [], [motor], rate=50)
    start = Start(loop, parts=(motor,))
    steps(loop, start, 10)
    assert motor.opened == 1
    motor.there = False
    steps(loop, start, 60)
    assert motor.opened == 2
    assert start.repaired == 1
    assert motor.told == [0.0, 0.0]


def test_a_full_flash_memory_keeps_no_program_off(pins, tmp_path, monkeypatch) -> None:
    """Its starts cannot be counted then; it runs all the same."""
    (tmp_path / "esair-a").mkdir()
    (tmp_path / "esair-a" / "main.py").write_text("ran = True")
    (tmp_path / "esair.starts").symlink_to("/dev/full")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "main", raising=False)
    board: dict[str, object] = {}

    exec(starter("esair-a"), board)

    assert board["_esair"] == "ended"
    assert sys.modules.pop("main").ran
