"""Dynamixel servos that turn without an end, or push: velocity and current mode.

::

    [actuator.wheel]
    driver = "esair.drivers.servo.turning:ServoVelocity"
    bus = "arm"
    id = 4

The mode is in the servo's memory: it is changed at the opening if it is another, without
torque. Source: see `esair.drivers.servo`.
"""

from __future__ import annotations

from typing import Unpack

from esair.drivers._files import narrowed
from esair.drivers._on_bus import applied, in_units
from esair.drivers.servo import CURRENT, VELOCITY, Torqued, TorquedSettings
from esair.drivers.servo._bus import Entry
from esair.exceptions import ConfigError
from esair.watchdog import SafeFrames

__all__ = ["ServoCurrent", "ServoVelocity"]


class _Turned(Torqued[float]):
    """A servo that is told a number; 0 is at rest, and needs no torque to begin with."""

    safe: float = 0.0

    _entry: Entry
    _greatest: Entry | None

    def _turns(self, entry: Entry, unit: float, limits: tuple[float, float]) -> None:
        """Have the number in an entry of the table, in units of that."""
        self._entry, self._unit = entry, unit
        most = ((1 << 8 * entry.size - 1) - 1) * unit
        within = narrowed(self.name, "limits", limits, (-most, most), by="a servo")
        self.limits: tuple[float, float] = within

    def safe_frames(self) -> SafeFrames:
        """The number that is safe."""
        entry = self._entry
        packet = self.bus.packet(self.id, entry.address, 0, entry.size)
        return SafeFrames([packet], repeat=3)  # one may end what was cut in half

    async def open(self) -> None:
        """Make sure that the servo answers, and is in its mode; nothing moves by that."""
        await super().open()
        if (entry := self._greatest) is not None:
            most = await self.bus.read(self.id, entry.address, entry.size)
            self._takes = -most, most

    async def write(self, command: float) -> float | None:
        """Tell the servo, with torque from the first command that is not safe.

        Returns the command in the units of its table, and within the limit that it has
        itself, if that is another one.
        """
        is_safe = command == self.safe
        if not is_safe:
            await self._check_set_up()
        least, most = self._takes
        wanted = in_units(command, self._unit, self.limits)
        units = int(min(max(least, wanted), most))
        await self._tell(self._entry, units, is_safe=is_safe, needs_torque=not is_safe)
        if is_safe:  # it went first; whether it is there is asked then
            await self._check_set_up()
        return applied(command, units * self._unit)


class ServoVelocity(_Turned):
    """A servo that turns at a velocity in rad/s, without an end; 0 holds it.

    Args:
        id: The servo's id, 0 to 252; they come with 1.
        limits: Least and greatest velocity, in rad/s.
    """

    mode = VELOCITY

    def __init__(
        self,
        *,
        limits: tuple[float, float] = (-6.0, 6.0),
        **settings: Unpack[TorquedSettings],
    ) -> None:
        super().__init__(**settings)
        table = self.bus.table
        self._greatest = table.fastest
        self._turns(table.velocity, table.velocity_unit, limits)


class ServoCurrent(_Turned):
    """A servo that pushes with a current in A, which is a torque; 0 lets it go.

    The XL430 and Feetech's STS have no such mode; the XL330, XM and XH have, and HLS.

    Args:
        id: The servo's id, 0 to 252; they come with 1.
        unit: The current of one unit of its table, in A; that of its model unless given,
            such as 0.001 of XL330 and XC330, 0.00269 of XM and XH, or 0.0065 of HLS.
        limits: Least and greatest current, in A.
    """

    mode = CURRENT

    def __init__(
        self,
        *,
        unit: float | None = None,
        limits: tuple[float, float] = (-0.5, 0.5),
        **settings: Unpack[TorquedSettings],
    ) -> None:
        super().__init__(**settings)
        table = self.bus.table
        if table.current is None:
            raise ConfigError(self.name, "bus", "its servos have no current mode")
        self._greatest = table.strongest
        self._is_by_model = unit is None
        self.unit: float = table.current_unit if unit is None else unit
        if not 0 < self.unit < 1:
            raise ConfigError(self.name, "unit", f"expected A, above 0, not {unit!r}")
        self._turns(table.current, self.unit, limits)

    async def open(self) -> None:
        """Make sure that the servo answers, and is in its mode; nothing moves by that."""
        await super().open()
        if self._is_by_model:
            units = self.bus.table.current_units
            self.unit = self._unit = units.get(self._model, self.unit)
