"""The start of a robot's recording; a robot that cannot record starts all the same.

Its file is kept without what nobody may read in a recording.
"""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import hashlib
import json
import logging
import os.path
import sys
import tomllib
import weakref
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final

from esair.exceptions import ConfigError, RecordingError, describe
from esair.loop import TapeWriter, turn_of
from esair.messages import Recording, is_placed
from esair.resources import Resource, settings_of

if TYPE_CHECKING:
    from pathlib import Path

    from esair.recording import Recorder
    from esair.standard._robot import Robot


_BEGUN: Final = weakref.WeakSet[asyncio.AbstractEventLoop]()
"""In which event loops a robot has begun: their turns hold what all of them do."""

_TOKENS: Final = {"token"}
"""What of the page is for its user alone."""


def public_text(text: str, resources: Iterable[Resource]) -> str:
    """Return a robot.toml without the page's token and the values of secret settings.

    Comments are gone, too: a secret may stand in one. A setting whose value is not
    there has its default.

    Args:
        text: What the file says.
        resources: Those that were made of it.
    """
    try:
        data = tomllib.loads(text)
    except ValueError:
        return ""  # it has changed since, and nobody can tell what it says
    secrets = {
        each.name: {name for name, it in settings_of(type(each)).items() if it.secret}
        for each in resources
    }
    for kind in ("sensor", "actuator"):
        tables = data.get(kind)
        for name, table in tables.items() if isinstance(tables, dict) else ():
            _drop(table, secrets.get(name, set()))
    for table in (data, data.get("robot")):
        if isinstance(table, dict):
            _drop(table.get("page"), _TOKENS)
    return "".join(_lines(data, ()))


def _drop(table: Any, names: set[str]) -> None:
    """Take keys out of a table, and of those in it: the simulated part, say."""
    if not isinstance(table, dict):
        return
    for name in names:
        table.pop(name, None)
    for each in table.values():
        _drop(each, names)


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterable[str]:
    """Yield the lines of a table in TOML."""
    inner = {name: each for name, each in table.items() if isinstance(each, dict)}
    if path and (len(inner) < len(table) or not inner):
        yield f"[{'.'.join(map(_text, path))}]\n"
    for name, value in table.items():
        if name not in inner:
            yield f"{_text(name)} = {_value(value)}\n"
    for name, each in inner.items():
        yield from _lines(each, (*path, name))


def _value(value: Any) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_text(k)} = {_value(v)}' for k, v in value.items())}}}"
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return json.dumps(value).replace("Infinity", "inf").replace("NaN", "nan")


def _text(text: str) -> str:
    """Return a text as TOML has it: as JSON does, but for one character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


FORMAT = "4"  # that of the turns in a recording

OWN: Final = "program"
"""The script of a run that the robot's own program has driven: nobody else has it."""

_log = logging.getLogger("esair")


def repeats(loop: asyncio.AbstractEventLoop) -> bool:
    """Tell whether a loop repeats a run: then there is nothing outside of the robot."""
    return turn_of(loop).player is not None


class Keeping:
    """Keeps a run from its start to its end, or repeats one that was kept."""

    def __init__(self, recording: Recording | None) -> None:
        if recording is not None and not isinstance(recording, Recording):
            told = f"expected esair.Recording(path), not {recording!r:.80}"
            raise ConfigError("robot", "record", told)
        self.recording = recording
        self.duration: float | None = None
        """After how many seconds `run` stops the robot."""
        self.has_seat = False
        self.script: tuple[str, dict[str, Any]] = OWN, {}
        """What repeats the run, empty for `run` alone, and with which options."""
        self.recorder: Recorder | None = None
        self._keeps = False  # the turns of its loop
        self._is_first = True  # that has begun in it

    def begin(self, robot: Robot) -> None:
        loop = asyncio.get_running_loop()
        turn = turn_of(loop)
        if repeats(loop):
            turn.play()
            return
        self._is_first = loop not in _BEGUN
        _BEGUN.add(loop)
        if isinstance(turn.door.tape, TapeWriter):
            turn.door.tape.spoil("another robot has begun in its event loop")
        if self.recording is None:
            return
        plan, journal = robot.plan, robot.journal
        parts = [*plan.resources, *plan.behaviors]
        file, simulated = robot.source or (None, False)
        raw = b"" if file is None else file.read_bytes()
        text = public_text(raw.decode("utf-8", "replace"), plan.resources)
        digest = "" if file is None else hashlib.sha256(raw).hexdigest()
        try:
            from esair.recording import Recorder, facts_about

            recorder = Recorder(
                self.recording,
                journal,
                name=plan.name,
                facts=facts_about(plan.name, parts, text, str(robot.seed)),
                components=lambda: components_of(robot),
                waits=turn.virtual,
            )
            about = self._replay(loop, file, simulated=simulated)
            placed = json.dumps([each.name for each in parts if is_placed(each)])
            recorder.note("replay", {**about, "sha256": digest, "placed": placed})
            journal.count("recording", lambda: [("recording", recorder.counts())])
            if about["exact"] == "yes" and turn.repeats:
                turn.keep(recorder.keep_turns())
                self._keeps = True
            recorder.start(turn.clock())
            self.recorder = recorder
        except ImportError as error:
            told = f"it needs {error.name}: pip install 'esair[record]'"
            raise ConfigError("recording", "", told) from error
        except RecordingError as error:
            _log.error("%s; the robot starts without it", describe(error))

    def _replay(
        self, loop: asyncio.AbstractEventLoop, file: Path | None, *, simulated: bool
    ) -> dict[str, str]:
        """Return what a replay has to know of the run."""
        turn = turn_of(loop)
        why = ""
        if turn.virtual and self.script[0] in {"", OWN}:
            why = "its time was virtual: its own test or program repeats it"
        elif not turn.virtual and not turn.repeats:
            why = f"its event loop is {type(loop).__name__}: esair.run brings its own"
        elif not self._is_first:
            why = "another robot was run in its event loop"
        return {
            "format": FORMAT,
            "exact": "no" if why else "yes",
            "why": why,
            "clock": "virtual" if turn.virtual else "real",
            "program": _program(),
            "file": "" if file is None else file.name,
            "simulated": "yes" if simulated else "no",
            "duration": "" if self.duration is None else repr(self.duration),
            "seat": "yes" if self.has_seat else "no",
            "script": self.script[0],
            "options": json.dumps(self.script[1]),
        }

    async def end(self) -> str:
        """Write what waits; return what the recording lacks, in words."""
        if self.recorder is None:
            return ""
        loop = asyncio.get_running_loop()
        if self._keeps:
            turn_of(loop).keep(None)
        # No thread is left behind, as one of the loop's own would be.
        with ThreadPoolExecutor(1, "esair-recorder-end") as last:
            await loop.run_in_executor(last, self.recorder.close)
        lost = self.recorder.lost()
        if lost:
            _log.warning("stop: %s", lost)
        return lost


def components_of(robot: Robot) -> list[Any]:
    """Return a robot's components: those it started with, and those it has now."""
    plan, resources, behaviors = robot.plan, robot.resources, robot.behaviors
    found: list[Any] = [*plan.resources, *plan.behaviors]
    with contextlib.suppress(LookupError):  # one was removed meanwhile
        found += map(resources.get, resources.names())
        found += map(behaviors.action, behaviors.names())
    return found


def _program() -> str:
    """Return the file of the program that runs; empty if it has none."""
    file = getattr(sys.modules.get("__main__"), "__file__", None)
    return "" if file is None else os.path.realpath(file)
