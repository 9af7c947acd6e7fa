"""The event loop of a child: it has no clock of its own, and takes turns with the robot.

It works until nothing in it is ready and no thread of it computes. Then it says what it
has done and when it wants to go on, and waits for a message, which brings the time.
"""

from __future__ import annotations

import math
import select
from typing import TYPE_CHECKING, Any

from esair.loop import SECOND, TurnLoop

if TYPE_CHECKING:
    from esair.placement._child import Child


class ChildLoop(TurnLoop):
    """The event loop of a child.

    Args:
        robot: The file on which the robot is heard; `home` hears it.
    """

    virtual = True

    home: Child

    def __init__(self, robot: int) -> None:
        self._now = 0.0
        self.passes = 0
        """How often it has gone on to what is ready."""
        super().__init__()
        self._robot = robot
        self._files: Any = self._selector._fd_to_key  # type: ignore[attr-defined]  # hot
        self._waits = select.poll()
        for each in (robot, self._selector.fileno()):  # type: ignore[attr-defined]
            self._waits.register(each, select.POLLIN)

    def clock(self) -> float:
        return self._now

    def slept(self) -> float:
        return 0.0

    def _pass(self, timeout: float | None = None) -> Any:
        events = self._work_off()
        self._turn.number += 1
        self.passes += 1
        self._turn.border(self._now)
        return events

    def _work_off(self) -> Any:
        """Let go on what is ready, else threads, else what is due, else the robot."""
        ready, door = self._ready, self._turn.door  # type: ignore[attr-defined]
        while not (ready or self._stopping or door.entries):  # type: ignore[attr-defined]
            door.let_go()
            is_quiet = door.at_work == 0  # once: a thread may end at any moment
            if door.ripen(works=is_quiet):
                break
            if not is_quiet:
                if events := self._others(self._select(None)):
                    return events
            elif (
                self._turn.is_due(self._now)
                or (first := self.first_timer()) <= self._now
            ):
                break
            else:
                return self._rest(max(min(first, self._turn.due / SECOND), self._now))
        # What threads have called for is ready without the bell, its one file.
        return self._others(self._select(0.0)) if len(self._files) > 1 else ()

    def _rest(self, wake: float) -> Any:
        """Be idle until the robot says something; it also says what time it is."""
        self.home.idle(wake)
        events: Any = ()
        while self._robot not in dict(self._waits.poll()):
            events = self._others(self._select(0.0))
            # A thread that has ended its work may ring late.
            if events or self._ready or self._turn.door.ripen(works=True):  # type: ignore[attr-defined]
                self.home.tick()  # something of its own: it has to know when that is
                break
        self._now = max(self._now, self.home.hear())
        self._clock_resolution = max(1e-9, 2 * math.ulp(self._now))
        return events
