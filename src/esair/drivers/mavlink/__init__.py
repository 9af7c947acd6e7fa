"""A vehicle that speaks MAVLink: ArduPilot, PX4, and what else does.

Over a serial line, or TCP as simulated vehicles do::

    [bus.vehicle]
    type = "serial"
    port = "socket://127.0.0.1:5760"        # or /dev/ttyACM0
    framing = "mavlink"

    [sensor.place]
    driver = "mavlink"
    bus = "vehicle"
    message = "GLOBAL_POSITION_INT"
    period = 0.1

    [actuator.sticks]
    driver = "mavlink"
    bus = "vehicle"
    channels = { steering = 1, throttle = 3 }
    safe = { steering = 0.0, throttle = 0.0 }
    own_timeout = 1.0                       # RC_OVERRIDE_TIME of ArduPilot

The vehicle is told once a second that its ground station is there, while one of its
actuators is open; its own failsafe (``FS_GCS_ENABLE``) acts when that ends.

Source: MAVLink 2, common message set (mavlink.io); messages are those of pymavlink.
"""

from __future__ import annotations

import asyncio
import functools
import math
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, Final, Unpack
from xml.etree import ElementTree

import attrs

from esair.buses import Inbox, SerialBus
from esair.drivers._on_bus import (
    SharedTask,
    check_bus,
    ended,
    heard,
    room_comes,
    shared,
    watching,
)
from esair.exceptions import ConfigError, DeviceFaultError
from esair.framing import Mavlink
from esair.loading import of_extra
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)
from esair.values import check_seconds, check_whole
from esair.watchdog import SafeFrames

with of_extra("mavlink"):
    import pymavlink as pymavlink  # its dialect is loaded by the framing

__all__ = ["READS", "Attitude", "Heartbeat", "MavlinkSensor", "Position", "RcOverride"]

STATION: Final = 255, 190
"""The system and the component that a ground station is."""

ARMED: Final = 128
"""The bit of a base mode that says that the motors have power."""

NO_AUTOPILOT: Final = 8
"""What a heartbeat tells that is not of the vehicle itself."""

SIGNED: Final = 1
"""The flag of a packet that has a signature behind its checksum."""

BEAT: Final = 1.0
"""Between two heartbeats, in seconds."""

PATIENCE: Final = 3.5
"""After how many seconds without a heartbeat a vehicle is lost."""

ASK_AGAIN: Final = 5.0
"""After how many seconds a vehicle is told again how often a message shall come."""

MIDDLE, HALF, IGNORED = 1500, 500, 65535
"""A channel in microseconds: its middle, from there to its end, and one that stays as it is."""


@attrs.frozen
class Heartbeat:
    """How a vehicle is.

    Attributes:
        armed: Whether its motors have power.
        mode: Its mode, by its firmware's own number.
        status: ``MAV_STATE``: 3 standby, 4 active, 5 critical, 6 emergency.
        kind: ``MAV_TYPE``: 2 quadrotor, 10 rover, 12 submarine.
    """

    armed: bool
    mode: int
    status: int
    kind: int


@attrs.frozen
class Attitude:
    """How a vehicle is turned: radians, and rad/s; forward, right, down."""

    roll: float
    pitch: float
    yaw: float
    roll_rate: float
    pitch_rate: float
    yaw_rate: float


@attrs.frozen
class Position:
    """Where a vehicle is, and how it moves.

    Attributes:
        latitude_deg: North positive, WGS 84.
        longitude_deg: East positive, WGS 84.
        altitude: Above mean sea level, in m.
        height: Above home, in m.
        north: Speed to the north, in m/s; ``east`` and ``down`` likewise.
        heading: Of its nose, clockwise from north, in rad; None if it does not know.
    """

    latitude_deg: float
    longitude_deg: float
    altitude: float
    height: float
    north: float
    east: float
    down: float
    heading: float | None


def _position(told: Any) -> Position | None:
    if not (told.lat or told.lon):  # ArduPilot says so as long as it knows no place
        return None
    return Position(
        told.lat * 1e-7,
        told.lon * 1e-7,
        told.alt / 1000,
        told.relative_alt / 1000,
        told.vx / 100,
        told.vy / 100,
        told.vz / 100,
        None if told.hdg == IGNORED else math.radians(told.hdg / 100),
    )


_turned = attrgetter("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")

