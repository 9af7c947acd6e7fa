"""Recordings: what is in them, and that they change nothing."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

import esair
from esair.journal import Event, Journal, Kind
from esair.messages import Reading
from esair.recording import Recorder, events_of, facts_of, is_whole, plain
from esair.recording._recorder import CHUNK, Segment

pytest.importorskip("foxglove", reason="needs esair[record]")

pytestmark = pytest.mark.virtual_clock


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


class Wander(esair.Behavior):
    """Drives on."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        for number in range(20):
            await self.wheels.write(Twist(0.01 * number, math.pi))
            await asyncio.sleep(0.05)


class Follow(esair.Reaction):
    """Looks."""

    sonar = esair.reads(float)

    def react(self, sonar: float) -> None:
        return None


def robot(fake_sensor, fake_actuator, **options):
    sonar = fake_sensor("sonar", 1.0)
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))
    made = esair.Robot(
        resources=[sonar, wheels], behaviors=[Wander(), Follow()], **options
    )
    return made, wheels


@pytest.mark.promise("REC-2")
async def test_everything_of_the_journal_is_in_the_file(
    fake_sensor, fake_actuator, tmp_path: Path
):
    """Every event by number, with its component, kind, peer and time."""
    told: list[Event] = []
    path = tmp_path / "run.mcap"
    made, _ = robot(fake_sensor, fake_actuator, record=esair.Recording(path))
    made.journal.listen(told.append)
    async with made:
        await asyncio.sleep(1.2)
    read = sorted(events_of(path))
    assert [e[0:2] + e[3:5] for e in read] == [e[0:2] + e[3:5] for e in told]
    assert [e.kind for e in read] == [str(e.kind) for e in told]
    assert is_whole(path)


@pytest.mark.promise("REC-2")
async def test_values_are_told_by_their_fields(
    fake_sensor, fake_actuator, tmp_path: Path
):
    """A structured command is an object with its fields; units are not lost."""
    path = tmp_path / "run.mcap"
    made, _ = robot(fake_sensor, fake_actuator, record=esair.Recording(path))
    async with made:
        await asyncio.sleep(0.3)
    sent = [e.value for e in events_of(path) if e.kind == "sent"]
    assert sent[1] == {"linear": 0.01, "angular": math.pi}


@pytest.mark.promise("REC-2")
async def test_versions_code_and_clock_are_told(
    fake_sensor, fake_actuator, tmp_path: Path
):
    """What one has to know to look at it years later."""
    path = tmp_path / "run.mcap"
    made, _ = robot(fake_sensor, fake_actuator, record=esair.Recording(path))
    async with made:
        await asyncio.sleep(0.1)
    facts = facts_of(path)
    assert {"robot", "versions", "code", "clock", "end"} <= set(facts)
    assert any(name.endswith("Wander") for name in facts["code"])
    assert float(facts["clock"]["offset"]) > 0


@pytest.mark.promise("REC-1")
async def test_recording_changes_no_command(fake_sensor, fake_actuator, tmp_path: Path):
    """With it and without it the device is told the same, at the same moments."""
    plain, wheels = robot(fake_sensor, fake_actuator)
    begin = asyncio.get_running_loop().time()
    async with plain:
        await asyncio.sleep(1.2)
    without = (wheels.commands, asyncio.get_running_loop().time() - begin)
    recorded, wheels = robot(
        fake_sensor, fake_actuator, record=esair.Recording(tmp_path / "run.mcap")
    )
    begin = asyncio.get_running_loop().time()
    async with recorded:
        await asyncio.sleep(1.2)
    assert wheels.commands == without[0]
    assert asyncio.get_running_loop().time() - begin == pytest.approx(without[1])


@pytest.mark.promise("REC-4")
async def test_only_the_user_reads_it(fake_sensor, fake_actuator, tmp_path: Path):
    """Mode 0600."""
    path = tmp_path / "run.mcap"
    made, _ = robot(fake_sensor, fake_actuator, record=esair.Recording(path))
    async with made:
        await asyncio.sleep(0.1)
    assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.promise("REC-4")
