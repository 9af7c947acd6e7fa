"""``esair log``, ``plot`` and ``recover``: recordings for people."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import esair
from esair.cli import main
from esair.cli._errors import is_no_picture
from esair.cli._log_file import _print
from esair.journal import Journal, Kind
from esair.messages import Reading
from esair.recording import Recorder, is_whole

pytest.importorskip("foxglove", reason="needs esair[record]")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A small recording with a reading, a command, a loss and a forged line."""

    async def record() -> None:
        journal = Journal()
        recorder = Recorder(esair.Recording(tmp_path / "run.mcap"), journal)
        loop = asyncio.get_running_loop()
        recorder.start(loop.time())
        journal.start(loop)
        for number in range(5):
            reading = Reading(0.1 * number, loop.time(), number + 1)
            journal.publish(Kind.READING, "sonar", "", reading)
            journal.publish(Kind.SENT, "wheels", "wander", (0.3, 0.0))
        journal.publish(Kind.DOWN, "sonar", "", None, "gone\n12:00:00 up sonar\x1b[2J")
        journal.publish(Kind.SAFE, "wheels", "", (0.0, 0.0))
        journal.close()
        await asyncio.to_thread(recorder.close)

    asyncio.run(record())
    return tmp_path / "run.mcap"


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return int(ended.value.code or 0)


@pytest.mark.promise("REC-6")
def test_log_prints_a_line_for_each_event(recording: Path, capsys) -> None:
    """What happened, to whom, by whom, with the value."""
    assert run("log", recording) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 12
    assert lines[1].endswith("sent       wander > wheels [0.3, 0.0]")


