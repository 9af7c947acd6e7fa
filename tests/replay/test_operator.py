"""What an operator does comes in by the door as the rest does, and is repeated with it."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest
from tests.replay import operated
from tests.replay.test_replay import verbs

import esair
from esair.journal import Kind
from esair.recording import events_of
from esair.replay import Replay
from esair.seat import Client, RefusedActError, connect

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("REP-2", "OPS-2")]


@attrs.frozen
class Running:
    """A robot that runs in a process, and is recorded to ``run.mcap``.

    Attributes:
        folder: Where its file is.
        process: Its process.
    """

    folder: Path
    process: subprocess.Popen[bytes]

    def end(self) -> None:
        """Stop it in order."""
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(60) == 128 + signal.SIGTERM

    def acts(self) -> list[str]:
        """Return what the operator has done, in its order."""
        events = events_of(self.folder / "run.mcap")
        return [
            e.value["act"] for e in events if e.kind == Kind.OPERATOR and not e.text
        ]

    def repeats(self, *, has_end: bool = True) -> None:
        """Fail unless the run is repeated to its end, in another process."""
        code, said = verbs(self.folder, "replay", "run.mcap", hash_seed=4711)
        assert code == 0, said
        assert said.startswith("equal"), said
        assert ("compared up to" not in said) == has_end, said


@pytest.fixture
def running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Running]:
    """A beacon with a control socket."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    (tmp_path / "robot.toml").write_text(operated.FILE)
    (tmp_path / "operated.py").write_text(Path(operated.__file__).read_text())
    words = ["-m", "esair", "run", "robot.toml", "--record", "run.mcap"]
    process = subprocess.Popen(
        [sys.executable, *words],
        cwd=tmp_path,
        env={**os.environ, "PYTHONHASHSEED": "1"},
        stderr=subprocess.DEVNULL,
    )
    try:
        for _ in range(1200):
            if (tmp_path / "esair" / "beacon.sock").exists():
                break
            time.sleep(0.05)
        time.sleep(0.2)
        yield Running(tmp_path, process)
    finally:
        process.kill()
        process.wait()


def drive(client: Client, seconds: float, lease: float = 0.3) -> None:
    """Drive the horn with fresh input, as ``esair drive`` does."""
    found = client.do("lease", {"actuator": "horn", "seconds": lease})
    beat, end = found["beat"], time.monotonic() + seconds
    while time.monotonic() < end:
        fields = {"lease": found["lease"], "beat": beat, "command": random.random()}
        name = client.send("drive", fields)
        for came in client.lines(1.0):
            beat = came.get("beat", beat)
            if came.get("id") == name:  # done, or lapsed: the machine is busy
                break
        time.sleep(0.03)


def refused(client: Client, act: str, **fields: Any) -> None:
    """Do what the robot does not do."""
    with pytest.raises(RefusedActError):
        client.do(act, fields)


def until_done(client: Client, act: str, fields: dict[str, Any]) -> Any:
    """Do what a guard may forbid for a moment, and a behavior that crashes."""
    for _ in range(40):
        with contextlib.suppress(RefusedActError):
            return client.do(act, fields)
        time.sleep(0.05)
    raise AssertionError(f"{act} was never let")


@pytest.mark.long
def test_every_act_is_repeated(running: Running) -> None:
    """Settings, requests, swaps from the file, a halt, driving: to the end."""
    file = running.folder / "robot.toml"
    with connect("beacon") as client:
        client.do("set", {"setting": "lamp.power", "value": 1.5})
        refused(client, "set", setting="lamp.power", value=7.0)
        refused(client, "set", setting="lmp.power", value=1.0)  # nobody has it
        client.do("put", {"receiver": "shine", "data": 0.7})
        client.do("put", {"receiver": "shine", "data": "bright"})  # it crashes
        assert client.do("status")["robot"] == "beacon"
        client.do("restart", {"name": "shine"})
        blink = {"receiver": "shine", "request": "Blink", "fields": {"times": 3}}
        assert until_done(client, "ask", blink) == 3
        refused(client, "ask", receiver="shine", request="Blnk")
        measure = {"resource": "lamp", "operation": "measure", "fields": {"times": 2}}
        until_done(client, "operate", measure)
        client.do("mute", {"name": "dim", "seconds": 0.1, "reason": "a trial"})
        client.do("remove", {"name": "spare"})
        client.do("add", {"name": "spare"})
        file.write_text(file.read_text().replace("level = 0.5", "level = 0.9"))
        client.do("replace", {"name": "shine"})
        client.do("replace", {"name": "horn"})
        file.write_text(file.read_text().replace("level", "levl"))
        refused(client, "replace", name="shine")
        file.write_text("")  # a replay needs what it was then
        drive(client, 0.4)
        client.do("stop", {"reason": "a cat"})
        time.sleep(0.1)
        client.do("resume")
        drive(client, 0.4)  # and it vanishes while it drives
    time.sleep(0.2)
    running.end()
    file.write_text(operated.FILE)

    acts = running.acts()
    assert {"set", "put", "ask", "operate", "add", "replace", "drive"} < {*acts}
    assert acts.count("drive") > 5
    running.repeats()


@pytest.mark.long
def test_a_lease_that_lapses_is_repeated(running: Running) -> None:
    """By want of input, and by input that answers an old beat."""
    with connect("beacon") as client:
        found = client.do("lease", {"actuator": "horn", "seconds": 0.3})
        fields = {"lease": found["lease"], "beat": found["beat"], "command": 0.7}
        client.do("drive", fields)
        time.sleep(0.5)
        refused(client, "drive", **fields)
        again = client.do("lease", {"actuator": "horn", "seconds": 0.3})
        refused(client, "drive", **{**fields, "lease": again["lease"]})
    running.end()

    running.repeats()


@pytest.mark.long
def test_a_file_that_was_killed_is_repeated_up_to_there(running: Running) -> None:
    """The acts are in it as the readings are."""
    with connect("beacon") as client:
        drive(client, 1.2)
    time.sleep(0.5)
    running.process.kill()
    running.process.wait()

    assert running.acts().count("drive") > 3
    running.repeats(has_end=False)


@pytest.mark.long
def test_a_secret_is_not_kept(running: Running) -> None:
    """The run is repeated up to there, and it says so."""
    with connect("beacon") as client:
        client.do("set", {"setting": "lamp.code", "value": "open-sesame"})
    time.sleep(0.3)
    running.end()

    assert b"open-sesame" not in (running.folder / "run.mcap").read_bytes()
    code, said = verbs(running.folder, "replay", "run.mcap")
    assert code == 0
    assert "an operator has set a secret there" in said


class Types(esair.Behavior):
    """Operates the robot itself, by the words that people type."""

    robot: esair.Robot

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.robot.behaviors.command(f"put shine {esair.random.random()}")


def made(record: Path | None = None) -> esair.Robot:
    """Return a beacon that operates itself."""
    types = Types()
    types.robot = esair.Robot(
        resources=[operated.Light(), operated.Lamp()],
        behaviors=[operated.Shine(), types],
        record=None if record is None else esair.Recording(record, min_free=0),
    )
    return types.robot


def test_what_a_component_types_is_done_once(tmp_path: Path) -> None:
    """It types again in the replay: the file does not do it a second time."""
    path = tmp_path / "run.mcap"
    esair.run(made(path), duration=0.5)
    outcome = Replay(path).run(made())

    assert outcome.divergence is None
    assert outcome.short == ""
    assert [e.value["act"] for e in events_of(path) if e.kind == Kind.OPERATOR]