@pytest.mark.fault("P01")
async def test_a_full_disk_ends_the_recording_and_never_the_robot(
    fake_sensor, fake_actuator, tmp_path: Path, caplog
):
    """One line; the wheels go on."""
    record = esair.Recording(tmp_path / "run.mcap", min_free=1 << 62)
    made, wheels = robot(fake_sensor, fake_actuator, record=record)
    with caplog.at_level(logging.ERROR, "esair"):
        async with made:
            recorder = made._keeping.recorder
            assert isinstance(recorder, Recorder)
            await asyncio.to_thread(recorder._thread.join, 5.0)
            await asyncio.sleep(1.2)
    assert sum("the robot goes on" in line for line in caplog.messages) == 1
    assert len(wheels.commands) > 15
    assert wheels.commands[-1] == Twist(0.0, 0.0)


@pytest.mark.promise("REC-4")
async def test_a_folder_that_vanishes_ends_the_recording_with_one_line(
    fake_sensor, fake_actuator, tmp_path: Path, caplog, monkeypatch
):
    """Somebody has deleted it under the robot, which goes on."""
    monkeypatch.setattr("esair.recording._recorder.SYNC", 0.0)
    made, wheels = robot(
        fake_sensor, fake_actuator, record=esair.Recording(tmp_path / "kept")
    )
    with caplog.at_level(logging.ERROR, "esair"):
        async with made:
            recorder = made._keeping.recorder
            assert isinstance(recorder, Recorder)
            shutil.rmtree(recorder.path.parent)
            await asyncio.to_thread(recorder._thread.join, 5.0)
            await asyncio.sleep(1.2)
    assert ["the robot goes on" in line for line in caplog.messages] == [True]
    assert len(wheels.commands) > 15


@pytest.mark.promise("REC-4")
@pytest.mark.parametrize("kind", ["pipe", "dangling", "folder", "endless", "forbidden"])
async def test_whatever_lies_beside_it_ends_no_recording(kind: str, tmp_path: Path):
    """A folder may have things named like recordings that are none."""
    odd = tmp_path / "odd.mcap"
    if kind == "pipe":
        os.mkfifo(odd)
    elif kind == "folder":
        odd.mkdir()
    else:
        places = {"endless": "/dev/zero", "forbidden": "/proc/1/mem"}
        odd.symlink_to(places.get(kind, "nowhere"))
    path = tmp_path / "run.mcap"
    recorder = await recorded(path, [(Kind.SENT, "wheels", 1.0)])
    assert recorder.error is None
    assert [event.value for event in events_of(path)] == [1.0]


def test_a_pipe_is_no_recording(tmp_path: Path):
    """It can be read once, a recording is read twice: the error says what to do."""
    pipe = tmp_path / "run.mcap"
    os.mkfifo(pipe)
    holder = os.open(pipe, os.O_RDWR)
    try:
        with pytest.raises(esair.RecordingBrokenError, match=r"run\.mcap.*save it"):
            list(events_of(pipe))
    finally:
        os.close(holder)


def test_a_path_is_no_recording(tmp_path: Path):
    """Bounds belong to it: the message says what to write."""
    path: Any = tmp_path / "run.mcap"
    with pytest.raises(esair.ConfigError, match=r"record: expected esair\.Recording\("):
        esair.Robot(record=path)


@pytest.mark.promise("REC-4")
async def test_a_place_that_cannot_be_written_stops_no_start(
    fake_sensor, fake_actuator, tmp_path: Path, caplog
):
    """The robot starts without its recording, and says so."""
    (tmp_path / "nowhere").touch()
    record = esair.Recording(tmp_path / "nowhere" / "run.mcap")
    made, wheels = robot(fake_sensor, fake_actuator, record=record)
    with caplog.at_level(logging.ERROR, "esair"):
        async with made:
            await asyncio.sleep(0.3)
    assert any("starts without it" in line for line in caplog.messages)
    assert len(wheels.commands) > 3


async def test_what_is_not_named_mcap_is_a_folder(
    fake_sensor, fake_actuator, tmp_path: Path
):
    """It is made, and gets a file for each run."""
    for _ in range(2):
        record = esair.Recording(tmp_path / "kept" / "recordings")
        made, _ = robot(fake_sensor, fake_actuator, record=record)
        async with made:
            await asyncio.sleep(0.3)
    files = list((tmp_path / "kept" / "recordings").iterdir())
    assert len(files) == 2
    assert all(is_whole(file) and file.suffix == ".mcap" for file in files)