READS: Final[Mapping[str, tuple[type, Callable[[Any], Any]]]] = {
    "HEARTBEAT": (
        Heartbeat,
        lambda told: Heartbeat(
            bool(told.base_mode & ARMED),
            told.custom_mode,
            told.system_status,
            told.type,
        ),
    ),
    "ATTITUDE": (Attitude, lambda told: Attitude(*_turned(told))),
    "GLOBAL_POSITION_INT": (Position, _position),
}
"""What a reading of a message is; that of each other one is a dictionary."""

_MOST: Final = re.compile(r"(U?)INT(8|16|32|64)_MAX")


@functools.cache
def unknowns(dialect: Any) -> Mapping[tuple[str, str], float]:
    """Return the numbers that say "not known", by message and field.

    They are in the descriptions from which the package has made its dialect.
    """
    found = {}
    for message in _described(Path(dialect.__file__).with_suffix(".xml"), set()):
        for field in message.iter("field"):
            told = field.get("invalid", "")
            if most := _MOST.fullmatch(told):
                told = str((1 << int(most[2]) - (not most[1])) - 1)
            if re.fullmatch(r"-?\d+(\.\d+)?", told):
                found[message.get("name", ""), field.get("name", "")] = float(told)
    return found


def _described(path: Path, seen: set[Path]) -> Iterator[ElementTree.Element]:
    """Yield the messages of a dialect, and of those that it includes."""
    if path in seen or not path.is_file():
        return
    seen.add(path)
    root = ElementTree.parse(path).getroot()
    for other in root.iter("include"):
        yield from _described(path.with_name(other.text or ""), seen)
    yield from root.iter("message")


class _Talk:
    """What all on one line share: the messages, and the number of the next."""

    def __init__(self, framing: Mavlink) -> None:
        self._framing = framing
        self._mav = framing.dialect.MAVLink(None, *STATION)
        self._is_old = framing.version == 1
        self.sensors: set[MavlinkSensor] = set()
        """Those that are open, and read its messages."""

    def number(self, message: str) -> int | None:
        """Return the number of a message."""
        return getattr(self._framing.dialect, f"MAVLINK_MSG_ID_{message}", None)

    def payload(self, message: str, **fields: Any) -> bytes:
        """Return a message as the framing takes it."""
        kind = getattr(self._framing.dialect, f"MAVLink_{message.lower()}_message")
        packet: bytes = kind(**fields).pack(self._mav, force_mavlink1=self._is_old)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet[2:-2]

    def decoded(self, payload: bytes, system: int, number: int | None) -> Any:
        """Return the message of a system with a number; None if it is another."""
        at = 1 if self._is_old else 3
        told = int.from_bytes(
            payload[at + 2 : at + (3 if self._is_old else 5)], "little"
        )
        if told != number or payload[at] != system:
            return None
        if not self._is_old:
            if payload[0] & ~SIGNED:
                return None  # the standard: what is not known is not to be read
            payload = b"\0" + payload[1:]  # its signature was left out
        return self._mav.decode(bytearray(self._framing.encode(payload)))


class _Beats(SharedTask):
    """Tells the vehicle that its ground station is there."""

    async def run(self, bus: SerialBus, talk: _Talk) -> None:
        while True:
            beat = talk.payload(
                "HEARTBEAT",
                type=6,
                autopilot=NO_AUTOPILOT,
                base_mode=0,
                custom_mode=0,
                system_status=4,
                mavlink_version=3,
            )
            with room_comes():
                await bus.send(beat)
            await asyncio.sleep(BEAT)


class _OnVehicle(Resource):
    """What sensors and actuators have in common: a vehicle on a line."""

    bus: SerialBus
    deadline: float = 5.0
    instance: int | str | None = None

    def __init__(self, *, system: int = 1, **settings: Any) -> None:
        super().__init__(**settings)
        check_bus(self, SerialBus, Mavlink)
        self.system: int = check_whole(self.name, "system", system, 1, 255)
        framing = self.bus.framing
        assert isinstance(framing, Mavlink)
        self._dialect = framing.dialect
        self._talk = shared(self.bus, _Talk).setdefault("talk", _Talk(framing))

    def _told(
        self, message: str, inbox: Inbox[bytes], seconds: float = PATIENCE
    ) -> AsyncIterator[Any]:
        """Yield each of the vehicle's messages of one kind; lost if none comes."""
        number, wanted = self._talk.number(message), self.instance

        def decoded(payload: bytes) -> Any:
            told = self._talk.decoded(payload, self.system, number)
            # A gimbal or a camera of the vehicle has a heartbeat, too, and its number.
            if told is None or getattr(told, "autopilot", None) == NO_AUTOPILOT:
                return None
            is_it = wanted is None or getattr(told, told.instance_field) == wanted
            return told if is_it else None

        what = f"no {message} of system {self.system}"
        what += "" if wanted is None else f" with instance {wanted!r}"
        return heard(self, inbox, seconds, decoded, what)

    async def _first(self, message: str, seconds: float = PATIENCE) -> None:
        with self.bus.frames() as inbox:
            await anext(self._told(message, inbox, seconds))


