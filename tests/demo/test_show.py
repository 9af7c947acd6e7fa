"""The show: its events happen, and what must hold in them holds."""

from __future__ import annotations

import asyncio
import hashlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import attrs
import pytest
from rich.console import Console

import esair.demo
from esair.buses import Frame
from esair.config import load
from esair.demo import demo
from esair.demo._show import Ending, Screen, perform
from esair.demo._story import Event
from esair.drivers.wheel_motor import (
    LEFT,
    RIGHT,
    command_id,
    decode_command,
    decode_feedback,
    feedback_id,
)
from esair.testing._clock import VirtualLoop

ROBOT = Path(esair.demo.__file__).with_name("robot.toml")

# One worker plays the show, once.
pytestmark = pytest.mark.xdist_group("show")

DURATION = 16.0
"""How long the show is here, in seconds."""


@attrs.frozen
class Show:
    """What was left of a show, and what was seen of it."""

    ending: Ending
    log: tuple[str, ...]
    text: str


def play(seed: int, duration: float = DURATION) -> Show:
    """Play the show on a virtual clock."""
    ending = Ending()
    text = io.StringIO()
    screen = Screen(Console(file=text, width=200), live=False)
    with screen, asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=seed)) as runner:
        runner.run(perform(ending, screen, seed=seed, duration=duration))
    return Show(ending, tuple(screen.lines), text.getvalue())


@pytest.fixture(scope="session")
def show() -> Show:
    """Play the show once."""
    return play(seed=3)


def motions(frames: list[tuple[float, Frame]]) -> list[tuple[float, int, bool]]:
    """Return time, side, and whether it moves, of each command on the bus."""
    sides = {command_id(LEFT): LEFT, command_id(RIGHT): RIGHT}
    found = []
    for time, frame in frames:
        if frame.id in sides:
            command = decode_command(sides[frame.id], frame.data)
            found.append((time, sides[frame.id], command.enable and command.speed != 0))
    return found


def event_time(show: Show, kind: str) -> float:
    """Return when an event of a kind happened."""
    assert show.ending.run is not None
    return next(event.time for event in show.ending.run.events if event.kind == kind)


def milliseconds(show: Show, kind: str) -> list[int]:
    """Return what an event says of times, in ms."""
    assert show.ending.run is not None
    (event,) = [each for each in show.ending.run.events if each.kind == kind]
    return [int(found) for found in re.findall(r"after (\d+) ms", event.detail)]


def test_all_events_happen_in_their_order(show: Show) -> None:
    """Nothing that should have happened is missing."""
    assert show.ending.run is not None

    kinds = [event.kind for event in show.ending.run.events if event.kind != "bump"]

    assert kinds == ["person", "unplug", "plug", "refuse", "swap", "end"]
    assert show.ending.run.unmet == ()


def test_the_wheels_stop_when_the_rover_cannot_see(show: Show) -> None:
    """Both motors get their stop within 0.1 s, and nothing that moves until it sees."""
    lost, back = event_time(show, "unplug"), event_time(show, "plug")
    while_away = [
        each for each in motions(show.ending.frames) if lost + 0.1 < each[0] < back
    ]
    before = [
        each for each in motions(show.ending.frames) if lost - 1.0 < each[0] < lost
    ]
    after = [
        each for each in motions(show.ending.frames) if back < each[0] < back + 2.0
    ]

    assert not any(moves for _, _, moves in while_away)
    assert any(moves for _, _, moves in before)
    assert any(moves for _, _, moves in after)
    assert show.ending.run is not None
    noticed, stopped = milliseconds(show, "unplug")
    seen, moved = milliseconds(show, "plug")
    assert 0 <= noticed < 100
    assert 0 <= stopped < 100
    assert 0 < seen <= moved < 1000


def test_one_line_of_the_log_tells_of_the_loss_and_one_of_the_return(
    show: Show,
) -> None:
    """However often it was tried to open the range finder in between."""
    lost = [line for line in show.log if line.startswith("ranges: lost")]
    back = [line for line in show.log if line.startswith("ranges: back")]
    parked = [line for line in show.log if line.startswith("avoid: parked")]

    assert (len(lost), len(back), len(parked)) == (1, 1, 1)


