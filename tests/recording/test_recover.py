"""A recording that was cut: whatever is readable is there."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import esair
from esair.journal import Journal, Kind
from esair.recording import Recorder, events_of, facts_of, is_whole, recover
from esair.recording._recorder import Segment
from esair.recording._recover import left_cut

pytest.importorskip("foxglove", reason="needs esair[record]")


def write(path: Path, count: int) -> None:
    """Write a whole recording of some events."""

    async def main() -> None:
        journal = Journal()
        recorder = Recorder(esair.Recording(path), journal)
        loop = asyncio.get_running_loop()
        recorder.start(loop.time())
        journal.start(loop)
        for number in range(count):
            journal.publish(Kind.PUT, "guest", "host", {"n": number, "text": "x" * 50})
            if number % 20 == 19:
                await asyncio.to_thread(time.sleep, 0.25)  # a chunk of its own
        journal.close()
        await asyncio.to_thread(recorder.close)

    asyncio.run(main())


@pytest.mark.long
@pytest.mark.promise("REC-3")
@pytest.mark.fault("P03")
@pytest.mark.real_clock
def test_any_cut_at_any_byte_is_readable(tmp_path: Path) -> None:
    """No exception, and more bytes never give fewer messages."""
    path = tmp_path / "run.mcap"
    write(path, 60)
    data = path.read_bytes()
    counts = []
    for size in range(0, len(data) + 1, 13):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[:size])
        try:
            counts.append(len(list(events_of(cut))))
        except esair.RecordingBrokenError:
            assert size < 100
            counts.append(0)
    assert counts == sorted(counts)
    assert counts[-1] == 60


@pytest.mark.promise("REC-3")
@pytest.mark.fault("P04")
@pytest.mark.real_clock
def test_what_has_no_beginning_is_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It is no recording: then no place in it is told, too."""
    path = tmp_path / "run.mcap"
    write(path, 1)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"esair", b"\xff" * 5, 1))
    with pytest.raises(esair.RecordingBrokenError, match="no recording of esair"):
        recover(path)
    assert caplog.messages == []


@pytest.mark.long
@pytest.mark.promise("REC-3")
@pytest.mark.fault("P04")
@pytest.mark.real_clock
def test_a_damaged_byte_costs_its_chunk_and_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Whichever: no exception, nothing that was never written, and where it is."""
    path = tmp_path / "run.mcap"
    write(path, 60)
    data, whole = path.read_bytes(), list(events_of(path))
    assert len(whole) == 60
    assert caplog.messages == []
    lost = 0
    for offset in range(100, len(data), 17):
        damaged = bytearray(data)
        damaged[offset] ^= 0x55
        path.write_bytes(damaged)
        caplog.clear()
        found = list(events_of(path))
        assert all(event in whole for event in found)
        if len(found) < 60 and caplog.messages:
            lost += 1
            (told,) = caplog.messages
            begin, _, rest = told.partition("byte ")
            where = int(rest.removesuffix(", left out"))
            assert begin == f"{path}: damaged at "
            assert where <= offset
    assert lost > 20


@pytest.mark.promise("REC-3")
@pytest.mark.real_clock
def test_what_is_recovered_has_an_index_and_the_original_stays(tmp_path: Path) -> None:
    """Another program's reader takes it; the cut file has not changed."""
    from mcap.reader import SeekingReader

    path, cut = tmp_path / "run.mcap", tmp_path / "cut.mcap"
    write(path, 60)
    cut.write_bytes(path.read_bytes()[:-700])
    before = cut.read_bytes()
    found = recover(cut)
    assert not found.was_whole
    assert cut.read_bytes() == before
    assert is_whole(found.path)
    with found.path.open("rb") as file:
        messages = list(SeekingReader(file).iter_messages())
    assert len(messages) == found.messages == len(list(events_of(cut)))


@pytest.mark.promise("REC-4")
@pytest.mark.real_clock
def test_what_is_damaged_was_not_whole(tmp_path: Path) -> None:
    """Also where its end is there: zeros in it, and a bit that is another."""
    path, damaged = tmp_path / "run.mcap", tmp_path / "damaged.mcap"
    write(path, 60)
    data = path.read_bytes()
    assert recover(path).was_whole
    place = data.index(b"zstd") + 50  # in a chunk
    for begin, part in ((place, bytes(200)), (place, bytes([data[place] ^ 1]))):
        damaged.write_bytes(data[:begin] + part + data[begin + len(part) :])
        assert not recover(damaged).was_whole


