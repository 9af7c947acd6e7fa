"""Dynamixel servos of the X series, on their own half-duplex serial line.

Source: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, and the control table of the
XL430-W250 (the same for all of the X series as far as it is used here, but that XL330 and
XC330 have their indirect data elsewhere); checksums and what a servo complains of are those
of the maker's ``dynamixel-sdk``.

The bus is one of its own kind, because master and servos take turns on one wire::

    [bus.arm]
    type = "esair.drivers.servo:ServoBus"
    port = "usb:0403:6014"
    baudrate = 57600

    [actuator.elbow]
    driver = "servo"
    bus = "arm"
    id = 3
    safe = { mode = "release" }

A servo goes on to the goal that it has when this computer dies, and holds it.
"""

from __future__ import annotations

import enum
import math
from typing import Any, Final, TypeVar, Unpack

import attrs

from esair.drivers._files import narrowed
from esair.drivers._on_bus import check_bus
from esair.drivers.servo._bus import (
    HARDWARE_ERROR,
    Entry,
    ServoBus,
    Snapshot,
    hardware_errors,
)
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
    setting,
)
from esair.values import check_whole
from esair.watchdog import SafeFrames

__all__ = [
    "CENTER",
    "GOAL_CURRENT",
    "GOAL_POSITION",
    "GOAL_VELOCITY",
    "HARDWARE_ERROR",
    "OPERATING_MODE",
    "PRESENT_POSITION",
    "PROFILE_VELOCITY",
    "TORQUE_ENABLE",
    "Goal",
    "Mode",
    "Servo",
    "ServoBus",
    "ServoPosition",
    "hardware_errors",
    "to_angle",
    "to_steps",
]

OPERATING_MODE = 11
TORQUE_ENABLE = 64

GOAL_CURRENT = 102
GOAL_VELOCITY = 104
PROFILE_VELOCITY = 112
GOAL_POSITION = 116
PRESENT_POSITION = 132

T = TypeVar("T")

LOOKED: Final = 0.02
"""An answer of that age is as good as a new one to see a restart, in seconds.

A servo takes longer to start. So what is read 50 times a second need not be asked again
before it is told something: with the 16 ms of an adapter that would halve the rate.
"""

STEPS: Final = 4096
"""How many steps a turn has."""

CENTER: Final = 2048
"""The step in the middle, which is angle 0."""

CURRENT, VELOCITY, POSITION = range(3)
"""Places in the ``modes`` of a control table."""


def to_steps(angle: float) -> int:
    """Return an angle in rad, counter-clockwise from the middle, in steps."""
    return round(angle * STEPS / math.tau) + CENTER


def to_angle(steps: int) -> float:
    """Return a position in steps, as 32 bits of a control table, as angle in rad."""
    signed = steps - (1 << 32) if steps & 0x8000_0000 else steps
    return (signed - CENTER) * math.tau / STEPS


class Mode(enum.Enum):
    """What a servo shall do."""

    MOVE = "move"
    HOLD = "hold"
    RELEASE = "release"


@attrs.frozen
class Goal:
    """What a servo is told.

    Attributes:
        angle: Where to go in rad, counter-clockwise from the middle; without meaning
            unless it moves.
        mode: Move there and hold it; hold where it is; or release, with no torque.
    """

    angle: float = 0.0
    mode: Mode = Mode.MOVE


