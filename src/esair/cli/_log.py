"""The log on the terminal, written beside the robot and never by it."""

from __future__ import annotations

import contextlib
import copy
import io
import logging
import sys
from collections.abc import Iterator
from typing import Final

from rich.console import Console
from rich.logging import RichHandler

from esair.journal import Beside, tell_where, text_of

LAST_MOMENT: Final = 1.0  # How long the end waits for the records that wait, in seconds


@contextlib.contextmanager
def shown_log(*, verbose: bool, tracebacks: bool = False) -> Iterator[None]:
    """Show the log on the standard error while a robot runs.

    A terminal gets columns; a file or a pipe gets one line for each record. A thread of
    its own writes, so a terminal that takes nothing more (a pipe that nobody reads, a
    suspended session) never holds up the robot, nor its end.
    """
    handler = _Handler(_shown(_console()), tracebacks=verbose or tracebacks)
    log = logging.getLogger()
    levels = {"": logging.WARNING, "esair": logging.INFO, "asyncio": logging.WARNING}
    if verbose:
        levels |= {"": logging.DEBUG, "esair": logging.DEBUG}
    before = {name: logging.getLogger(name).level for name in levels}
    log.addHandler(handler)
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)
        log.removeHandler(handler)
        handler.close()


def _console() -> Console:
    try:
        # A file of its own and without a buffer: the thread that is stuck in it must not
        # hold a lock that the interpreter takes when it ends.
        file = io.FileIO(sys.stderr.fileno(), "w", closefd=False)
    except (AttributeError, OSError):  # it is closed, or no file at all
        return Console(stderr=True, highlight=False)
    text = io.TextIOWrapper(file, "utf-8", errors="replace", write_through=True)
    return Console(file=text, highlight=False)


def _shown(console: Console) -> logging.Handler:
    if console.is_terminal:
        return RichHandler(console=console, show_path=False, log_time_format="%H:%M:%S")
    handler = logging.StreamHandler(console.file)
    handler.setFormatter(
        logging.Formatter("%(asctime)s %(levelname)-8s %(message)s", "%H:%M:%S")
    )
    return handler


class _Handler(logging.Handler):
    """Hands lines to another handler, in a thread that nobody waits for."""

    def __init__(self, shown: logging.Handler, *, tracebacks: bool) -> None:
        super().__init__()
        self._tracebacks = tracebacks
        self._beside = Beside(shown.emit)  # not handle(): its lock is taken at the exit

    def emit(self, record: logging.LogRecord) -> None:
        record = copy.copy(record)
        record.msg, record.args = text_of(record), None
        if not self._tracebacks:
            tell_where(record)
        self._beside.hand(record)

    def close(self) -> None:
        """Show what waits, within a limited time."""
        self._beside.close(LAST_MOMENT)
        super().close()
