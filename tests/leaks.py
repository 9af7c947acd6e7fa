"""What esair's own tests in virtual time must not leave behind, beside tasks and threads."""

from __future__ import annotations

import asyncio
import logging

from esair.loop import Deadlines
from esair.testing._leaks import Leaks

SOON = 0.5
"""What is due so soon, in seconds, may come by itself: nobody waits for it any more."""


class OwnLeaks(Leaks):
    """Looks for deadlines and timers of waits that are over, and lost exceptions."""

    def __init__(self) -> None:
        super().__init__()
        self._log = _Log()
        logging.getLogger("asyncio").addHandler(self._log)

    async def check(self, patience: float = 10.0) -> list[str]:
        """Return what is left, after what is ending has ended, on a busy computer too."""
        found = await super().check(patience)
        logging.getLogger("asyncio").removeHandler(self._log)
        loop = asyncio.get_running_loop()
        if not getattr(loop, "virtual", False):
            return found  # what is left there depends on the moment
        late = loop.time() + SOON
        waiting = Deadlines.of(loop).waiting
        found += [f"deadline of {d._function}" for d in waiting if d.when > late]
        for timer in getattr(loop, "_scheduled", ()):
            module = getattr(timer._callback, "__module__", None) or ""
            rings = module == Deadlines.__module__  # for none: it is left alone
            if module.startswith("esair.") and not rings and timer.when() > late:
                found += [] if timer.cancelled() else [f"timer {timer!r}"]
        return found + self._log.told


class _Log(logging.Handler):
    """Keeps what asyncio says of tasks and futures that nobody has looked at."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.told: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if "never retrieved" in message or "was destroyed" in message:
            self.told.append(message)
