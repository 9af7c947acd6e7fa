"""One actuator and the watchdog process: watched while its device is open."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import attrs

from esair.exceptions import describe
from esair.loop import outside
from esair.plan import UNWATCHED
from esair.resources import Actuator

if TYPE_CHECKING:
    from esair.watchdog import Watchdog

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
        self.why = "it is not open"  # why it is not watched; empty if it is
        self.unarmed = ""
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
            if how != _UNARMED or number == self._armory.number:
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