def test_the_blind_moment_says_why_the_rover_stands(show: Show) -> None:
    """In the picture, and in the line of text."""
    assert show.ending.run is not None
    (blind,) = [event for event in show.ending.run.events if event.kind == "unplug"]

    assert blind.detail.endswith("the rover stands still because avoid is blind")


def test_a_guard_and_a_reaction_have_something_to_do(show: Show) -> None:
    """The brake keeps back a part of what was asked for; then avoid has the wheels."""
    assert show.ending.run is not None
    (person,) = [event for event in show.ending.run.events if event.kind == "person"]
    soon = [
        each
        for each in show.ending.run.samples
        if 0.0 <= each.time - person.time <= 2.0
    ]

    found = re.search(r"lets (0\.\d+) of (0\.\d+) m/s pass", person.detail)
    assert found is not None
    assert float(found[1]) < float(found[2])
    assert any(each.linear < each.asked for each in soon)
    assert any(each.holder == "avoid" and each.linear == 0.0 for each in soon)


def test_the_refusal_says_who_holds_the_wheels(show: Show) -> None:
    """And with which priority."""
    assert show.ending.run is not None
    (refusal,) = [event for event in show.ending.run.events if event.kind == "refuse"]

    assert re.search(
        r"refused: (explore|avoid|bump) holds them with priority \d+", refusal.detail
    )


def test_the_last_command_of_all_is_a_stop(show: Show) -> None:
    """For both wheels; and the summary says that the device answered."""
    last = {side: moves for _, side, moves in motions(show.ending.frames)}

    assert last == {LEFT: False, RIGHT: False}
    assert show.ending.run is not None
    (told,) = show.ending.run.told
    assert (told.resource, told.safe, told.answered) == ("wheels", True, True)


def test_the_rover_knows_where_it_is(show: Show) -> None:
    """Wheels, gyroscope and range finder agree with the world within 0.15 m."""
    assert show.ending.run is not None

    assert show.ending.run.error < 0.15
    assert show.ending.run.distance > 2.0
    assert show.ending.run.known > 0.3


def test_the_motors_told_what_they_did(show: Show) -> None:
    """Feedback came 50 times a second, from both, and their encoders turned."""
    assert show.ending.run is not None
    for side in (LEFT, RIGHT):
        told = [
            decode_feedback(side, frame.data)
            for _, frame in show.ending.frames
            if frame.id == feedback_id(side)
        ]
        assert len(told) / show.ending.run.seconds == pytest.approx(50, rel=0.1)
        assert told[-1].angle != 0.0


def test_the_table_names_every_component(show: Show) -> None:
    """And what the wheels were told last."""
    assert show.ending.run is not None
    text = io.StringIO()

    show.ending.run.show(Console(file=text, width=160))

    words = ["ranges", "bumper", "odometry", "imu", "wheels"]
    words += ["explore", "mapper", "avoid", "brake", "bump"]
    for word in (*words, "Twist(linear=0.0, angular=0.0)"):
        assert word in text.getvalue()


def test_each_event_is_told_as_it_happens(show: Show) -> None:
    """One line each where there is no terminal."""
    assert show.text.count("unplugged") == 1
    assert show.text.count("esair mode dock") == 1
    assert show.text.count("commands of explore were not made meanwhile") == 1


@pytest.mark.long
def test_the_picture_is_a_png_of_a_good_size(show: Show, tmp_path: Path) -> None:
    """It is written in one piece and can be printed."""
    from esair.demo._picture import draw  # it takes long: not in each worker

    assert show.ending.run is not None
    path = tmp_path / "demo.png"

    draw(show.ending.run, path)

    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(head[16:20], "big") >= 1200
    assert path.stat().st_size > 30_000


@pytest.mark.long
def test_what_the_picture_says_of_the_floor_is_not_hidden(show: Show) -> None:
    """Badges lie over nothing that is written, and over no bump."""
    from esair.demo._picture import drawn

    run = show.ending.run
    assert run is not None
    (sill,) = [box for box in run.arena.boxes if box.low]
    x, y = sill.center
    bump, back = (x - 0.22, y + 0.33), (x - 0.43, y + 0.07)
    events = [("bump", bump), ("unplug", back), ("plug", back)]
    told = [Event(float(n), kind, kind, at) for n, (kind, at) in enumerate(events)]
    figure = drawn(attrs.evolve(run, events=tuple(told)))
    figure.canvas.draw()
    floor = figure.axes[0]
    extents = [text.get_window_extent() for text in floor.texts]
    (label,) = [text for text in floor.texts if "only felt" in text.get_text()]
    room = label.get_window_extent()
    assert [room.overlaps(each) for each in extents].count(True) == 1
    place = floor.transData.transform(bump)
    assert not any(each.contains(*place) for each in extents)


