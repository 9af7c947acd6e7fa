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

NAMES: Final = 64
"""How many loggers a child may name that nobody else has: they are kept for ever."""

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
        self._names: set[str] = set()
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
        now = self._time()
        if now - self._since >= 1.0:
            self._since, self._count = now, 0
        room = max(0, LINES - self._count)
        for line in lines[:room]:
            self._say(line.decode(errors="replace"))
        is_first = self._count <= LINES
        self._count += len(lines)
        if self._count <= LINES:
            return
        if is_first:
            told = "%s: writes too much; the rest of this second is left out"
            _log.warning(told, self._name)
        self._keep(b"\n".join(lines[-KEPT:])[-KEPT:].decode(errors="replace"))

    def _say(self, line: str) -> None:
        level, name, text = logging.INFO, "esair", f"{self._name}: {line}"
        if line.startswith(RECORD):
            with contextlib.suppress(Exception):  # whatever such a line leads to
                record = json.loads(line[1:])
                level, name = int(record["level"]), self._logger(record["name"])
                line = str(record["text"])
                text = f"{self._name}: {line}" if name == "esair" else line
        self._keep(line)
        logging.getLogger(name).log(level, "%s", printable(text))

    def _keep(self, line: str) -> None:
        self._kept = f"{self._kept}{line}\n"[-KEPT:]

    def _logger(self, name: object) -> str:
        """Return the name of a logger that a child may use."""
        found = printable(str(name))[:200]
        if found in logging.root.manager.loggerDict or found in self._names:
            return found
        if len(self._names) >= NAMES:
            return "esair"
        self._names.add(found)
        return found
