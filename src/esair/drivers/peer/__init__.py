"""Sensors and actuators of another robot, and how that robot is.

They are used like local ones, by their local names::

    [network]
    connect = ["tls/192.168.1.5:7447"]

    [remote.base.sensor.sonar]

    [remote.base.actuator.wheels]
    type = "rover:Twist"

The other robot has to share them: ``[share.sonar]``, ``[share.wheels]``.
"""

from __future__ import annotations

import asyncio
import inspect
import math
from collections.abc import AsyncIterator
from typing import Any, Final, Unpack

import attrs

from esair.abc import Component
from esair.buses import Inbox
from esair.buses.peer import Head, PeerBus, packed
from esair.codec import CodecError
from esair.drivers.object import imported
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
)
from esair.flaws import unsound
from esair.loop import clock_of
from esair.messages import Refused, Restart
from esair.resources import HOLD, Actuator, ActuatorSettings, Sensor, SensorSettings
from esair.values import fits, is_positive

__all__ = ["Peer", "PeerActuator", "PeerSensor", "PeerStatus"]

_FIRST: Final = 0.6
"""How long an opening waits for what the peer says of a sensor, in seconds."""

_AGAIN: Final = Restart(max=1, retry=2.0)
"""What is wrong there may be right again at any time, and nobody replugs a peer."""

_BUILT_IN: Final = {
    each.__name__: each for each in (bool, int, float, str, dict, tuple)
}


@attrs.frozen
class PeerStatus:
    """How another robot is heard.

    Attributes:
        round_trip: How long a beat and its echo have taken last, in seconds.
        received: Messages that came from it.
        refused: Those among them that came with too old a beat.
        bad: Those that were damaged, or not as expected.
        lost: How often it was lost.
    """

    round_trip: float
    received: int
    refused: int
    bad: int
    lost: int


class Peer(Sensor[PeerStatus]):
    """How another robot is heard; LOST while it is not."""

    bus: PeerBus
    period: float | None = 1.0

    def __init__(self, **settings: Unpack[SensorSettings]) -> None:
        super().__init__(**settings)

    async def stream(self) -> AsyncIterator[PeerStatus]:
        """Yield what the bus has counted, twice a second."""
        bus = self.bus
        while True:
            told, trip = bus.stats, min(bus.round_trip, 1e6)
            counts = told.received, told.refused, told.bad_frames, told.lost
            yield PeerStatus(trip, *counts)
            await asyncio.sleep(0.5)


def _type_of(owner: Sensor[Any] | Actuator[Any], kind: Any) -> Any:
    """Return the type that a file, or a script, names."""
    if isinstance(kind, str):
        if kind in _BUILT_IN:
            kind = _BUILT_IN[kind]
        else:
            hint, named = "put it beside the robot.toml, or install it", kind
            kind = imported(owner, named, hint=hint, field="type")
            is_part = isinstance(kind, type) and issubclass(kind, Component)
            if is_part or inspect.isroutine(kind):
                told = f"expected the class of a value, not {named!r:.80}"
                raise ConfigError(owner.name, "type", told)
    elif isinstance(kind, bytes | int | float | list | tuple | dict):
        told = f"expected a type such as float, or 'module:Class', not {kind!r:.80}"
        raise ConfigError(owner.name, "type", told)
    if owner.bus is not None and kind is not Any:
        owner.bus.declare(kind)
    return kind