@pytest.mark.long
def test_the_same_seed_gives_the_same_run(show: Show) -> None:
    """To the last frame; another seed gives another run."""
    again = play(seed=3)
    other = play(seed=4, duration=6.0)

    assert again.ending.frames == show.ending.frames
    assert again.ending.run is not None
    assert show.ending.run is not None
    assert again.ending.run.samples == show.ending.run.samples
    assert again.log == show.log
    assert other.ending.frames[:500] != show.ending.frames[:500]


def digest(folder: Path, hash_seed: str) -> str:
    """Run the show in another process; return what was on the CAN bus, as a digest."""
    record, out = folder / f"{hash_seed}.log", folder / f"{hash_seed}.png"
    code = (
        "from pathlib import Path; from esair.demo import demo; "
        f"file = open({str(record)!r}, 'w', encoding='ascii'); "
        "raise SystemExit(demo(fast=True, seed=5, duration=20.0, "
        f"out=Path({str(out)!r}), on_frame=lambda time, frame: "
        "print(f'{time:.6f} {frame.id:03X} {frame.data.hex()}', file=file)))"
    )
    subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        check=True,
        capture_output=True,
        timeout=60,
    )
    lines = record.read_text("ascii").splitlines()
    assert len(lines) > 1000
    assert re.fullmatch(r"\d+\.\d{6} [0-9A-F]{3} [0-9a-f]{8,16}", lines[0])
    return hashlib.sha256(record.read_bytes()).hexdigest()


@pytest.mark.long
def test_the_same_seed_gives_the_same_run_in_another_process(tmp_path: Path) -> None:
    """Nothing depends on the order of sets, addresses or threads."""
    assert digest(tmp_path, "1") == digest(tmp_path, "2")


@pytest.mark.parametrize("simulated", [False, True])
def test_the_robot_is_described_by_one_file(simulated: bool) -> None:
    """The same file serves the real rover and the simulated one."""
    described = load(ROBOT, simulated=simulated)

    turns = ["explore", "dock", "charge"]
    always = ["mapper", "brake", "avoid", "bump"]
    assert sorted(described.behaviors) == sorted([*turns, *always])
    assert list(described.robot["modes"]) == turns
    front = described.resources["ranges"].bus
    assert front is not None
    assert type(front).__name__ == ("SimSerialBus" if simulated else "SerialBus")


@pytest.mark.promise("REC-1", "REC-6")
@pytest.mark.long
def test_a_recording_of_the_show_can_be_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It has what each wheel was told, and why; log prints it, plot draws it."""
    pytest.importorskip("mcap")
    from esair.cli._log_file import log
    from esair.cli._plot import plot

    record, out = tmp_path / "demo.mcap", tmp_path / "demo.png"
    assert demo(fast=True, seed=3, duration=12.0, out=out, record=record) == 0
    capsys.readouterr()

    kinds = ["refused", "sent", "parked"]
    assert log(record, component=["wheels", "avoid"], kind=kinds) == 0
    told = capsys.readouterr().out
    assert "avoid ranges lost" in told  # and the rover writes what is safe meanwhile
    assert "avoid" in next(line for line in told.splitlines() if " refused " in line)
    assert told.count(" sent ") > 50
    assert plot(record, out=tmp_path / "plot.png") == 0
    assert (tmp_path / "plot.png").stat().st_size > 30_000


def test_a_picture_that_cannot_be_written_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not after half a minute of driving."""
    assert demo(fast=True, out=tmp_path / "nowhere" / "demo.png") == 2
    assert demo(fast=True, out=tmp_path) == 2
    assert demo(fast=True, record=tmp_path) == 2
    assert demo(fast=True, record=tmp_path / "demo.log") == 2
    told = capsys.readouterr()
    assert told.err.count("cannot be written") == 4
    assert not told.out


def test_a_show_that_was_cut_short_has_no_summary() -> None:
    """What is not known is not made up."""
    assert Ending().run is None
    assert callable(demo)
