"""The keeper of a robot's watchdog: it starts it, feeds it, and starts it anew."""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from esair.exceptions import ConfigError, describe
from esair.loop import Job, News, Scheduler, outside, spawn, turn_of
from esair.supervisors._resource_deployment import ResourceDeployment
from esair.supervisors._watch import Armory
from esair.values import check_choice, check_seconds

if TYPE_CHECKING:
    from esair.watchdog import Watchdog

BEATS = 5  # how many beats the watchdog gets in its limit

STARTS = 3
"""How often a watchdog that dies is started anew at once; after that with a pause."""

MAX_PAUSE = 60.0
"""The longest pause before it is started again, in seconds; one that lived for as long
has died for another reason than the one before it."""

_log = logging.getLogger("esair")


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
        owner = f"robot {robot!r}"
        choices = "stop", "alarm"
        self._on_death = check_choice(owner, "watchdog_death", on_death, choices)
        self._limit = limit = check_seconds(owner, "watchdog_limit", limit)
        check_choice(owner, "watchdog_policy", policy, ("kill", "freeze"))
        if sys.platform != "linux":
            told = f"expected Linux, not {sys.platform}: leave it out"
            raise ConfigError(owner, "watchdog", told)
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
        self._job = Scheduler.of(loop).every(self._limit / BEATS, self._beat)
        await self._try_to_start()

    def _beat(self, _now: float) -> None:
        self.watchdog.beat()

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
        _log.critical("%s", why)
        if self._on_death == "stop" or self.watchdog.latched:
            self._halt(why, "the watchdog")

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
            pause = min(2.0 ** min(self._deaths - STARTS - 1, 9), MAX_PAUSE)
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
