"""The keeper of a robot's watchdog: it starts it, feeds it, and starts it anew."""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from esair.exceptions import ConfigError, describe
from esair.loop import Job, News, Scheduler, outside, spawn
from esair.supervisors._resource_deployment import ResourceDeployment
from esair.values import check_choice, check_seconds

if TYPE_CHECKING:
    from esair.watchdog import Watchdog

BEATS = 5  # how many beats the watchdog gets in its limit
STARTS = 3  # how often a watchdog that dies is started anew in the life of a robot

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

        self._watchdog: Watchdog = Watchdog(
            limit=limit, policy=policy, on_death=lambda: self._deaths_told.tell()
        )
        self._deaths_told: News
        self._deaths = 0
        self._job: Job | None = None
        self._again: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start the watchdog before anything can move.

        Where it cannot be started the robot starts halted, or, with ``"alarm"``,
        unwatched.
        """
        loop = asyncio.get_running_loop()
        if getattr(loop, "virtual", False):
            _log.info("watchdog: none on a virtual clock")
            return
        self._resources.watchdog = self._watchdog
        self._deaths_told = News(loop, ("watchdog", "death"), self._died)
        self._job = Scheduler.of(loop).every(self._limit / BEATS, self._beat)
        await self._try_to_start()

    def _beat(self, _now: float) -> None:
        self._watchdog.beat()

    async def _try_to_start(self) -> None:
        try:
            await outside(("watchdog", "start"), self._watchdog.start)
        except OSError as error:
            self._missing(f"the watchdog cannot be started: {describe(error)}")

    def _missing(self, why: str) -> None:
        _log.critical("%s", why)
        if self._on_death == "stop" or self._watchdog.latched:
            self._halt(why, "the watchdog")

    def _died(self) -> None:
        self._deaths += 1
        self._missing("the watchdog process died")
        if self._deaths <= STARTS:
            loop = asyncio.get_running_loop()
            self._again = spawn(loop, self._start_again(), name="watchdog start")
        else:
            _log.critical("watchdog: it died %d times; nothing is watched", STARTS + 1)

    async def _start_again(self) -> None:
        await self._try_to_start()
        await self._resources.rearm()

    async def close(self) -> None:
        """Let it go: every actuator is safe, and closed."""
        if self._again is not None:
            self._again.cancel()
        if self._job is not None:
            self._job.stop()
        await outside(("watchdog", "close"), self._watchdog.close)