async def test_the_folder_of_a_file_is_made_too(
    fake_sensor, fake_actuator, tmp_path: Path
):
    """Nobody who asks for a recording drives without one for lack of a folder."""
    file = tmp_path / "kept" / "today" / "run.mcap"
    made, _ = robot(fake_sensor, fake_actuator, record=esair.Recording(file))
    async with made:
        await asyncio.sleep(0.3)
    assert is_whole(file)


@pytest.mark.long
@pytest.mark.promise("REC-4")
async def test_the_oldest_segment_goes(fake_sensor, fake_actuator, tmp_path: Path):
    """There are never more bytes than allowed, but for the segment being written."""
    record = esair.Recording(
        tmp_path / "run.mcap", max_bytes=4000, min_free=0, segment=1500
    )
    made, _ = robot(fake_sensor, fake_actuator, record=record)
    async with made:
        recorder = made._keeping.recorder
        assert recorder is not None
        for _ in range(12):
            await asyncio.sleep(0.1)
            await asyncio.to_thread(recorder._over.wait, 0.25)
    files = sorted(tmp_path.glob("*.mcap"))  # noqa: ASYNC240 - a test may block
    assert tmp_path / "run.mcap" not in files
    sizes = [path.stat().st_size for path in files]
    assert sum(sizes) <= 4000 + max(sizes)
    oldest = min(files, key=lambda path: int(path.stem.rpartition(".")[2]))
    whole = [event.number for event in events_of(tmp_path / "run.mcap")]
    assert whole == [event.number for event in events_of(oldest)]
    assert whole == [*range(whole[0], made.journal.number + 1)]
    assert facts_of(tmp_path / "run.mcap")["robot"]["name"] == "robot"


async def test_a_second_recording_keeps_the_first(
    fake_sensor, fake_actuator, tmp_path: Path
):
    """A file that is there is never overwritten."""
    for _ in range(2):
        made, _ = robot(
            fake_sensor, fake_actuator, record=esair.Recording(tmp_path / "run.mcap")
        )
        async with made:
            await asyncio.sleep(0.1)
    names = {path.name for path in tmp_path.iterdir()}  # noqa: ASYNC240 - it may block
    assert names == {"run.mcap", "run-2.mcap"}


@pytest.mark.parametrize("names", [("run.1", "run.2"), ("run", "run.2")])
async def test_runs_that_their_user_numbers_are_told_apart(
    fake_sensor, fake_actuator, tmp_path: Path, names: tuple[str, str]
):
    """Neither is a segment of the other, whatever they are called."""
    first, second = (tmp_path / f"{name}.mcap" for name in names)
    counts = []
    for path in (first, second):
        made, _ = robot(fake_sensor, fake_actuator, record=esair.Recording(path))
        async with made:
            await asyncio.sleep(0.1)
        counts.append(len([*events_of(path)]))
    assert len([*events_of(first)]) == counts[0] > 0
    assert len([*events_of(second)]) == counts[1]


@pytest.mark.promise("REC-4")
@pytest.mark.parametrize("which", ["run.mcap", "run.2.mcap"])
async def test_a_part_that_has_lost_whose_it_is_ends_no_recording(
    fake_sensor, fake_actuator, tmp_path: Path, which: str
):
    """A damaged byte there costs no event, of no part."""
    path = tmp_path / "run.mcap"
    made, _ = robot(fake_sensor, fake_actuator, record=esair.Recording(path))
    async with made:
        await asyncio.sleep(0.1)
    count, whole = len([*events_of(path)]), path.read_bytes()
    for name in ("run.mcap", "run.2.mcap", "run.3.mcap"):
        damaged = whole.replace(b"\x03\0\0\0run", b"\xff\0\0\0run", 1)
        (tmp_path / name).write_bytes(damaged if name == which else whole)
    assert len([*events_of(path)]) == 3 * count > 0