class _OnServo(Resource):
    """What all that is on a servo has in common."""

    bus: ServoBus
    traffic: int = 24  # its place in a request for all, and its answer

    def __init__(
        self,
        *,
        id: int = 1,  # noqa: A002 - the maker's word
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        check_bus(self, ServoBus)
        self.id: int = check_whole(self.name, "id", id, 0, 252)


class ServoPosition(_OnServo, Sensor[float]):
    """Where a servo is, in rad, counter-clockwise from its middle.

    Args:
        id: The servo's id, 0 to 252; they come with 1.
    """

    rate: float = setting(
        50.0, unit="Hz", min=0.1, max=500.0, doc="how often it is asked"
    )

    async def open(self) -> None:
        """Make sure that the servo answers, and can be asked in one turn of the wire."""
        await self.bus.ping(self.id)
        await self.bus.set_up(self.id)

    async def read(self) -> float:
        """Ask where it is.

        Raises:
            DeviceFaultError: It does not answer, or has shut down.
            DeviceLostError: It has restarted.
        """
        seen = await self.bus.snapshot(self.id)
        if not seen.is_lit:
            raise DeviceLostError(self.name, "it has restarted")
        return (seen.position - CENTER) * math.tau / STEPS


class TorquedSettings(ActuatorSettings, total=False):
    id: int


class Torqued(_OnServo, Actuator[T]):
    """What servos have in common in each mode: a torque, and a light that is lit."""

    mode: int

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.claim: str = f"servo {self.id}"
        self._torque = False
        self._takes = -math.inf, math.inf
        """The least and the greatest number that the servo takes."""
        self._model = 0

    async def open(self) -> None:
        """Make sure that the servo answers, and is in its mode; nothing moves by that."""
        self._torque = False
        self._model = await self.bus.ping(self.id)
        table = self.bus.table
        mode = table.modes[self.mode]
        assert mode is not None  # its class has refused a bus without it
        if await self.bus.read(self.id, table.mode, 1) != mode:
            await self.bus.write(self.id, table.torque, 1, 0)  # else it is refused
            if table.lock is not None:
                await self.bus.write(self.id, table.lock, 1, 0)
            await self.bus.write(self.id, table.mode, 1, mode)
            if table.lock is not None:
                await self.bus.write(self.id, table.lock, 1, 1)
        await self.bus.set_up(self.id)

    async def is_set_up(self) -> bool:
        """Tell whether it has not restarted: its torque, light or speed would be gone."""
        return self._is_as_told(await self.bus.snapshot(self.id, max_age=LOOKED))

    def _is_as_told(self, seen: Snapshot) -> bool:
        return seen.is_lit and (seen.has_torque or not self._torque)

    async def _tell(
        self, entry: Entry, number: int, *, is_safe: bool, needs_torque: bool
    ) -> None:
        """Tell the servo a number, and have it hold that; waits for what is safe."""
        told = self.id, entry.address, entry.size, entry.pack(number)
        if self._torque and not is_safe:
            await self.bus.tell(*told)
            return
        await self.bus.write(*told)
        if needs_torque and not self._torque:
            # The number went first, so that it does not jump to an old one; and once
            # more, because some firmware forgets it when the torque comes.
            await self.bus.write(self.id, self.bus.table.torque, 1, 1)
            await self.bus.write(*told)
            self._torque = True

    async def _check_set_up(self) -> None:
        if not self._is_as_told(await self.bus.snapshot(self.id, max_age=LOOKED)):
            self._torque = False
            raise DeviceLostError(self.name, "it has restarted: its torque is off")


class _ServoSettings(TorquedSettings, total=False):
    speed: float


class Servo(Torqued[Goal]):
    """A servo that goes to an angle and holds it.

    Args:
        id: The servo's id, 0 to 252; they come with 1.
        safe: What makes it safe: ``Goal(mode=Mode.RELEASE)`` takes the torque away (an
            arm sinks), ``Goal(mode=Mode.HOLD)`` holds it where it is (a hand stays
            squeezed). That is a question of the robot, so there is no default.
        limits: Least and greatest angle, in rad; the whole turn, which ends one step
            before π, unless given.
    """

    mode = POSITION
    speed: float = setting(
        0.0, unit="rad/s", min=0.0, max=30.0, doc="how fast it moves; 0 for no limit"
    )

    def __init__(
        self,
        *,
        safe: Goal,
        limits: tuple[float, float] = (to_angle(0), to_angle(STEPS - 1)),
        **settings: Unpack[_ServoSettings],
    ) -> None:
        super().__init__(**settings)
        self.safe = safe
        self._told_speed: int | None = None
        turns = self.bus.table.goal.has_sign_bit  # it may go on for some of them
        most = to_angle(0x7FFF) if turns else math.pi
        low, high = narrowed(self.name, "limits", limits, (-most, most), by="a servo")
        high = min(high, most if turns else to_angle(STEPS - 1))
        self.limits = {"angle": (low, high)}

    def safe_frames(self) -> SafeFrames | None:
        """No torque; None if it has to hold, for which its place must be asked first."""
        if self.safe.mode is not Mode.RELEASE:
            return None
        packet = self.bus.packet(self.id, self.bus.table.torque, 0)
        return SafeFrames([packet], repeat=3)  # one may end what was cut in half

    async def open(self) -> None:
        """Make sure that the servo answers, and is in its mode; nothing moves by that."""
        self._told_speed = None
        await super().open()
        entry = self.bus.table.limits
        both = await self.bus.read(self.id, entry.address, entry.size)
        half = 4 * entry.size
        least, most = sorted((both >> half, both & (1 << half) - 1))
        self._takes = (least, most) if both else (-math.inf, math.inf)

    def _is_as_told(self, seen: Snapshot) -> bool:
        return super()._is_as_told(seen) and self._told_speed in {None, seen.speed}

    async def apply(self, *, speed: float | None = None, **_: object) -> None:
        """Set how fast it moves."""
        value = self.speed if speed is None else speed
        table = self.bus.table
        units = table.no_limit
        if value:
            if table.drive and await self.bus.read(self.id, table.drive, 1) & 4:
                told = "its drive mode takes a speed for a time: clear bit 2 of it"
                raise DeviceFaultError(self.name, told)
            units = max(1, round(value / table.velocity_unit))
        self._told_speed = None
        await self.bus.write(self.id, table.speed.address, table.speed.size, units)
        self._told_speed = units

    async def write(self, command: Goal) -> Goal | None:
        """Send the goal; the servo rounds it to a step, which is 0.0015 rad.

        One beyond the limits that it has itself, which it would not obey, is cut off
        there, and returned so.

        Raises:
            DeviceFaultError: It does not answer, or has shut down.
            DeviceLostError: It has restarted, its torque is off: the goal was not sent.
        """
        table = self.bus.table
        if command.mode is Mode.RELEASE:
            self._torque = False
            await self.bus.write(self.id, table.torque, 1, 0)
            if (await self.bus.snapshot(self.id)).has_torque:  # of several none answers
                raise DeviceFaultError(self.name, "it does not release")
            return None
        await self._check_set_up()
        holds = command.mode is Mode.HOLD
        wanted = to_steps(command.angle)
        if holds:
            wanted = (await self.bus.snapshot(self.id)).position
        least, most = self._takes
        steps = int(min(max(least, wanted), most))
        if holds and not table.goal.has_sign_bit and not self._torque:
            # Turned by hand it counts on, until the torque comes.
            steps = wanted % STEPS
        await self._tell(
            table.goal, steps, is_safe=command == self.safe, needs_torque=True
        )
        return None if holds or steps == wanted else Goal(to_angle(steps))
