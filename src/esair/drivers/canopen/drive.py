"""Motor drives of CiA 402: enabled, told a velocity or a position, stopped.

::

    [actuator.wheel]
    driver = "cia402"
    bus = "drive"
    node = 5
    factor = 0.00157        # rad/s for one unit of its target velocity
    sync = 0.02             # optional: a SYNC every 20 ms, for all on the bus

    [sensor.wheel_state]
    driver = "cia402"
    bus = "drive"
    node = 5

A drive of which nothing special is known needs no EDS file: its objects are those of the
standard. At each opening its PDOs are set up, which are the first of commands and the
first two of what it tells.

Source: CiA 402-2 (states, controlword, statusword) and 402-3 (modes); CiA 301 (PDO, SYNC,
EMCY).
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import ClassVar, Unpack

import attrs

from esair.drivers.canopen import _profile as profile
from esair.drivers.canopen._on_drive import (
    DriveActuator,
    DriveActuatorSettings,
    DriveSettings,
    OnDrive,
)
from esair.drivers.canopen._profile import State, state_of
from esair.resources import Actuator, Sensor, SensorSettings

__all__ = ["Drive", "DriveReading", "DriveState", "State"]


@attrs.frozen
class DriveReading:
    """What a drive measures, and how it is.

    Attributes:
        position: In rad, or the unit that its factor gives.
        velocity: In rad/s, or the unit that its factor gives.
        state: Its state.
    """

    position: float
    velocity: float
    state: State


class _StateSettings(DriveSettings, SensorSettings): ...


class DriveState(OnDrive, Sensor[DriveReading]):
    """What a drive measures, each time that it tells.

    Args:
        node: The id of the node, 1 to 127.
        eds: Its EDS or DCF file; the objects of the standard if None.
        position_factor: The unit of its position, in rad.
        velocity_factor: The unit of its velocity, in rad/s.
        tell_every: How often it tells, in seconds; without a SYNC.
        sync: The period of the SYNC with which it tells, in seconds; the same for all
            devices on a bus.
        heartbeat: The heartbeat period that it is told, in seconds.
        sdo_timeout: How long it may take to answer, in seconds.

    Attributes:
        bad_frames: How many PDOs were too short.
    """

    counted: ClassVar[tuple[str, ...]] = ("bad_frames",)

    def __init__(
        self,
        *,
        position_factor: float = 1.0,
        velocity_factor: float = 1.0,
        sync: float | None = None,
        **settings: Unpack[_StateSettings],
    ) -> None:
        super().__init__(**settings)
        self.sync: float | None = self._check_sync(sync)
        self.position_factor = position_factor
        self.velocity_factor = velocity_factor
        self.bad_frames: int = 0

    async def stream(self) -> AsyncIterator[DriveReading]:
        """Yield what it tells; its second PDO completes a reading."""
        first, second = 0x180 + self.node, 0x280 + self.node
        told: bytes | None = None
        inbox = self.bus.frames(first, second, limit=64)
        with inbox:
            async for frame in inbox:
                if len(frame.data) < (6 if frame.id == first else 4):
                    self.bad_frames += 1
                elif frame.id == first:
                    told = frame.data
                elif told is not None:
                    yield DriveReading(
                        _signed(told[2:6]) * self.position_factor,
                        _signed(frame.data[:4]) * self.velocity_factor,
                        state_of(int.from_bytes(told[:2], "little")),
                    )


class Drive(DriveActuator, Actuator[float]):
    """A drive that is told a velocity in rad/s (profile velocity mode).

    It is enabled, which is to say it gets power, only by a command that is not the safe
    one; the safe command stops it. At each opening a fault is cleared once, and one that
    remains is a fault of the device. While it is open a fault, with what the drive has
    said in emergency messages, or that it is disabled by somebody else is a fault at
    once; it is opened again and not enabled until a fresh command.

    Args:
        factor: The unit of its target velocity, in rad/s.
        limits: The least and the greatest velocity, in rad/s.
        stop: How the safe command stops it: ``"quick_stop"``, by the ramp for that, and
            mostly without torque then; or ``"halt"``, which holds it enabled.
        sync: The period of the SYNC with which it takes its target, in seconds. It is
            sent by the event loop, so it ends when that hangs.
        **settings: ``node``, ``eds`` and more, as of a `DriveState`.
    """

    safe: float = 0.0
    mode = profile.PROFILE_VELOCITY
    target = profile.TARGET_VELOCITY

    def __init__(
        self, *, sync: float | None = None, **settings: Unpack[DriveActuatorSettings]
    ) -> None:
        super().__init__(**settings)
        self.sync: float | None = self._check_sync(sync)
        self.limits: tuple[float, float] = self._allowed

    async def write(self, command: float) -> None:
        """Tell the drive its velocity, and enable it if that is not 0; or stop it."""
        if command == self.safe:
            await self._stop()
        else:
            await self._go(profile.ENABLE, value=round(command / self.factor))


def _signed(data: bytes) -> int:
    return int.from_bytes(data, "little", signed=True)