class _SensorSettings(SensorSettings, total=False):
    system: int


class _ActuatorSettings(ActuatorSettings, total=False):
    system: int


class MavlinkSensor(_OnVehicle, Sensor[Any]):
    """One kind of message of a vehicle.

    What the vehicle says that it does not know is no reading: a place of 0°, 0°, or a
    ``value`` of which the standard says so, such as 65535 for ``"voltage_battery"``.

    Args:
        message: Its name. A ``HEARTBEAT`` is read as a `Heartbeat`, ``ATTITUDE`` as an
            `Attitude`, ``GLOBAL_POSITION_INT`` as a `Position`; another one as the
            dictionary of its fields, or one of them.
        value: The field that is read of another message, such as ``"voltage_battery"``.
        scale: What that is multiplied with: 0.001 for mV.
        period: From one to the next, in seconds: the vehicle is told so at each opening,
            and every 5 s; the least of those who read the message. As it likes if
            None. A reading is current for three of them, or for ``silent_after``.
        silent_after: After how many seconds without one the vehicle is lost.
        instance: Of which of several it is told: the ``id`` of a battery, a distance
            sensor or the like, the ``name`` of a ``NAMED_VALUE_FLOAT``. Of all if None.
        system: The number of the vehicle.

    Attributes:
        every: How often it needs the message, in seconds; as it comes if None.
        unknown: How many messages said that the vehicle does not know.
    """

    counted: ClassVar[tuple[str, ...]] = ("unknown",)

    def __init__(
        self,
        *,
        message: str = "HEARTBEAT",
        value: str | None = None,
        scale: float = 1.0,
        period: float | None = None,
        silent_after: float = PATIENCE,
        instance: int | str | None = None,
        **settings: Unpack[_SensorSettings],
    ) -> None:
        super().__init__(**settings)
        self.message = message
        kind = getattr(self._dialect, f"MAVLink_{message.lower()}_message", None)
        if kind is None:
            raise ConfigError(
                self.name, "message", f"the dialect has no {message!r:.40}"
            )
        if value is not None and value not in kind.fieldnames:
            told = f"expected one of {', '.join(kind.fieldnames)}, not {value!r:.40}"
            raise ConfigError(self.name, "value", told)
        if instance is not None and kind.instance_field is None:
            told = f"expected none: each vehicle has but one {message}"
            raise ConfigError(self.name, "instance", told)
        self.instance = instance
        self._value = value
        self._none = math.nan
        if value is not None:
            self._none = unknowns(self._dialect).get((message, value), math.nan)
        self._scale = scale
        self.unknown: int = 0
        self.silent_after: float = check_seconds(
            self.name, "silent_after", silent_after
        )
        self.every = period
        self.period = self.silent_after
        if period is not None:  # one that comes late is no silence
            self.period = 3 * check_seconds(self.name, "period", period)

    @property
    def value_type(self) -> Any:
        """The type of its readings."""
        if self._value is not None:
            return float
        return READS[self.message][0] if self.message in READS else dict

    async def open(self) -> None:
        """Ask for the message, and wait for the first one."""
        self._talk.sensors.add(self)
        await self._ask_for_it()
        await self._first(self.message, self.silent_after)

    async def close(self) -> None:
        """Need the message no more."""
        self._talk.sensors.discard(self)

    async def _ask_for_it(self) -> None:
        """Tell the vehicle how often all who read the message need it."""
        kind = self.system, self.message
        alike = [s for s in self._talk.sensors if (s.system, s.message) == kind]
        if self.every is not None:
            await self.bus.send(
                self._talk.payload(
                    "COMMAND_LONG",
                    target_system=self.system,
                    target_component=0,
                    command=511,  # MAV_CMD_SET_MESSAGE_INTERVAL
                    confirmation=0,
                    param1=self._talk.number(self.message),
                    param2=min(s.every for s in alike if s.every) * 1e6,
                    **{f"param{n}": 0.0 for n in range(3, 8)},
                )
            )

    async def stream(self) -> AsyncIterator[Any]:
        """Yield each that comes.

        Raises:
            DeviceLostError: None came for too long.
        """
        loop = asyncio.get_running_loop()
        again = loop.time() + ASK_AGAIN
        with self.bus.frames() as inbox:
            async for told in self._told(self.message, inbox, self.silent_after):
                if loop.time() >= again:  # it may have restarted, or not heard it
                    again = loop.time() + ASK_AGAIN
                    with room_comes():
                        await self._ask_for_it()
                if (value := self._read(told)) is None:
                    self.unknown += 1
                else:
                    yield value

    def _read(self, told: Any) -> Any:
        if self._value is not None:
            try:
                number = float(getattr(told, self._value))
            except (TypeError, ValueError) as error:
                raise DeviceFaultError(
                    self.name, f"{self._value} is no number"
                ) from error
            is_known = number != self._none and not math.isnan(number)
            return number * self._scale if is_known else None
        if self.message in READS:
            return READS[self.message][1](told)
        return {name: getattr(told, name) for name in told.get_fieldnames()}