@pytest.mark.long
def test_a_reader_that_has_seen_enough_is_no_error(recording: Path) -> None:
    """``esair log FILE | head`` ends without a word."""
    code = f"from esair.cli import main; main(['log', {str(recording)!r}])"
    read, write = os.pipe()
    os.close(read)
    try:
        ended = subprocess.run(
            [sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE
        )
    finally:
        os.close(write)
    assert (ended.returncode, ended.stderr) == (0, b"")


@pytest.mark.promise("SEC-1")
def test_nothing_in_a_recording_forges_a_line(recording: Path, capsys) -> None:
    """Line ends and escapes of a device are shown as their numbers."""
    assert run("log", recording, "--kind", "down") == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.endswith(r"gone\n12:00:00 up sonar\x1b[2J")


def test_log_can_be_of_one_component_and_for_machines(recording: Path, capsys) -> None:
    """Those of others are left out; each line is an object."""
    assert run("log", recording, "-c", "sonar", "--json") == 0
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [each["kind"] for each in told] == ["reading"] * 5 + ["down"]


def test_a_refusal_is_told_without_times_that_are_no_clocks(capsys) -> None:
    """Who holds it and why; since and until are numbers of the loop's clock."""
    refused = {"holder": "avoid", "priority": 10, "rule": "r", "since": 1.5, "until": 9}
    event = {"kind": "refused", "component": "wheels", "peer": "wander", "text": ""}
    _print(0.0, {**event, "value": refused})

    line = capsys.readouterr().out
    assert line.endswith('{"holder": "avoid", "priority": 10, "rule": "r"}\n')


@pytest.mark.promise("REC-6")
def test_what_is_long_is_shown_shortly_to_people(tmp_path: Path, capsys) -> None:
    """An array by its shape, a list by its first items; programs get all of it."""
    np = pytest.importorskip("numpy")
    values = {"map": np.zeros((88, 128), np.float32), "ranges": [0.5] * 500}

    async def record() -> None:
        journal = Journal()
        recorder = Recorder(esair.Recording(tmp_path / "run.mcap"), journal)
        loop = asyncio.get_running_loop()
        recorder.start(loop.time())
        journal.start(loop)
        journal.publish(Kind.PUT, "explore", "mapper", values)
        journal.close()
        await asyncio.to_thread(recorder.close)

    asyncio.run(record())
    assert run("log", tmp_path / "run.mcap") == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert "float32 array of 88 x 128" in line
    assert "... 492 more" in line
    assert len(line) < 300
    assert run("log", tmp_path / "run.mcap", "--json") == 0
    assert len(json.loads(capsys.readouterr().out)["value"]["ranges"]) == 500


@pytest.mark.promise("REC-6")
@pytest.mark.long
def test_plot_draws_a_picture(recording: Path, capsys) -> None:
    """A PNG beside the recording, not empty."""
    pytest.importorskip("matplotlib", reason="needs esair[sim]")
    assert run("plot", recording) == 0
    picture = recording.with_name(f"{recording.stem}-plot.png")
    assert capsys.readouterr().out.strip() == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 10_000


def test_the_kind_of_a_picture_may_be_in_capitals(tmp_path: Path, capsys) -> None:
    """Some write so, and it is drawn; a misspelling is told all the same."""
    pytest.importorskip("matplotlib", reason="needs esair[sim]")
    kinds = [is_no_picture(tmp_path / name) for name in ("a.PNG", "a.SVG", "a.PGN")]
    assert kinds == [False, False, True]
    assert "there is no 'pgn'; did you mean 'png'?" in capsys.readouterr().err


def test_recover_makes_a_cut_file_whole(recording: Path, capsys) -> None:
    """The new file is named, the old one stays."""
    cut = recording.with_name("cut.mcap")
    cut.write_bytes(recording.read_bytes()[:-50])
    assert run("recover", cut) == 0
    assert "12 messages; it was cut" in capsys.readouterr().out
    assert is_whole(cut.with_name("cut-recovered.mcap"))


@pytest.mark.parametrize("verb", ["log", "plot", "recover"])
def test_a_file_that_is_none_is_told(verb: str, tmp_path: Path, capsys) -> None:
    """One line and exit code 2, no traceback."""
    wrong = tmp_path / "wrong.mcap"
    wrong.write_text("no recording")
    assert run(verb, wrong) == 2
    assert capsys.readouterr().err.startswith("esair: ")
    assert run(verb, tmp_path / "nowhere.mcap") == 2


@pytest.mark.parametrize("verb", ["log", "recover", "replay"])
@pytest.mark.parametrize("package", ["lz4", "zstandard"])
def test_what_reads_recordings_is_an_extra(
    recording: Path, monkeypatch, capsys, verb: str, package: str
) -> None:
    """Who has the command line alone hears what to install."""
    monkeypatch.setitem(sys.modules, package, None)
    assert run(verb, recording) == 2
    assert 'pip install "esair[record]"' in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("verb", ["log", "plot", "recover", "replay"])
def test_a_file_that_is_no_recording_is_one_line(verb, tmp_path, capsys) -> None:
    """Which file, and what is the matter with it; exit code 2."""
    if verb == "plot":
        pytest.importorskip("matplotlib", reason="needs esair[sim]")
    text = tmp_path / "robot.toml"
    text.write_text("[robot]\n")
    for file, why in (
        (tmp_path / "none.mcap", "there is no such file"),
        (text, "it is no recording of esair"),
    ):
        assert run(verb, file) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{file}: {why}" in line


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["log", "-c", "weels"], "--component: there is no 'weels'; did you mean 'whe"),
        (["plot", "-c", "gps"], "--component: there is no 'gps'; there are sonar, wh"),
        (["plot", "-o", "run.pgn"], "--out: there is no 'pgn'; did you mean 'png'?"),
        (["log", "-k", "refusd"], "--kind: there is no 'refusd'; did you mean 'refus"),
    ],
)
def test_a_name_that_selects_nothing_is_told(words, told, recording, capsys) -> None:
    """A misspelling is no empty answer."""
    verb, *options = words
    assert run(verb, recording, *options) == 2
    said = capsys.readouterr()
    assert told in said.err
    assert said.out == ""
