"""One actuator and the watchdog process: watched while its device is open."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from esair.exceptions import describe
from esair.loop import outside
from esair.plan import UNWATCHED
from esair.resources import Actuator

if TYPE_CHECKING:
    from esair.watchdog import Watchdog

_log = logging.getLogger("esair")


class Watch:
    """Arms an actuator after each opening, and says when it moves."""

    def __init__(self, actuator: Actuator[Any], watchdog: Watchdog) -> None:
        self.actuator = actuator
        self._watchdog = watchdog
        self.why = "it is not open"  # why it is not watched; empty if it is

    async def arm(self) -> None:
        """Hand its safe frames to the watchdog; returns when it has answered."""
        name = self.actuator.name
        before, self.why = self.why, await outside((name, "arm"), self._arm)
        if self.why and self.why != before:
            _log.warning("%s: %s: %s", self.actuator.name, UNWATCHED, self.why)

    async def _arm(self) -> str:
        actuator = self.actuator
        try:
            frames, outlet = actuator.safe_frames(), actuator.outlet
        except BaseException as error:  # it is the driver's own code
            return f"its safe_frames raised {describe(error)}"
        if frames is None:
            return "its driver cannot say its safe command as bytes"
        if outlet is None:
            return "the watchdog cannot reach its bus"
        return await self._watchdog.arm(actuator.name, frames, outlet)

    async def drop(self) -> None:
        """Have it watched no more, before its device is closed."""
        self.why = "it is not open"
        name = self.actuator.name
        await outside((name, "drop"), lambda: self._watchdog.drop(name))

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
