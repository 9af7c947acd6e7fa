"""Lines of esair's log: shown beside the robots that run, and events of theirs."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import logging
import os
import queue
import select
import threading
import time
from collections import Counter
from collections.abc import Callable

from esair.exceptions import describe, line_of, told_traceback, wants_traceback
from esair.journal._journal import Journal, Kind, here
from esair.loop import turn_of

LIMIT = 1000
"""How many lines may wait to be shown; what comes then is dropped and counted."""

OFTEN = 20
"""How many lines of one source are shown in a second; others are counted, and said."""

LAST_MOMENT = 0.5
"""How long a robot that has stopped waits for its last lines to be shown, in seconds."""

_LOOK = 50  # how often it is asked whether a pipe takes something again, in ms


def escape_traceback(record: logging.LogRecord) -> bool:
    """Escape the traceback of a line, before any handler has it.

    Where nobody has set up logging a script shows what matters, and where it was.
    """
    if not handlers_of("esair") and not wants_traceback():
        tell_where(record)
    if record.exc_info and record.exc_info[1] is not None and not record.exc_text:
        record.exc_text = told_traceback(record.exc_info[1])
    return True


def tell_where(record: logging.LogRecord) -> None:
    """Let the user's own line by which an error came stand for its traceback."""
    error = record.exc_info and record.exc_info[1]
    place = line_of(error) if error else ""
    record.exc_info, record.exc_text = None, f"  where: {place}" if place else None


def contained(
    handle: Callable[[logging.LogRecord], None],
) -> Callable[[logging.LogRecord], None]:
    """Have no filter and no handler end whoever writes a line, be it the loop itself."""

    def handle_line(record: logging.LogRecord) -> None:
        try:
            handle(record)
        except Exception:
            _nobodys.handleError(record)

    return handle_line


_nobodys = logging.Handler()  # says by what it was raised, as Python's own handlers do
_log = logging.getLogger("esair")
_log.addFilter(escape_traceback)
_log.handle = contained(_log.handle)  # type: ignore[assignment,method-assign]


class Beside:
    """Shows lines in a thread of its own; a source that floods leaves the others room.

    The source of a line is what stands before its second colon: ``wheels: lost``.

    Args:
        show: Shows one line; what it raises is nobody's, the next may be better.
    """

    def __init__(self, show: Callable[[logging.LogRecord], object]) -> None:
        self.dropped: int = 0
        self._show = show
        self._told = 0  # of those that were dropped
        self._second: Counter[str] = Counter()  # lines by their source
        self._ends = 0.0  # that second
        # Not a Queue: a signal handler may log amid the line that it interrupts.
        self._waiting: queue.SimpleQueue[
            logging.LogRecord | Callable[[], object] | None
        ] = queue.SimpleQueue()
        self.thread: threading.Thread = threading.Thread(
            target=self._work, name="esair-log", daemon=True
        )
        self.thread.start()

    def hand(self, record: logging.LogRecord) -> None:
        """Have a line shown, from any thread; its text stays as it is."""
        if self._waiting.qsize() < LIMIT:
            self._waiting.put(record)
        else:
            self.dropped += 1

    def call(self, function: Callable[[], object]) -> None:
        """Have something called in the thread when what waits now is shown."""
        self._waiting.put(function)

    def close(self, within: float) -> None:
        """Show what waits, and end; waited for no longer than so many seconds."""
        self._waiting.put(None)
        self.thread.join(within)

    def _work(self) -> None:
        while (each := self._next()) is not None:
            with contextlib.suppress(Exception):
                if not isinstance(each, logging.LogRecord):
                    each()
                elif not self._is_too_often(each):
                    self._show(each)
                    if (dropped := self.dropped - self._told) > 0:
                        self._told += dropped
                        self._say(f"{dropped} lines were dropped: they came too fast")
        self._say_what_was_too_often()

    def _next(self) -> logging.LogRecord | Callable[[], object] | None:
        """Wait for what comes next, and say at its end what a second had too often."""
        while True:
            left = self._ends - time.monotonic()
            if left <= 0:
                self._say_what_was_too_often()
            with contextlib.suppress(queue.Empty):
                return self._waiting.get(timeout=left if self._second else None)

    def _is_too_often(self, record: logging.LogRecord) -> bool:
        if not self._second:
            self._ends = time.monotonic() + 1.0
        source = ":".join(str(record.msg).split(":", 2)[:2])
        self._second[source] += 1
        return self._second[source] > OFTEN

    def _say_what_was_too_often(self) -> None:
        for source, count in self._second.items():
            if count > OFTEN:
                more = f"{count - OFTEN} more lines in a second"
                self._say(f"{more} were left out: {source!r}")
        self._second.clear()

    def _say(self, text: str) -> None:
        line = "esair", logging.WARNING, __file__, 0, text, None, None
        with contextlib.suppress(Exception):
            self._show(logging.LogRecord(*line))


def text_of(record: logging.LogRecord) -> str:
    """Return the text of a line, even of one that cannot be formatted."""
    try:
        return record.getMessage()
    except Exception as error:  # the caller's mistake, or a __str__ of anybody
        return f"a line of {record.name!r} cannot be shown: {describe(error)}"