class RcOverride(_OnVehicle, Actuator[dict[str, float]]):
    """The sticks of a vehicle's radio, moved by the robot: -1 to 1, with names.

    The vehicle forgets them after ``own_timeout``, and obeys its radio again.

    Args:
        channels: The number of the channel of each stick, by its name.
        safe: Where each stick is when it is safe.
        own_timeout: After how many seconds without a command the vehicle itself goes
            back to its radio: ``RC_OVERRIDE_TIME`` of ArduPilot.
        system: The number of the vehicle.
    """

    def __init__(
        self,
        *,
        channels: Mapping[str, int],
        safe: Mapping[str, float],
        own_timeout: float | None = 3.0,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        if not channels or set(channels) != set(safe):
            told = f"expected a channel for each of {', '.join(safe)}, and for no more"
            raise ConfigError(self.name, "channels", told)
        for name, number in channels.items():
            check_whole(self.name, f"channels.{name}", number, 1, 8)
        if len({*channels.values()}) < len(channels):
            told = f"expected another channel for each stick, not {dict(channels)}"
            raise ConfigError(self.name, "channels", told)
        self.channels: dict[str, int] = dict(channels)
        self.safe: dict[str, float] = dict(safe)
        self.limits: Mapping[str, tuple[float, float]] = dict.fromkeys(
            channels, (-1.0, 1.0)
        )
        self.own_timeout = own_timeout
        self.claim: str = f"the sticks of system {self.system}"
        self._watching: asyncio.Task[None] | None = None
        self._beats = shared(self.bus, _Beats).setdefault("beats", _Beats(self.bus))

    def safe_frames(self) -> SafeFrames:
        """The safe sticks."""
        frame = self.bus.framing.encode(self._override(self.safe))
        return SafeFrames([frame], repeat=3)  # one may end what was cut in half

    async def open(self) -> None:
        """Wait for the vehicle's heartbeat, and watch out for it from then on."""
        await self._first("HEARTBEAT")
        self._beats.begin(self, lambda: self._beats.run(self.bus, self._talk))
        inbox = self.bus.frames()
        self._watching = watching(self, inbox, self._watch)

    async def _watch(self, inbox: Inbox[bytes]) -> None:
        async for _ in self._told("HEARTBEAT", inbox):
            pass

    async def close(self) -> None:
        """Watch out no more."""
        await ended(self._watching)
        await self._beats.leave(self)

    async def write(self, command: dict[str, float]) -> None:
        """Move the sticks; those without a name stay with the radio."""
        await self.bus.send(self._override(command))

    def _override(self, command: Mapping[str, float]) -> bytes:
        sticks = {f"chan{n}_raw": IGNORED for n in range(1, 9)}
        for name, where in {**self.safe, **command}.items():
            sticks[f"chan{self.channels[name]}_raw"] = round(MIDDLE + HALF * where)
        return self._talk.payload(
            "RC_CHANNELS_OVERRIDE",
            target_system=self.system,
            target_component=0,
            **sticks,
        )
