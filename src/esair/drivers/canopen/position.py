"""A drive of CiA 402 that goes to positions (profile position mode); see `drive`."""

from __future__ import annotations

import asyncio
from typing import Final, Unpack

import attrs

from esair.drivers._on_bus import applied, in_units
from esair.drivers.canopen import drive as profile
from esair.drivers.canopen.drive import DriveActuator, DriveActuatorSettings
from esair.exceptions import DeviceFaultError
from esair.resources import Actuator

__all__ = ["Move", "PositionDrive"]

ACKNOWLEDGES_WITHIN: Final = 0.25
"""How long a drive may take to see that bit 4 rises, or falls, in seconds."""


@attrs.frozen
class Move:
    """What a drive is told.

    Attributes:
        position: Where to go, in rad; without meaning if it stops, but within the limits.
        stop: Whether it stops where it is.
    """

    position: float = 0.0
    stop: bool = False


class PositionDrive(DriveActuator, Actuator[Move]):
    """A drive that goes to a position by its own ramps, and stops if that is safe.

    A newer position takes the place of one on the way to which it is. A write is over when
    the drive has acknowledged the position (bit 12 of its statusword); one that does not is
    at fault. Otherwise it is as `esair.drivers.canopen.drive.Drive`.

    Args:
        factor: The unit of its target position, in rad.
        limits: The least and the greatest position, in rad.
        **settings: ``node``, ``eds``, ``stop`` and more, as there.
    """

    mode = profile.PROFILE_POSITION
    target = profile.TARGET_POSITION

    def __init__(self, **settings: Unpack[DriveActuatorSettings]) -> None:
        super().__init__(**settings)
        self.limits: dict[str, tuple[float, float]] = {"position": self._allowed}
        self._is_offered = False
        """Whether a position was told, and nobody knows whether the drive has seen it."""
        low, high = self._allowed
        self.safe: Move = Move(min(max(low, 0.0), high), stop=True)

    async def write(self, command: Move) -> Move | None:
        """Tell the drive where to go, and enable it; or stop it.

        Returns the position in its units, if that is another one.
        """
        if command.stop:
            await self._stop()
            return None
        value = in_units(command.position, self.factor, self._allowed)
        # Bit 4 must rise for each position: first without it, then with it. One that is
        # halted stays so until then, or it would go on to the position before.
        at_once = profile.ENABLE | profile.AT_ONCE
        first = at_once | self._word & profile.HALT
        await self._go(first, at_once | profile.NEW_SET_POINT, value=value)
        sent = applied(command.position, value * self.factor)
        return None if sent is None else Move(sent)

    async def _heed_of(self, mine: int, word: int) -> None:
        loop, wanted = asyncio.get_running_loop(), bool(word & profile.NEW_SET_POINT)
        if self._is_offered and not wanted:  # what it has told may be from before
            self._hear(await self._call(self._ask))
        self._is_offered = wanted

        def is_over() -> bool:
            seen = bool(self._status & profile.ACKNOWLEDGED)
            return seen is wanted or mine != self._newest

        end = loop.time() + ACKNOWLEDGES_WITHIN
        while not is_over():
            if loop.time() >= end:
                text = f"bit 12 of its statusword is not {wanted:d} in"
                raise DeviceFaultError(self.name, f"{text} {ACKNOWLEDGES_WITHIN:g} s")
            await self._until(is_over)
        self._check_newest(mine)
        self._is_offered = False
