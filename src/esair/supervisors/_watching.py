"""The watchdog of a robot: it is started, fed, started anew, and told what may move.

The keeper has one process run as long as the robot does. A watch arms one actuator after
each opening, and says when it moves.
"""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import attrs

from esair.exceptions import ConfigError, describe
from esair.loop import Job, News, Scheduler, outside, spawn, turn_of
from esair.plan import UNWATCHED
from esair.resources import Actuator

if TYPE_CHECKING:
    from esair.supervisors._resource_deployment import ResourceDeployment
    from esair.watchdog import Watchdog

BEATS = 5  # how many beats the watchdog gets in its limit

STARTS = 3
"""How often a watchdog that dies is started anew at once; after that with a pause."""

MAX_PAUSE = 60.0
"""The longest pause before it is started again, in seconds; one that lived for as long
has died for another reason than the one before it."""

_WATCHED, _AS_BEFORE, _UNARMED, _BY_DESIGN = range(4)

_log = logging.getLogger("esair")


@attrs.define
class Armory:
    """What all watches of a robot share.

    Attributes:
        watchdog: What watches.
        cannot_arm: Told the name of an actuator that is open, could be watched and is
            not, and why.
        number: Which process it is: how often one was started.
    """

    watchdog: Watchdog
    cannot_arm: Callable[[str, str], None]
    number: int = 0


class Watch:
    """Arms an actuator after each opening, and says when it moves.

    An actuator by design unwatched, whose driver has no safe frames or whose bus the
    watchdog cannot reach, is said to be so and moves. Any other waits for its watchdog.
    """

    def __init__(self, actuator: Actuator[Any], armory: Armory) -> None:
        self.actuator = actuator
        self._armory = armory
        self._watchdog = armory.watchdog
        self._is_open = False
        self.why: str = "it is not open"  # why it is not watched; empty if it is
        self.unarmed: str = ""
        """Why it is not watched though it is open and could be; empty if it is."""

    async def open(self) -> None:
        """Have it watched, before it is READY; returns when the watchdog has answered.

        However late that is: what cannot be armed is told to the armory.
        """
        self._is_open = True
        await self.arm()

    async def arm(self) -> None:
        """Hand its safe frames to the watchdog; what is watched stays so if that fails."""
        name = self.actuator.name
        while self._is_open:
            number = self._armory.number
            how, why = await outside((name, "arm"), self._arm)
            if number == self._armory.number:
                break  # else another watchdog has come meanwhile
        else:
            return
        if how == _AS_BEFORE:
            _log.warning(
                "%s: its watchdog has its safe frames of before: %s", name, why
            )
            return
        before, self.why = self.why, why
        self.unarmed = why if how == _UNARMED and self._is_open else ""
        if why and why != before:
            _log.warning("%s: %s: %s", name, UNWATCHED, why)
        if self.unarmed:
            self._armory.cannot_arm(name, why)

    async def _arm(self) -> tuple[int, str]:
        """Return how it is watched now, and what was wrong with that."""
        how, why = await self._ask()
        if how != _WATCHED and self._watchdog.watches(self.actuator.name):
            how = _AS_BEFORE  # whatever it was: what may move is not let go for it
        return how, why

    async def _ask(self) -> tuple[int, str]:
        actuator = self.actuator
        try:
            frames, outlet = actuator.safe_frames(), actuator.outlet
        except BaseException as error:  # it is the driver's own code
            return _UNARMED, f"its safe_frames raised {describe(error)}"
        if frames is None:
            return _BY_DESIGN, "its driver cannot say its safe command as bytes"
        if outlet is None:
            return _BY_DESIGN, "the watchdog cannot reach its bus"
        why = await self._watchdog.arm(actuator.name, frames, outlet)
        return (_UNARMED if why else _WATCHED), why

    def lost(self, why: str) -> None:
        """Its watchdog has died."""
        if self._is_open and not self.why:
            self.why = self.unarmed = why

    async def drop(self, within: float | None = None) -> None:
        """Have it watched no more, before its device is closed."""
        self._is_open = False
        self.why, self.unarmed = "it is not open", ""
        name = self.actuator.name
        options = {} if within is None else {"within": within}
        await outside((name, "drop"), lambda: self._watchdog.drop(name, **options))

    def may_move(self) -> bool:
        """Say that it is about to move; tells whether it may.

        It may not once the watchdog has stopped this process and made it safe.
        """
        if self._watchdog.latched:
            return False
        self._watchdog.moving(self.actuator.name, True)
        return True

    def is_safe(self) -> None:
        """Say that it has taken its safe command."""
        self._watchdog.moving(self.actuator.name, False)