@pytest.mark.real_clock
@pytest.mark.promise("REC-4")
def test_what_is_left_of_an_earlier_run_ends_no_recording(tmp_path: Path) -> None:
    """Its first file was moved away; there the next run would have its second."""
    path = tmp_path / "run.mcap"
    (tmp_path / "run.2.mcap").write_bytes(b"of an earlier run")
    esair.run(esair.Robot(record=esair.Recording(path, min_free=0)), duration=0.1)
    assert {each.name for each in tmp_path.iterdir()} == {"run.2.mcap", "run-2.mcap"}


@pytest.mark.parametrize(
    "value",
    [
        float("nan"),
        object(),
        {1: {2: {3}}},
        ValueError("no"),
        b"\0\1",
        [float("inf")],
        type("Broken", (), {"__repr__": lambda self: 1 / 0})(),
    ],
    ids=lambda value: type(value).__name__,
)
async def test_any_value_can_be_recorded(value, tmp_path: Path):
    """What has no form of its own is a text; nothing ends the recording."""
    journal = Journal()
    recorder = Recorder(esair.Recording(tmp_path / "run.mcap"), journal)
    loop = asyncio.get_running_loop()
    recorder.start(loop.time())
    journal.start(loop)
    journal.publish(Kind.PUT, "guest", "host", value)
    journal.publish(Kind.PUT, "guest", "host", 1)
    journal.close()
    await asyncio.to_thread(recorder.close)
    read = list(events_of(tmp_path / "run.mcap"))
    assert [event.number for event in read] == [1, 2]
    assert recorder.error is None


async def test_a_huge_value_is_left_out_and_told_once(tmp_path: Path, caplog):
    """The event is there without it."""
    journal = Journal()
    recorder = Recorder(esair.Recording(tmp_path / "run.mcap"), journal)
    loop = asyncio.get_running_loop()
    recorder.start(loop.time())
    journal.start(loop)
    for _ in range(3):
        journal.publish(Kind.PUT, "guest", "host", bytes(10 << 20))
    journal.close()
    with caplog.at_level(logging.WARNING, "esair"):
        await asyncio.to_thread(recorder.close)
    assert [e.value for e in events_of(tmp_path / "run.mcap")] == [None] * 3
    assert recorder.counts()["left_out"] == 3
    assert sum("left out" in line for line in caplog.messages) == 1


async def recorded(path: Path, events: Iterable[tuple[Kind, str, object]]) -> Recorder:
    """Record events of the journal to a file."""
    journal = Journal()
    recorder = Recorder(esair.Recording(path), journal)
    loop = asyncio.get_running_loop()
    recorder.start(loop.time())
    journal.start(loop)
    for kind, component, value in events:
        journal.publish(kind, component, "", value)
    journal.close()
    await asyncio.to_thread(recorder.close)
    return recorder


@attrs.frozen
class Turn:
    """What viewers know as a laser scan."""

    angles: tuple[float, ...]
    ranges: tuple[float, ...]


@pytest.mark.promise("REC-2")
async def test_a_value_may_change_its_shape(tmp_path: Path):
    """The kind of a topic is that of its first value; no later one is lost."""
    from mcap.reader import make_reader

    values = [
        Turn((0.0, 0.1), (1.0, 2.0)),
        1.5,
        {"a": 1},
        [1, 2],
        None,
        "text",
        Turn((), ()),
    ]
    path = tmp_path / "run.mcap"
    readings = [
        (Kind.READING, "laser", Reading(value, 0.0, number))
        for number, value in enumerate(values)
    ]
    await recorded(path, readings)

    told = [event.value for event in events_of(path)]
    assert told == [plain(value) for value in values]
    with path.open("rb") as file:  # another program's reader
        messages = [
            (channel.topic, json.loads(message.data))
            for _, channel, message in make_reader(file).iter_messages()
        ]
    assert [topic for topic, _ in messages] == ["/sensor/laser"] * len(values)


@pytest.mark.promise("REC-4", "REC-5")
@pytest.mark.parametrize(
    "value",
    [
        np.zeros((10, 1 << 20), np.uint8),
        Turn((0.0,), (1.0,) * 1_000_000),
        {"image": np.zeros(10 << 20, np.uint8)},
        bytearray(10 << 20),
    ],
    ids=["array", "a field of it", "in a table", "bytes"],
)
async def test_ten_megabytes_are_left_out_wherever_they_are(value, tmp_path: Path):
    """They are not encoded first: the event is there without them, in no time."""
    began = time.thread_time()
    recorder = await recorded(tmp_path / "run.mcap", [(Kind.PUT, "host", value)] * 3)
    assert time.thread_time() - began < 0.5
    assert [event.value for event in events_of(tmp_path / "run.mcap")] == [None] * 3
    assert recorder.counts()["left_out"] == 3


