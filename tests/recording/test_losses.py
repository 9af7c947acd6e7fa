"""What a recording lacks is told; where time is virtual it lacks nothing."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from pathlib import Path

import pytest

import esair
from esair.cli import main
from esair.journal import Journal, Kind
from esair.recording import Recorder, events_of, facts_of
from esair.recording._recorder import Segment

pytest.importorskip("foxglove", reason="needs esair[record]")

pytestmark = pytest.mark.promise("REC-4")


class Talks(esair.Behavior):
    """Writes twice in each step of a quick beat."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(esair.random.random())
            await self.wheels.write(esair.random.random())


async def drive(path: Path, seconds: float, fake_actuator) -> esair.Robot:
    wheels = fake_actuator("wheels", safe=0.0)
    record = esair.Recording(path, min_free=0)
    robot = esair.Robot(resources=[wheels], behaviors=[Talks()], record=record)
    numbers: list[int] = []
    robot.journal.listen(lambda event: numbers.append(event.number), backlog=1 << 22)
    async with robot:
        await asyncio.sleep(seconds)
    there = [event.number for event in events_of(path)]
    assert there == numbers
    assert there == [*range(1, there[-1] + 1)]
    assert robot.stopped.recording == ""
    assert facts_of(path)["end"]["dropped"] == "0"
    return robot


@pytest.mark.virtual_clock
async def test_virtual_time_waits_for_the_recorder(
    tmp_path, fake_actuator, monkeypatch
):
    """However quick it is: every event is in the file."""
    monkeypatch.setattr("esair.recording._recorder.FULL", 64)
    monkeypatch.setattr("esair.recording._recorder.BACKLOG", 128)
    await drive(tmp_path / "run.mcap", 10.0, fake_actuator)


@pytest.mark.long
@pytest.mark.virtual_clock
async def test_an_hour_of_virtual_time_is_in_the_file(tmp_path, fake_actuator):
    """Hundreds of thousands of events, and none is missing."""
    robot = await drive(tmp_path / "run.mcap", 3600.0, fake_actuator)
    assert robot.journal.number > 200_000


def slow(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Have each event take its time to be written."""
    write = Segment.write

    def late(self, *args):
        time.sleep(seconds)
        write(self, *args)

    monkeypatch.setattr(Segment, "write", late)


def until_it_has_ended() -> None:
    """Wait for a recorder whose time is over: it still has its end to write."""
    for thread in threading.enumerate():
        if thread.name == "esair-recorder":
            thread.join(10.0)


async def record(path: Path, count: int) -> Recorder:
    """Record some events as quickly as they come."""
    journal = Journal()
    recorder = Recorder(esair.Recording(path, min_free=0), journal)
    loop = asyncio.get_running_loop()
    recorder.start(loop.time())
    journal.start(loop)
    for number in range(count):
        journal.publish(Kind.PUT, "guest", "host", number)
    await asyncio.sleep(0.01)
    journal.close()
    await asyncio.to_thread(recorder.close)
    return recorder


@pytest.mark.real_clock
async def test_a_starved_end_has_its_note(tmp_path, monkeypatch, capsys):
    """What could not be written in time is dropped, counted, and told by ``esair log``."""
    slow(monkeypatch, 0.01)
    monkeypatch.setattr("esair.recording._recorder.LAST", 0.3)
    path = tmp_path / "run.mcap"
    recorder = await record(path, 400)
    until_it_has_ended()

    there = len(list(events_of(path)))
    end = facts_of(path)["end"]
    assert 0 < there < 400
    assert (int(end["dropped"]), int(end["events"])) == (400 - there, 400)
    assert f"{400 - there} events were not recorded" in recorder.lost()
    with pytest.raises(SystemExit):
        main(["log", str(path)])
    (told,) = capsys.readouterr().err.splitlines()
    assert told == f"esair: {path}: {400 - there} events were not recorded"


class Floods(esair.Behavior):
    """Says more than can be written."""

    async def run(self) -> None:
        for _ in range(200):
            for _ in range(20):
                self.offer(1.0, latest=True)
            logging.getLogger("esair").info("more")
            await asyncio.sleep(0)


@pytest.mark.real_clock
async def test_a_loss_is_told_with_the_stop(tmp_path, monkeypatch, caplog):
    """One warning, in the log and in what the stop says."""
    slow(monkeypatch, 0.01)
    monkeypatch.setattr("esair.recording._recorder.BACKLOG", 20)
    record = esair.Recording(tmp_path / "run.mcap", min_free=0)
    robot = esair.Robot(behaviors=[Floods()], record=record)
    with caplog.at_level(logging.INFO, "esair"):
        async with robot:
            await robot.ended()

    assert "events were not recorded: they came faster" in robot.stopped.recording
    warned = [
        r for r in caplog.records if r.levelno == logging.WARNING and "stop: " in r.msg
    ]
    assert [each.getMessage() for each in warned] == [
        f"stop: {robot.stopped.recording}"
    ]


@pytest.mark.real_clock
async def test_a_recording_without_its_end_says_so(tmp_path, capsys):
    """Its process was killed."""
    path = tmp_path / "run.mcap"
    await record(path, 50)
    path.write_bytes(path.read_bytes()[:-900])
    with pytest.raises(SystemExit):
        main(["log", str(path)])
    (told,) = capsys.readouterr().err.splitlines()
    assert "it has no end: what came last may be missing" in told


@pytest.mark.long
@pytest.mark.real_clock
def test_a_run_whose_end_was_dropped_is_repeated_up_to_there(tmp_path, monkeypatch):
    """What was not recorded is no difference, and it is said how much that is."""
    from tests.replay import robots

    from esair.replay import Replay

    slow(monkeypatch, 0.005)
    monkeypatch.setattr("esair.recording._recorder.LAST", 0.1)
    path = robots.recorded(tmp_path / "run.mcap", 1.0)
    until_it_has_ended()
    dropped = int(facts_of(path)["end"]["dropped"])
    assert dropped > 0

    outcome = Replay(path).run(robots.make())
    assert outcome.divergence is None
    assert outcome.short == f"{dropped} events were not recorded"