class Keeper:
    """Has the watchdog process of one robot run as long as the robot does."""

    def __init__(
        self,
        resources: ResourceDeployment,
        *,
        robot: str,
        limit: float,
        policy: Literal["kill", "freeze"],
        on_death: Literal["stop", "alarm"],
        halt: Callable[[str, str], object],
    ) -> None:
        self._resources = resources
        self._halt = halt
        self._on_death = on_death
        self._limit = limit
        if sys.platform != "linux":
            told = f"expected Linux, not {sys.platform}: leave it out"
            raise ConfigError(f"robot {robot!r}", "watchdog", told)
        from esair.watchdog import Watchdog  # only for the robots that have one

        self.watchdog: Watchdog = Watchdog(
            limit=limit, policy=policy, on_death=lambda: self._deaths_told.tell()
        )
        self._armory = Armory(self.watchdog, self._cannot_arm)
        self._deaths_told: News
        self._deaths = 0
        self._started = 0.0
        self._said = ""
        self._job: Job | None = None
        self._again: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start the watchdog before anything can move.

        Where it cannot be started the robot starts halted, or, with ``"alarm"``,
        unwatched; it is tried again.
        """
        loop = asyncio.get_running_loop()
        if turn_of(loop).virtual:
            _log.info("watchdog: none on a virtual clock")
            return
        self._resources.armory = self._armory
        self._deaths_told = News(loop, ("watchdog", "death"), self._died)
        period = self._limit / BEATS
        self._job = Scheduler.of(loop).every(period, lambda _: self.watchdog.beat())
        await self._try_to_start()

    async def _try_to_start(self) -> None:
        try:
            await outside(("watchdog", "start"), self.watchdog.start)
        except OSError as error:
            why = f"the watchdog cannot be started: {describe(error)}"
            if why != self._said:
                self._missing(why)
            self._said = why
            self._deaths = max(self._deaths, STARTS) + 1
            self._later()
        else:
            self._armory.number += 1
            self._said = ""
            self._started = asyncio.get_running_loop().time()

    # What moves unwatched.

    def keeps_still(self) -> str:
        """Say why the robot must not be resumed yet; empty if it may be."""
        if self._on_death == "stop":
            for watch in self._resources.watches():
                if watch.unarmed:
                    return _not_watched(watch.actuator.name, watch.unarmed)
        return ""

    def _cannot_arm(self, name: str, why: str) -> None:
        """An actuator is open that could be watched, and is not."""
        if self._on_death == "stop":
            self._missing(_not_watched(name, why))

    def _missing(self, why: str) -> None:
        if self._on_death == "stop" or self.watchdog.latched:
            self._halt(why, "the watchdog")
        _log.critical("%s", why)

    def _died(self) -> None:
        lived = asyncio.get_running_loop().time() - self._started
        self._deaths = 1 if lived > MAX_PAUSE else self._deaths + 1
        why = "the watchdog process died"
        for watch in self._resources.watches():
            watch.lost(why)
        self._missing(why)
        self._later()

    def _later(self) -> None:
        loop = asyncio.get_running_loop()
        self._again = spawn(loop, self._start_again(), name="watchdog start")

    async def _start_again(self) -> None:
        if self._deaths > STARTS:
            pause = min(2 ** (self._deaths - STARTS - 1), MAX_PAUSE)
            _log.warning("watchdog: it is started again in %g s", pause)
            await asyncio.sleep(pause)
        number = self._armory.number
        await self._try_to_start()
        if self._armory.number != number:
            await self._resources.rearm()

    async def close(self) -> None:
        """Let it go: every actuator is safe, and closed."""
        if self._again is not None:
            self._again.cancel()
        if self._job is not None:
            self._job.stop()
        await outside(("watchdog", "close"), self.watchdog.close)


def _not_watched(name: str, why: str) -> str:
    told = 'mend it, or drive unwatched with watchdog_death="alarm"'
    return f"{name} is not watched: {why}; {told}"