FULL = """
import asyncio, logging, resource, sys
from pathlib import Path
import esair
from esair.journal import Journal, Kind
from esair.recording import Recorder, events_of

async def main(path, room):
    journal = Journal()
    recorder = Recorder(esair.Recording(path), journal)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    loop = asyncio.get_running_loop()
    recorder.start(loop.time())
    journal.start(loop)
    for number in range(600):
        journal.publish(Kind.PUT, "guest", "host", f"{number} " + "x" * 200)
        if number % 100 == 0:
            await asyncio.sleep(0.01)
    journal.close()
    assert await asyncio.to_thread(recorder.close)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    return recorder.error

for room in map(int, sys.argv[2:]):
    path = Path(sys.argv[1]) / f"{room}.mcap"
    error = asyncio.run(main(path, room))
    try:
        numbers = [event.number for event in events_of(path)]
    except esair.RecordingBrokenError:
        numbers = []
    print(room, error is not None, numbers == list(range(1, len(numbers) + 1)), len(numbers))
"""


@pytest.mark.promise("REC-4")
@pytest.mark.fault("P01")
def test_a_write_that_fails_is_told_by_the_robot_alone(tmp_path: Path, caplog):
    """The library that makes the chunks has nothing to add in the log."""
    segment = Segment(tmp_path / "run.mcap")
    segment._out._file.close()  # what is written to it from now on fails
    with open("/dev/full", "r+b", buffering=0) as full:
        segment._out._file = full  # type: ignore[assignment]
        with pytest.raises(esair.RecordingError, match="No space left"):
            segment.write("/a", "text", {"a": "b" * CHUNK}, 1.0)
        with contextlib.suppress(esair.RecordingError):
            segment.close()
    assert caplog.messages == []


@pytest.mark.promise("REC-4")
@pytest.mark.fault("P01")
@pytest.mark.real_clock
@pytest.mark.long
def test_a_disk_that_is_full_from_some_byte_on(tmp_path: Path):
    """Whichever: one error, no exception, no hang; what was written before is read."""
    rooms = [0, 1, 60, 500, 4_000, 20_000, 10_000_000]
    ended = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path), *map(str, rooms)],
        # Of a module that is compiled on the full disk Python would keep a part.
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode == 0, ended.stderr
    found = [line.split() for line in ended.stdout.splitlines()]
    assert [int(room) for room, *_ in found] == rooms
    assert [failed for _, failed, *_ in found] == ["True"] * (len(rooms) - 1) + [
        "False"
    ]
    assert {in_order for _, _, in_order, _ in found} == {"True"}
    counts = [int(count) for *_, count in found]
    assert counts == sorted(counts)
    assert counts[-1] == 600