class Words:
    """What esair and asyncio say while robots run; one for the process, counted.

    No effect may wait for whoever reads the log. So each line is handed over, and one
    thread tells it to the handlers, those of Python's own last resort included. It enters
    none whose pipe or terminal takes nothing now: its lock is needed when Python ends.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._beside: Beside | None = None
        self._loggers = [logging.getLogger(name) for name in ("esair", "asyncio")]

    def start(self) -> None:
        with self._lock:
            self._users += 1
            if self._users == 1:
                self._beside = Beside(self._show)
                for each in self._loggers:
                    each.addFilter(self)

    async def stop(self) -> None:
        """Wait for the lines that wait, a limited time; the last one ends the thread."""
        loop = asyncio.get_running_loop()
        shown, beside = asyncio.Event(), self._beside
        if beside is None:
            return  # this is a fork of the robot

        def tell() -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(shown.set)

        beside.call(tell)
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LAST_MOMENT):
                    await shown.wait()
        finally:
            with self._lock:
                self._users -= 1
                if self._users == 0:
                    self.forget()
                    beside.close(LAST_MOMENT if shown.is_set() else 0.0)

    def forget(self) -> None:
        """Have each line shown at once again, in the thread that writes it."""
        for each in self._loggers:
            each.removeFilter(self)
        self._users, self._beside = 0, None

    def at_exit(self) -> None:
        """Show what waits: Python ends, and a robot was left as it was."""
        beside = self._beside
        self.forget()
        if beside is not None:
            beside.close(LAST_MOMENT)

    def counts(self) -> dict[str, int]:
        beside = self._beside
        return {"dropped": 0 if beside is None else beside.dropped}

    def filter(self, record: logging.LogRecord) -> bool:
        """Take a line from its logger; called in the thread that writes it."""
        beside = self._beside
        if beside is None or self._is_on:
            return True
        record.msg, record.args = text_of(record), None
        for each in logging.getLogger(record.name).handlers:
            if isinstance(each, LogLines) and record.levelno >= each.level:
                each.publish(record)
        beside.hand(record)
        return False

    def _show(self, record: logging.LogRecord) -> None:
        resort = logging.lastResort
        for each in handlers_of(record.name) or ([resort] if resort else []):
            if record.levelno >= each.level and self._is_taken_by(each):
                each.handle(record)

    def _is_taken_by(self, handler: logging.Handler) -> bool:
        """Wait until a handler's pipe or terminal takes something, or all is over."""
        try:
            descriptor = handler.stream.fileno()  # type: ignore[attr-defined]
        except Exception:  # it has none
            return True
        poll = select.poll()
        poll.register(descriptor, select.POLLOUT)
        while not poll.poll(_LOOK if self._is_on else 0):
            if not self._is_on:
                return False
        return True

    @property
    def _is_on(self) -> bool:
        beside = self._beside
        return beside is not None and beside.thread is threading.current_thread()


words = Words()


def _forked() -> None:
    words.forget()  # a fork has no such thread
    words.__init__()  # type: ignore[misc]


os.register_at_fork(after_in_child=_forked)
atexit.register(words.at_exit)


def handlers_of(name: str) -> list[logging.Handler]:
    """Return what handles the lines of a logger, but for the journals."""
    heard: list[logging.Handler] = []
    logger: logging.Logger | None = logging.getLogger(name)
    while logger is not None:
        heard += [each for each in logger.handlers if not isinstance(each, LogLines)]
        logger = logger.parent if logger.propagate else None
    return heard


class LogLines(logging.Handler):
    """Publishes each line of esair's log in the journal of a robot that runs.

    A line that another thread writes is published in the loop, not in that thread.
    Python prints warnings that no handler takes; this one takes them from nobody.
    Where time is virtual, or a run is repeated, no thread is between a line and its
    handlers.
    """

    def __init__(self, journal: Journal) -> None:
        super().__init__(logging.INFO)
        self._journal = journal
        self._loop = asyncio.get_running_loop()
        self._home = threading.get_ident()
        self._inside = False
        turn = turn_of(self._loop)
        self._is_beside = not turn.virtual and turn.player is None

    def start(self) -> None:
        """Begin to hear the log."""
        if self._is_beside:
            words.start()
            self._journal.count("log", lambda: [("log", words.counts())])
        logging.getLogger("esair").addHandler(self)

    def stop(self) -> None:
        """Hear it no more."""
        logging.getLogger("esair").removeHandler(self)

    async def be_shown(self) -> None:
        """Have the last lines shown, as far as somebody reads them."""
        if self._is_beside:
            await words.stop()

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a line that nobody has taken: of a logger below, or in no thread."""
        resort = logging.lastResort
        if resort and record.levelno >= resort.level and not handlers_of(record.name):
            lines = logging.getLogger("esair").handlers
            if next(each for each in lines if isinstance(each, LogLines)) is self:
                resort.handle(record)
        self.publish(record)

    def publish(self, record: logging.LogRecord) -> None:
        """Publish a line; one that the journal or a listener causes is left out."""
        if self._inside or here.is_telling or not self._journal.heard.log:
            return
        if self._loop.is_closed():
            return  # closed under a robot that was not stopped: others go on
        text, level = text_of(record), record.levelname.lower()
        if threading.get_ident() == self._home:
            self._publish(record.name, level, text)
            return
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._publish, record.name, level, text)

    def _publish(self, name: str, level: str, text: str) -> None:
        self._inside = True
        try:
            self._journal.publish(Kind.LOG, name, level, None, text)
        finally:
            self._inside = False