class PeerSensor(Sensor[Any]):
    """A sensor of another robot, under a local name.

    A reading is never called younger than it is: its age counts from the beat of this
    robot that its owner had heard before it was sent.

    Args:
        type: The type of its readings, also as ``"module:Class"``; plain data unless given.
        remote: Its name there; the local one unless given.
        link_rate: How often a reading is sent at most, in Hz.
    """

    bus: PeerBus
    restart: Restart = _AGAIN

    def __init__(
        self,
        *,
        type: Any = Any,  # noqa: A002 - as in esair.reads
        remote: str | None = None,
        link_rate: float = 20.0,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        self._type = _type_of(self, type)
        self.remote: str = remote or self.name
        if not is_positive(link_rate) or link_rate > 1000.0:
            told = f"expected more than 0 and at most 1000 Hz, not {link_rate!r:.80}"
            raise ConfigError(self.name, "link_rate", told)
        self.link_rate = float(link_rate)
        self._inbox: Inbox[Any] | None = None
        self._first: Any = None

    @property
    def value_type(self) -> Any:
        """The type of its readings."""
        return self._type

    async def open(self) -> None:
        """Ask its owner for the readings, and wait for what that says of it.

        Raises:
            DeviceLostError: It is lost there, not shared, or its owner does not answer.
        """
        self._inbox = self.bus.follow(self.remote, self.link_rate)
        try:
            self._first = await self._inbox.take(timeout=_FIRST)
        except TimeoutError:
            told = f"{self.bus.name!r} says nothing of {self.remote!r}"
            raise DeviceLostError(self.name, told) from None
        if isinstance(self._first, DeviceLostError):
            raise DeviceLostError(self.name, self._first.detail)

    async def close(self) -> None:
        """Ask for no more."""
        if self._inbox is not None:
            self._inbox.close()

    async def stream(self) -> AsyncIterator[Any]:
        """Yield each reading.

        Raises:
            DeviceLostError: It is lost there.
        """
        assert self._inbox is not None
        first, self._first = self._first, None
        if first is not None:
            yield first
        async for said in self._inbox:
            if isinstance(said, DeviceLostError):
                raise DeviceLostError(self.name, said.detail)
            if said is not None:
                yield said


class PeerActuator(Actuator[Any]):
    """An actuator of another robot, under a local name.

    There this robot is one of its writers, with the priority and the rights of the share.
    What makes it safe here lets it go there: then its owner decides, and makes it safe
    when nobody else moves it. Its owner tells what it is then told: guards here let less
    pass than was asked for, and a slew begins there. It has one name here: two would not
    know of each other's holds.

    Args:
        type: The type of its commands, also as ``"module:Class"``; plain data unless given.
        remote: Its name there; the local one unless given.
    """

    bus: PeerBus
    restart: Restart = _AGAIN
    safe: Any = HOLD
    own_timeout: float | None = 0.2
    deadline: float = 0.5
    lets_go: Final = True
    """What it answers to `esair.HOLD` is the safe command of the device."""

    def __init__(
        self,
        *,
        type: Any = Any,  # noqa: A002 - as in esair.reads
        remote: str | None = None,
        **settings: Unpack[ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        self._type = _type_of(self, type)
        self.remote: str = remote or self.name
        self.claim: str = f"the actuator {self.remote!r} there"

    @property
    def value_type(self) -> Any:
        """The type of its commands."""
        return self._type

    async def open(self) -> None:
        """Begin anew: whether it is shared says the answer to the first release."""
        self._is_known = False
        self.refused: Refused | None = None
        """What its owner has answered last, if that was a refusal."""
        self.bus.when_gone[self._hear_gone] = None

    async def close(self) -> None:
        """Hear no more of it."""
        self.bus.when_gone.pop(self._hear_gone, None)

    def check(self, command: Any) -> None:
        """Refuse what cannot be sent: no plain data, or too much.

        Raises:
            BadValueError: It names what, and why.
        """
        try:
            packed(Head(0, 0, 0, 0, 0.0), (0, self.remote, command), self.bus.kinds)
        except CodecError as error:
            raise BadValueError(self.name, "command", str(error)) from None

    def _hear_gone(self, name: str, why: str) -> None:
        if name == self.remote and why:
            told = f"{self.bus.name!r} says: {why}"
            self.report_lost(DeviceLostError(self.name, told))

    async def write(self, command: Any) -> Any:
        """Send a command with the newest beat heard, and wait for what its owner says.

        Returns:
            What was applied there, or is safe there; or a refusal with the holder there.
            A refusal of the peer where nothing was heard for longer than the command
            time-out, or where the command is beyond what its owner lets pass.

        Raises:
            DeviceLostError: The peer is lost, or does not share it.
            DeviceFaultError: Its owner could not apply it.
        """
        answer = await self._ask(command)
        self.refused = answer if isinstance(answer, Refused) else None
        return answer

    async def _ask(self, command: Any) -> Any:
        bus = self.bus
        what = ("release",) if command is HOLD else ("write", command)
        how, value = await bus.request(
            what[0], self.remote, *what[1:], patience=self.command_timeout
        )
        now = clock_of(asyncio.get_running_loop())()
        match how, value:
            case "silent", _ if not self._is_known:
                told = f"{bus.name!r} says nothing of {self.remote!r}"
                raise DeviceLostError(self.name, told)
            case "silent", float(seconds):
                told = f"no answer for {seconds:.2g} s: what came of it is unknown"
                return Refused(bus.name, 0, told, now - seconds, None)
            case "written", _ if command is HOLD:
                self._is_known = True
                return value if fits(value, self._type) and not unsound(value) else None
            case "written", _ if value is None or fits(value, self._type):
                return value
            case "refused", (
                str(holder),
                int(priority),
                str(rule),
                float(age),
                (None | float()) as left,
            ) if math.isfinite(age) and math.isfinite(left or 0.0):
                until = None if left is None else now + left
                return Refused(f"{bus.name}:{holder}", priority, rule, now - age, until)
            case "lost", str(told):
                raise DeviceLostError(self.name, f"{bus.name!r} says: {told}")
        raise DeviceFaultError(self.name, f"{bus.name!r} says: {value!r:.200}")