@pytest.mark.promise("REC-4")
@pytest.mark.fault("P02")
@pytest.mark.promise("REC-4")
async def test_pictures_that_wait_are_bounded_by_their_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Few events of many bytes are too many; nothing was written yet."""
    monkeypatch.setattr("esair.recording._recorder.HELD", 5000)
    journal = Journal()
    recorder = Recorder(esair.Recording(tmp_path / "run.mcap"), journal)
    journal.start(asyncio.get_running_loop())
    for _ in range(20):
        journal.publish(Kind.PUT, "guest", "host", bytes(1000))
    await asyncio.sleep(0.01)
    assert recorder.counts()["dropped"] == 15
    recorder.start(0.0)
    assert await asyncio.to_thread(recorder.close, 10.0)
    journal.close()


@pytest.mark.fault("P02")
@pytest.mark.real_clock
async def test_a_slow_disk_costs_events_and_no_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """What waits is bounded, what did not fit is counted, and nobody waits for it."""
    from esair.recording import _recorder

    go = threading.Event()
    monkeypatch.setattr(_recorder, "BACKLOG", 50)
    monkeypatch.setattr(_recorder.Segment, "sync", lambda _self: None)
    real = _recorder.Segment.write
    monkeypatch.setattr(
        _recorder.Segment, "write", lambda *args: go.wait(20.0) and real(*args)
    )
    journal = Journal()
    recorder = Recorder(esair.Recording(tmp_path / "run.mcap"), journal)
    loop = asyncio.get_running_loop()
    journal.start(loop)
    recorder.start(loop.time())
    for number in range(500):
        journal.publish(Kind.PUT, "guest", "host", number)
        await asyncio.sleep(0)
    assert not go.is_set()
    dropped = recorder.counts()["dropped"]
    go.set()
    assert await asyncio.to_thread(recorder.close, 10.0)
    journal.close()

    assert 400 <= dropped < 500
    assert recorder.written + dropped == 500
    assert [event.value for event in events_of(tmp_path / "run.mcap")][-1] < 499


@pytest.mark.promise("REC-1")
@pytest.mark.parametrize(
    "value",
    [
        2**70,
        -(2**70),
        "half \ud800",
        {"\udfff": 1},
        np.float64(0.1),
        [1e300, None, "é"],
    ],
    ids=["large", "small", "surrogate", "name", "numpy", "usual"],
)
def test_a_message_has_all_that_json_has(tmp_path: Path, value: object) -> None:
    """Also what the quick encoder has no room for."""
    from mcap.reader import make_reader

    segment = Segment(tmp_path / "run.mcap")
    segment.write("/state", "esair.Event", {"value": value}, 1.0)
    segment.close()
    with segment.path.open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages()
    assert json.loads(message.data) == {"value": value}


@pytest.mark.promise("REC-2")
def test_facts_that_are_no_text_are_escaped(tmp_path: Path) -> None:
    """A file may have any bytes in its name, that of the robot's configuration too."""
    path = tmp_path / "run.mcap"
    segment = Segment(path)
    segment.note("configuration", {"path": os.fsdecode(b"caf\xe9.toml")})
    segment.close()
    assert facts_of(path)["configuration"] == {"path": "caf\\udce9.toml"}


@pytest.mark.promise("REC-4")
def test_a_name_that_another_robot_takes_first_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was free when this one looked: the next one is taken, and the other is untouched."""
    taken, looks, lexists = tmp_path / "run.mcap", [], os.path.lexists
    taken.write_bytes(b"another robot's")

    def look(path: Any) -> bool:
        looks.append(path)
        return len(looks) > 1 and lexists(path)

    monkeypatch.setattr(os.path, "lexists", look)
    esair.run(esair.Robot(record=esair.Recording(taken)), duration=0.05)
    assert taken.read_bytes() == b"another robot's"
    assert is_whole(tmp_path / "run-2.mcap")


@pytest.mark.promise("REC-4")
def test_it_is_told_where_it_records(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A file that is there is kept, so that the recording has another name."""
    (tmp_path / "run.mcap").write_bytes(b"an earlier run")
    robot = esair.Robot(record=esair.Recording(tmp_path / "run.mcap"))
    with caplog.at_level(logging.INFO, "esair"):
        esair.run(robot, duration=0.05)
    assert f"recording: {tmp_path / 'run-2.mcap'}" in caplog.messages


@pytest.mark.promise("REC-2")
@pytest.mark.real_clock
def test_the_wall_clock_is_told_as_it_is_amid_a_turn(tmp_path: Path) -> None:
    """The first turn takes long: all that a robot needs is imported in it."""
    path = tmp_path / "run.mcap"

    async def main() -> float:
        time.sleep(0.3)  # noqa: ASYNC251 - what an import takes
        async with esair.Robot(record=esair.Recording(path)):
            return time.time() - time.monotonic()

    with asyncio.Runner(loop_factory=esair.new_event_loop) as runner:
        offset = runner.run(main())
    assert float(facts_of(path)["clock"]["offset"]) == pytest.approx(offset, abs=0.1)


@pytest.mark.promise("REP-2")
@pytest.mark.parametrize("kind", [set, frozenset])
def test_a_set_is_told_in_one_order(kind: type) -> None:
    """Its own is another in each process, which no replay takes for a difference."""
    words = [f"button{number}" for number in range(20)]
    assert plain({"pressed": kind(words)}) == {"pressed": sorted(words, key=repr)}
