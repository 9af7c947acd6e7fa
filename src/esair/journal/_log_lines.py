"""Lines of esair's log as events."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading

from esair.exceptions import told_traceback
from esair.journal._event import Kind
from esair.journal._journal import Journal, here


def escape_traceback(record: logging.LogRecord) -> bool:
    """Escape the traceback of a line, before any handler has it."""
    if record.exc_info and record.exc_info[1] is not None and not record.exc_text:
        record.exc_text = told_traceback(record.exc_info[1])
    return True


logging.getLogger("esair").addFilter(escape_traceback)


class LogLines(logging.Handler):
    """Publishes each line of esair's log in the journals of the robots that run.

    A line that another thread writes is published in the loop, not in that thread.
    Python prints warnings that no handler takes; this one takes them from nobody.
    """

    def __init__(self, journal: Journal) -> None:
        super().__init__(logging.INFO)
        self._journal = journal
        self._loop = asyncio.get_running_loop()
        self._home = threading.get_ident()
        self._inside = False

    def start(self) -> None:
        """Begin to hear the log."""
        logging.getLogger("esair").addHandler(self)

    def stop(self) -> None:
        """Hear it no more."""
        logging.getLogger("esair").removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a line; one that the journal or a listener causes is left out."""
        resort = logging.lastResort
        if resort and record.levelno >= resort.level and self._is_alone(record.name):
            resort.handle(record)
        if self._inside or here.is_telling or not self._journal.heard:
            return
        if self._loop.is_closed():
            return  # closed under a robot that was not stopped: others go on
        try:
            text = record.getMessage()
        except Exception as error:  # a line that cannot be formatted
            text = f"{record.msg!r:.80} cannot be formatted: {type(error).__name__}"
        level = record.levelname.lower()
        if threading.get_ident() == self._home:
            self._publish(record.name, level, text)
            return
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._publish, record.name, level, text)

    def _is_alone(self, name: str) -> bool:
        """Whether this is the first handler of a logger, and all others are its like."""
        heard: list[logging.Handler] = []
        logger: logging.Logger | None = logging.getLogger(name)
        while logger is not None:
            heard += logger.handlers
            logger = logger.parent if logger.propagate else None
        return heard[0] is self and all(isinstance(each, LogLines) for each in heard)

    def _publish(self, name: str, level: str, text: str) -> None:
        self._inside = True
        try:
            self._journal.publish(Kind.LOG, name, level, None, text)
        finally:
            self._inside = False
