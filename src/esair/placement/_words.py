"""What a child writes: its log and its prints, under its name; the last of it is kept."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
from typing import Final

from esair.exceptions import printable
from esair.loop import clock_of

KEPT: Final = 2000
"""How many characters of what a child has written last are kept."""

LINES: Final = 200
"""How many lines of a child are logged in a second."""

RECORD: Final = "\x1e"
"""What a line begins with that is a record of the log."""

_log = logging.getLogger("esair")


class Words:
    """Reads the pipe that a child writes to, and logs its lines."""

    def __init__(self, name: str, pipe: int, loop: asyncio.AbstractEventLoop) -> None:
        self._name = name
        self._pipe = pipe
        self._loop = loop
        self._time = clock_of(loop)
        self._kept = ""
        self._begun = b""  # a line that has no end yet
        self._since, self._count = 0.0, 0
        loop.add_reader(pipe, self._heard)

    def last(self) -> str:
        """Return what was written last, all that is there."""
        for _ in range(8):
            self._heard()
        return (self._kept + self._begun.decode(errors="replace")).strip()[-KEPT:]

    def close(self) -> None:
        self._heard()
        if not self._loop.is_closed():
            self._loop.remove_reader(self._pipe)
        os.close(self._pipe)

    def _heard(self) -> None:
        try:
            data = os.read(self._pipe, 1 << 14)
        except BlockingIOError:
            return
        if not data:
            self._loop.remove_reader(self._pipe)
            return
        *lines, rest = (self._begun + data).split(b"\n")
        self._begun = rest[-KEPT:]
        for line in lines:
            self._say(line.decode(errors="replace"))

    def _say(self, line: str) -> None:
        level, name, text = logging.INFO, "esair", f"{self._name}: {line}"
        if line.startswith(RECORD):
            with contextlib.suppress(ValueError, TypeError, KeyError):
                record = json.loads(line[1:])
                level, name = int(record["level"]), str(record["name"])
                line = str(record["text"])
                text = f"{self._name}: {line}" if name == "esair" else line
        self._kept = f"{self._kept}{line}\n"[-KEPT:]
        now = self._time()
        if now - self._since >= 1.0:
            self._since, self._count = now, 0
        self._count += 1
        if self._count <= LINES:
            logging.getLogger(name).log(level, "%s", printable(text))
        elif self._count == LINES + 1:
            told = "%s: writes too much; the rest of this second is left out"
            _log.warning(told, self._name)
