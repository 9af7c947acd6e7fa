"""Says who holds the event loop, while it is held."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import selectors
import sys
import threading
import traceback
from types import FrameType

from esair.abc import Component
from esair.loop._of_loop import OfLoop
from esair.loop._overseer import overseer

_log = logging.getLogger("esair")


class StallWatch(OfLoop):
    """Asks a loop again and again, from a thread, whether it still turns.

    Code that holds it longer than allowed is named in the log with its stack, while
    it still holds it. One for each loop; the strictest of its robots counts.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._thread = threading.get_ident()
        self._limits: list[float] = []
        self._asked: float | None = None
        self._said = False
        self.stalls = 0  # how often the loop was held too long

    def start(self, limit: float) -> None:
        """Watch for turns that take longer than a limit, in seconds."""
        self._thread = threading.get_ident()
        self._limits.append(limit)
        if len(self._limits) == 1:
            overseer.join(self)

    def stop(self, limit: float) -> None:
        self._limits.remove(limit)
        if not self._limits:
            overseer.leave(self)
            self._asked = None

    def look(self, now: float) -> float:
        """Ask the loop, or say that it does not answer; called by the overseer."""
        limit = min(self._limits, default=math.inf)
        if self._asked is None:
            self._asked = now
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._answer)
        elif not self._said and now - self._asked >= limit:
            self._said = True
            self.stalls += 1
            frame = sys._current_frames().get(self._thread)  # noqa: SLF001 - the only way to see it
            if frame is not None:
                # In a thread of its own: the loop may be stuck in the log.
                threading.Thread(
                    target=_log.log,
                    args=(*describe_holder(frame), limit),
                    daemon=True,
                    name="esair-stall",
                ).start()
        return now + limit / 2

    def _answer(self) -> None:
        self._asked = None
        self._said = False


def describe_holder(frame: FrameType) -> tuple[int, str]:
    """Name the component whose code a thread executes, the line, and its stack."""
    if frame.f_code.co_filename == selectors.__file__:
        return logging.INFO, "the computer is busy: no turn for more than %g s"
    name, where = "the program", ""
    each: FrameType | None = frame
    while each is not None:
        owner = each.f_locals.get("self")
        if isinstance(owner, Component):
            with contextlib.suppress(Exception):  # a user's name may be anything
                name = str(owner.name)
                where = f" ({each.f_code.co_filename}:{each.f_lineno})"
            break
        each = each.f_back
    stack = "".join(traceback.format_stack(frame))
    text = f"{name}{where}:\n{stack}".replace("%", "%%")
    return logging.WARNING, f"the event loop is held for more than %g s by {text}"