@pytest.mark.promise("REC-3")
@pytest.mark.real_clock
def test_the_oldest_segment_is_recovered_where_the_first_is_gone(
    tmp_path: Path,
) -> None:
    """The name of the recording means what is left of it, as when it is read."""
    write(tmp_path / "run.2.mcap", 1)
    found = recover(tmp_path / "run.mcap")
    assert found.path == tmp_path / "run.2-recovered.mcap"
    assert found.messages == 1


@pytest.mark.promise("REC-3")
@pytest.mark.real_clock
def test_a_later_segment_that_has_not_begun_hides_no_earlier_one(
    tmp_path: Path,
) -> None:
    """The power went, or the disk was full, as it was made."""
    write(tmp_path / "run.mcap", 3)
    (tmp_path / "run.2.mcap").write_bytes(b"")
    assert len([*events_of(tmp_path / "run.mcap")]) == 3
    assert facts_of(tmp_path / "run.mcap")["clock"]


DRIVER = """
import asyncio, sys, time
import esair
from esair.journal import Journal, Kind
from esair.recording import Recorder

async def main():
    journal = Journal()
    recorder = Recorder(esair.Recording(sys.argv[1]), journal)
    loop = asyncio.get_running_loop()
    recorder.start(loop.time())
    journal.start(loop)
    number = 0
    while True:
        journal.publish(Kind.PUT, "guest", "host", number)
        print(number, time.monotonic(), flush=True)
        number += 1
        await asyncio.sleep(float(sys.argv[2]))

asyncio.run(main())
"""


@pytest.mark.long
@pytest.mark.promise("REC-3")
@pytest.mark.real_clock
def test_after_a_kill_all_but_half_a_second_is_there(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Killed at any moment, a quiet robot too; two hundred times with --esair-soak.

    Another program reads what is recovered of it.
    """
    from mcap.reader import SeekingReader

    for number in range(200 if request.config.getoption("--esair-soak") else 2):
        path = tmp_path / str(number) / "run.mcap"
        path.parent.mkdir()
        pause = 0.002 if number % 4 else 0.1
        words = [sys.executable, "-c", DRIVER, str(path), str(pause)]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        first = process.stdout.readline()  # it may take its time to start
        time.sleep(0.55 + 0.037 * (number % 20))
        os.kill(process.pid, signal.SIGKILL)
        killed = time.monotonic()
        lines, _ = process.communicate()
        told = [line.split() for line in (first + lines).splitlines()]
        before = [int(n) for n, when in told[:-1] if float(when) < killed - 0.5]
        there = {event.value for event in events_of(path)}
        assert before
        assert set(before) <= there, f"{len(set(before) - there)} are missing"
        with recover(path).path.open("rb") as file:
            messages = [
                message.data for *_, message in SeekingReader(file).iter_messages()
            ]
        assert {json.loads(data)["value"] for data in messages} == there


@pytest.mark.real_clock
def test_the_next_start_makes_whole_what_was_cut(tmp_path: Path) -> None:
    """By itself, in a process of its own."""
    path = tmp_path / "run.mcap"
    write(path, 40)
    path.write_bytes(path.read_bytes()[:-700])
    write(tmp_path / "next.mcap", 1)
    new = tmp_path / "run-recovered.mcap"
    end = time.monotonic() + 20.0
    while not new.exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert is_whole(new)
    assert not is_whole(path)


@pytest.mark.promise("REC-3")
@pytest.mark.real_clock
def test_what_another_robot_is_writing_is_not_cut(tmp_path: Path) -> None:
    """Else a half of it would be recovered, and after its kill nothing more."""
    writing = Segment(tmp_path / "writing.mcap")
    shutil.copy(tmp_path / "writing.mcap", tmp_path / "left.mcap")

    assert left_cut(tmp_path) == [tmp_path / "left.mcap"]

    writing._out.close()  # as its process ends
    assert left_cut(tmp_path) == [tmp_path / "left.mcap", tmp_path / "writing.mcap"]
