"""Recordings: what is in them, and that they change nothing."""

from __future__ import annotations

import asyncio
import logging
import math
from pathlib import Path

import attrs
import pytest

import esair
from esair.journal import Event
from esair.recording import Recorder, events_of, facts_of, is_whole

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
async def test_a_full_disk_ends_the_recording_and_never_the_robot(
    fake_sensor, fake_actuator, tmp_path: Path, caplog
):
    """One line; the wheels go on."""
    record = esair.Recording(tmp_path / "run.mcap", min_free=1 << 62)
    made, wheels = robot(fake_sensor, fake_actuator, record=record)
    with caplog.at_level(logging.ERROR, "esair"):
        async with made:
            recorder = made._recorder
            assert isinstance(recorder, Recorder)
            await asyncio.to_thread(recorder._thread.join, 5.0)
            await asyncio.sleep(1.2)
    assert sum("the robot goes on" in line for line in caplog.messages) == 1
    assert len(wheels.commands) > 15
    assert wheels.commands[-1] == Twist(0.0, 0.0)


@pytest.mark.promise("REC-4")
async def test_a_place_that_cannot_be_written_stops_no_start(
    fake_sensor, fake_actuator, tmp_path: Path, caplog
):
    """The robot starts without its recording, and says so."""
    record = esair.Recording(tmp_path / "nowhere" / "run.mcap")
    made, wheels = robot(fake_sensor, fake_actuator, record=record)
    with caplog.at_level(logging.ERROR, "esair"):
        async with made:
            await asyncio.sleep(0.3)
    assert any("starts without it" in line for line in caplog.messages)
    assert len(wheels.commands) > 3


@pytest.mark.promise("REC-4")
async def test_the_oldest_segment_goes(fake_sensor, fake_actuator, tmp_path: Path):
    """There are never more bytes than allowed, but for the segment being written."""
    record = esair.Recording(
        tmp_path / "run.mcap", max_bytes=4000, min_free=0, segment=1500
    )
    made, _ = robot(fake_sensor, fake_actuator, record=record)
    async with made:
        recorder = made._recorder
        assert recorder is not None
        for _ in range(12):
            await asyncio.sleep(0.1)
            await asyncio.to_thread(recorder._over.wait, 0.25)
    files = sorted(tmp_path.glob("*.mcap"))  # noqa: ASYNC240 - a test may block
    assert tmp_path / "run.mcap" not in files
    sizes = [path.stat().st_size for path in files]
    assert sum(sizes) <= 4000 + max(sizes)


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
    from esair.journal import Journal, Kind

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
    from esair.journal import Journal, Kind

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
