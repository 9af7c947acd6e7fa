"""What a robot needs of its event loop and its process while it runs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping

from esair.exceptions import ConfigError
from esair.loop import (
    GLANCE,
    Gaps,
    Job,
    OwnedTasks,
    Scheduler,
    StallWatch,
    collector,
    turn_of,
)

STALL_WARNING = 0.1
"""How long code may hold the event loop before it is named, in seconds."""


class LoopCare:
    """Owns tasks, looks for stalls and sleep, and collects garbage in gaps."""

    def __init__(
        self, stall_warning: float | None, resumed: Callable[[float], None]
    ) -> None:
        self.stall_warning = stall_warning
        self._resumed = resumed
        self._undo: list[Callable[[], None]] = []
        self._gaps: Gaps | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    def start(self, loop: asyncio.AbstractEventLoop, *crowds: int) -> None:
        """Begin, for so many components of each kind; nothing is deployed yet."""
        self._loop = loop
        owned = OwnedTasks.of(loop)
        owned.install()
        self._undo.append(owned.uninstall)
        scheduler = Scheduler.of(loop)
        suspends = turn_of(loop).suspends
        suspends.listen(self._resumed)
        self._undo.append(lambda: suspends.forget(self._resumed))
        for components in crowds:
            scheduler.expect(components)
        if turn_of(loop).virtual:  # there it would hide a deadlock
            return
        seconds = self.stall_warning
        if seconds is not None:
            stalls = StallWatch.of(loop)
            stalls.start(seconds)
            self._undo.append(lambda: stalls.stop(seconds))
        glances: Job = scheduler.every(GLANCE, lambda _now: None)
        self._undo.append(glances.stop)

    def refuse_elsewhere(self, title: str, verb: str) -> None:
        """Refuse what is asked in another event loop while the robot has its own."""
        if self._loop not in {None, asyncio.get_running_loop()}:
            told = "it runs in another event loop: what is for threads is halt"
            raise ConfigError(title, verb, told)

    def is_up(self, loop: asyncio.AbstractEventLoop) -> None:
        """Everything runs: garbage is collected in the gaps from now on."""
        self._gaps = Gaps.of(loop)
        self._gaps.start()

    def counts(self) -> Iterator[tuple[str, Mapping[str, int]]]:
        """Return what the collector counts; on a virtual clock it has no gaps."""
        if (
            self._gaps is not None
            and self._loop is not None
            and not turn_of(self._loop).virtual
        ):
            yield "collector", collector.counts()

    def is_down(self) -> None:
        """The stop has begun: it is no time for garbage."""
        if self._gaps is not None:
            self._gaps.stop()
            self._gaps = None

    def stop(self) -> None:
        """Leave everything as it was found."""
        self._loop = None
        while self._undo:
            self._undo.pop()()
