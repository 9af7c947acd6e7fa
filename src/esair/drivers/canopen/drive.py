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

import asyncio
import enum
import functools
import struct
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, Unpack

import attrs
from canopen.objectdictionary import (
    INTEGER8,
    INTEGER32,
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)
from canopen.profiles.p402 import State402
from canopen.sdo.exceptions import SdoAbortedError

from esair.buses import CanBus, Frame, Inbox
from esair.drivers._files import narrowed
from esair.drivers._on_bus import (
    SharedTask,
    applied,
    ended,
    heard,
    in_units,
    room_comes,
    shared,
    watching,
)
from esair.drivers.canopen import read_eds
from esair.drivers.canopen._node import Emergency, NodeSettings, OnNode, sdo_frames
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
)
from esair.resources import Actuator, ActuatorSettings, Resource, Sensor, SensorSettings
from esair.values import check_choice, check_seconds
from esair.watchdog import SafeFrames, can_frame

__all__ = ["Drive", "DriveReading", "DriveState", "State"]

CONTROLWORD, STATUSWORD, ERROR_CODE = 0x6040, 0x6041, 0x603F
MODE, POSITION, VELOCITY = 0x6060, 0x6064, 0x606C
TARGET_POSITION, TARGET_VELOCITY = 0x607A, 0x60FF

PROFILE_POSITION, PROFILE_VELOCITY = 1, 3
"""The modes of operation that are used here."""

DISABLE, QUICK_STOP, SHUT_DOWN, SWITCH_ON, ENABLE = 0x00, 0x02, 0x06, 0x07, 0x0F
NEW_SET_POINT, AT_ONCE, RESET, HALT = 0x10, 0x20, 0x80, 0x100
"""Bits of the controlword that are no state."""

ACKNOWLEDGED = 0x1000
"""The bit of the statusword that says, of a position, that bit 4 was seen."""


class State(enum.Enum):
    """The states of a drive, by the bits 0 to 3, 5 and 6 of its statusword."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"


STATUS: Final = {
    State(name.lower()): mask_and_value
    for name, mask_and_value in State402.SW_MASK.items()
}
"""Which bits of the statusword count, and what they are."""

WAY: Final = {
    State.DISABLED: SHUT_DOWN,
    State.READY: SWITCH_ON,
    State.SWITCHED_ON: ENABLE,
    State.QUICK_STOP: ENABLE,
}
"""The controlword that leads on to "operation enabled"; in the others one waits."""


def state_of(status: int) -> State:
    """Return the state that a statusword tells."""
    for state, (mask, value) in STATUS.items():
        if status & mask == value:
            return state
    return State.NOT_READY


@functools.cache
def standard(node: int) -> ObjectDictionary:
    """Return the objects that a drive has by CiA 301 and CiA 402, as far as used here."""
    known = ObjectDictionary()  # type: ignore[no-untyped-call]
    known.node_id = node
    for index, name, kind, default, access in _OBJECTS:
        known.add_object(_variable(name, index, 0, kind, default, access))
    for number in range(4):
        base = 0x100 * number + node
        _add_pdo(known, 0x1400 + number, 0x1600 + number, 0x200 + base)
        _add_pdo(known, 0x1800 + number, 0x1A00 + number, 0x180 + base)
    return known


def _add_pdo(known: ObjectDictionary, set_up: int, mapping: int, cob_id: int) -> None:
    record = ODRecord(f"PDO communication {set_up:#x}", set_up)
    for sub, name, kind, default in (
        (0, "Highest subindex", UNSIGNED8, 5),
        (1, "COB-ID", UNSIGNED32, 0x80000000 | cob_id),
        (2, "Transmission type", UNSIGNED8, 255),
        (3, "Inhibit time", UNSIGNED16, 0),
        (5, "Event timer", UNSIGNED16, 0),
    ):
        record.add_member(_variable(name, set_up, sub, kind, default))
    known.add_object(record)
    record = ODRecord(f"PDO mapping {mapping:#x}", mapping)
    for sub in range(9):
        kind = UNSIGNED32 if sub else UNSIGNED8
        record.add_member(_variable(f"Entry {sub}", mapping, sub, kind, 0))
    known.add_object(record)


def _variable(
    name: str, index: int, sub: int, kind: int, default: int, access: str = "rw"
) -> ODVariable:
    made = ODVariable(name, index, sub)
    made.data_type, made.default, made.access_type = kind, default, access
    return made


_OBJECTS: Final = (
    (0x1000, "Device type", UNSIGNED32, 0x00020192, "ro"),
    (0x1001, "Error register", UNSIGNED8, 0, "ro"),
    (0x1017, "Producer heartbeat time", UNSIGNED16, 0, "rw"),
    (ERROR_CODE, "Error code", UNSIGNED16, 0, "ro"),
    (CONTROLWORD, "Controlword", UNSIGNED16, 0, "rw"),
    (STATUSWORD, "Statusword", UNSIGNED16, 0x40, "ro"),
    (0x605A, "Quick stop option code", UNSIGNED16, 2, "rw"),
    (MODE, "Modes of operation", INTEGER8, 0, "rw"),
    (0x6061, "Modes of operation display", INTEGER8, 0, "ro"),
    (POSITION, "Position actual value", INTEGER32, 0, "ro"),
    (VELOCITY, "Velocity actual value", INTEGER32, 0, "ro"),
    (TARGET_POSITION, "Target position", INTEGER32, 0, "rw"),
    (0x6081, "Profile velocity", UNSIGNED32, 1000, "rw"),
    (0x6083, "Profile acceleration", UNSIGNED32, 10_000, "rw"),
    (0x6084, "Profile deceleration", UNSIGNED32, 10_000, "rw"),
    (0x6085, "Quick stop deceleration", UNSIGNED32, 50_000, "rw"),
    (TARGET_VELOCITY, "Target velocity", INTEGER32, 0, "rw"),
)


SYNC = 0x80


class Sync(SharedTask):
    """The producer of SYNC on a bus, while at least one device wants it."""

    def __init__(self, bus: CanBus, period: float) -> None:
        super().__init__(bus)
        self.period = period

    def join(self, device: Resource) -> None:
        """Produce for a device, too."""
        self.begin(device, self._send)

    async def leave(self, device: Resource) -> None:
        """Produce for a device no more; after the last one any period will do."""
        if self._users.keys() <= {device}:
            shared(self._bus, Sync).pop(SYNC, None)
        await super().leave(device)

    async def _send(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            try:
                with room_comes():
                    await self._bus.send(SYNC, b"", replaces=True, timeout=self.period)
            except DeviceLostError:
                return
            due = max(due + self.period, loop.time())
            await asyncio.sleep(due - loop.time())


def sync_of(device: Resource, bus: CanBus, period: float) -> Sync:
    """Return the producer of a bus; a `ConfigError` if it has another period."""
    found = shared(bus, Sync).setdefault(SYNC, Sync(bus, period))
    if found.period != period:
        raise ConfigError(
            device.name, "sync", f"the bus has a SYNC every {found.period:g} s already"
        )
    return found


ENABLE_TIMEOUT: Final = 1.0
"""How long a drive may take to be enabled, or to forget a fault, in seconds."""

ASK_PERIOD: Final = 0.05
"""After which silence a drive is asked for its statusword, in seconds."""

SILENCE: Final = 0.25
"""How long a drive may tell nothing that tells periodically, in seconds."""

STOPS_WITHIN: Final = 0.25
"""How long a drive may tell that it is enabled after it was told to stop, in seconds."""

LONGEST_SYNC: Final = 0.1
"""The longest period of the SYNC: a stop may wait for it, in seconds."""

TOLD: Final = (STATUSWORD, POSITION), (VELOCITY,)
"""What is in the PDOs of a drive."""


class DriveSettings(NodeSettings, total=False):
    eds: Path | str | None
    tell_every: float


class OnDrive(OnNode):
    """What the sensor and the actuators of a drive have in common."""

    sync: float | None = None

    def __init__(
        self,
        *,
        eds: Path | str | None = None,
        tell_every: float = 0.02,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        node = self.node
        self.dictionary: Any = (
            standard(node) if eds is None else read_eds(self.name, eds, node)
        )
        self.tell_every: float = check_seconds(self.name, "tell_every", tell_every)
        self._is_prepared = False
        self._silence: float | None = None
        """After which silence it is lost; None if it may tell changes alone."""
        self._sync: Sync | None = None

    def _check_sync(self, sync: float | None) -> float | None:
        if sync is not None and check_seconds(self.name, "sync", sync) > LONGEST_SYNC:
            raise ConfigError(
                self.name, "sync", f"expected {LONGEST_SYNC:g} s at most, not {sync!r}"
            )
        return sync

    def make_ready(self, remote: Any) -> None:
        """Set its PDOs up before it is started, in the thread."""
        self._prepare(remote)

    def _prepare(self, remote: Any) -> None:
        users = tuple(self._connected().users)
        on = [each for each in users if isinstance(each, OnDrive)]
        # The quickest is what all have; a SYNC would end with the one that needs it.
        every = min(each.tell_every for each in on)
        by_sync = all(each.sync is not None for each in on)
        self._silence = max(SILENCE, 10 * max(self.tell_every, self.sync or 0.0))
        for number, mapped in enumerate(TOLD, 1):
            pdo = remote.tpdo[number]
            pdo.rtr_allowed = False
            pdo.event_timer = 0 if by_sync else round(every * 1000)
            if 5 not in pdo.com_record.od:
                pdo.event_timer = None
                self._silence = self._silence if by_sync else None
            self._map(pdo, mapped, by_sync=by_sync)
        self._is_prepared = self._connected().is_mapped = True

    def _map(self, pdo: Any, mapped: tuple[int, ...], *, by_sync: bool) -> None:
        pdo.clear()
        for index in mapped:
            if pdo.add_variable(index) is None:
                raise DeviceFaultError(self.name, f"the file has no object {index:#x}")
        pdo.cob_id = pdo.predefined_cob_id
        pdo.trans_type = 1 if by_sync else 255
        pdo.enabled = True
        pdo.save()

    async def open(self) -> None:
        """Find the node and have it tell."""
        self._is_prepared = False
        await super().open()
        if not self._is_prepared:  # the node runs for another device already
            link = self._connected()
            for user in () if link.is_mapped else tuple(link.users):
                user.heed_mapping()
            await self._call(self._prepare, self._remote)
        if self.sync is not None:
            self._sync = sync_of(self, self.bus, self.sync)
            self._sync.join(self)

    async def close(self) -> None:
        """Leave the node."""
        sync, self._sync = self._sync, None
        if sync is not None:
            await sync.leave(self)
        await super().close()


class DriveActuatorSettings(DriveSettings, ActuatorSettings, total=False):
    factor: float
    limits: tuple[float, float] | None
    stop: Literal["quick_stop", "halt"]


class DriveActuator(OnDrive):
    """What moves a drive: enabled by a command that moves, watched from then on."""

    mode: int
    target: int

    def __init__(
        self,
        *,
        factor: float = 1.0,
        limits: tuple[float, float] | None = None,
        stop: Literal["quick_stop", "halt"] = "quick_stop",
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        if not factor:
            raise ConfigError(self.name, "factor", "expected a factor that is not 0")
        self.factor = factor
        largest = abs(factor) * (2**31 - 1)
        self._allowed = -largest, largest
        if limits is not None:
            self._allowed = narrowed(
                self.name, "limits", limits, self._allowed, by="its factor"
            )
        self.claim: str = f"the drive of node {self.node}"
        self.stop = check_choice(self.name, "stop", stop, ("quick_stop", "halt"))
        self.state: State | None = None
        """What the drive told last; None while it is not open."""
        self._status = 0
        self._is_on = False
        self._is_stopping = False
        self._stopped_at = 0.0
        self._word = 0
        """The controlword that it was told last."""
        self._newest = 0
        self._emergency: Emergency | None = None
        self._watching: asyncio.Task[None] | None = None
        self._news = asyncio.Event()

    @property
    def _stop_word(self) -> int:
        halts = self.stop == "halt" and self.state is State.ENABLED
        return ENABLE | HALT if halts else QUICK_STOP

    def safe_frames(self) -> SafeFrames:
        """Stop, in the PDO of commands, with its SYNC; and once more by SDO."""
        # Asked for before it is enabled: until then it ignores the word that holds it.
        told = QUICK_STOP if self.stop == "quick_stop" else ENABLE | HALT
        data = struct.pack("<Hi", told, 0)
        frames = [can_frame(0x200 + self.node, data)]
        if self.sync is not None:
            frames.append(can_frame(SYNC, b""))
        word = struct.pack("<H", told)
        return SafeFrames([*frames, *sdo_frames(self.node, CONTROLWORD, 0, word)])

    def heed(self, emergency: Emergency) -> None:
        """Remember what is wrong, for the fault that follows."""
        super().heed(emergency)
        self._emergency = emergency if emergency.code else None

    def _prepare(self, remote: Any) -> None:
        remote.sdo[CONTROLWORD].raw = QUICK_STOP
        remote.sdo[MODE].raw = self.mode
        by_sync = self.sync is not None
        self._map(remote.rpdo[1], (CONTROLWORD, self.target), by_sync=by_sync)
        super()._prepare(remote)

    async def open(self) -> None:
        """Find the node, set it up, and clear a fault; it is not enabled by that."""
        self._is_on = self._is_stopping = False
        self._emergency = None
        self._news = asyncio.Event()  # that from before may be of another loop
        self.state = None
        await super().open()
        self.state = await self._call(self._reset, self._remote)
        inbox = self.bus.frames(0x180 + self.node, limit=8)
        self._watching = watching(self, inbox, self._watch)

    async def close(self) -> None:
        """Leave the node."""
        await ended(self._watching)
        await super().close()
        self.state = None

    def _reset(self, remote: Any) -> State:
        """Clear a fault, in the thread; one that remains is a fault of the device."""
        for word in (0, RESET, RESET, RESET):
            status = state_of(remote.sdo[STATUSWORD].raw)
            if status not in {State.FAULT, State.FAULT_REACTION}:
                return status
            remote.sdo[CONTROLWORD].raw = word
        try:
            code = remote.sdo[ERROR_CODE].raw
        except (KeyError, SdoAbortedError):
            code = 0
        raise DeviceFaultError(self.name, f"its fault remains: error code {code:#06x}")

    async def _go(self, *words: int, value: int) -> None:
        """Enable the drive if it is not, and tell it a target; with the newest only."""
        mine = self._begin()
        if self.state is not State.ENABLED:
            await self._enable(mine)
        for word in words:
            await self._tell(mine, word, value)
            await self._heed_of(mine, word)
        self._is_on = self._is_on or mine == self._newest

    async def _heed_of(self, mine: int, word: int) -> None:
        """Wait until the drive has seen a controlword, if that matters in its mode."""

    async def _stop(self) -> None:
        word = self._stop_word
        self._is_on = self._is_on and word != QUICK_STOP
        await self._tell(self._begin(), word, 0)
        if self.sync is not None:  # at once: the next one may be after the close
            await self.bus.send(SYNC, b"")
        if word == QUICK_STOP and self.state is State.ENABLED:
            self.state = State.QUICK_STOP
            self._stopped_at = asyncio.get_running_loop().time()
            self._is_stopping = True  # what it told before may still come

    def _begin(self) -> int:
        self._newest += 1
        return self._newest

    def _check_newest(self, mine: int) -> None:
        if mine != self._newest:
            raise BusyError(self.name, "number of waiting writes", 1)

    async def _tell(self, mine: int, word: int, value: int) -> None:
        self._check_newest(mine)
        self._connected()
        self._word = word
        data = struct.pack("<Hi", word, value)
        await self.bus.send(0x200 + self.node, data, replaces=word)

    async def _enable(self, mine: int) -> None:
        if self._is_stopping:
            status = await self._call(self._ask)
            self._is_stopping = False
            self._hear(status)
        loop = asyncio.get_running_loop()
        end = loop.time() + ENABLE_TIMEOUT
        quick_stop_until = loop.time() + ENABLE_TIMEOUT / 2
        while self.state is not State.ENABLED:
            state = self.state
            if state in {State.FAULT, State.FAULT_REACTION}:
                raise self._fault()
            if loop.time() >= end:
                word = "of unknown state" if state is None else state.value
                told = f"it is not enabled in {ENABLE_TIMEOUT:g} s: it is {word}"
                raise DeviceFaultError(self.name, told)
            word = WAY.get(state) if state is not None else None
            if state is State.QUICK_STOP and loop.time() >= quick_stop_until:
                word = DISABLE  # this drive does not go on from there
            self._news.clear()
            if word is not None:
                await self._tell(mine, word, 0)
            await self._until(functools.partial(self._has_left, state))

    def _has_left(self, state: State | None) -> bool:
        return self.state is not state

    async def _until(self, is_so: Callable[[], bool]) -> None:
        """Wait for what the drive tells of itself; it is asked if it tells nothing new."""
        try:
            async with asyncio.timeout(ASK_PERIOD):
                while not is_so():
                    await self._news.wait()
                    self._news.clear()
        except TimeoutError:
            self._hear(await self._call(self._ask))

    def _ask(self) -> int:
        return int(self._remote.sdo[STATUSWORD].raw)

    def _hear(self, status: int) -> None:
        self._status = status
        state = state_of(status)
        if state is State.ENABLED and self._is_stopping:
            return
        self._is_stopping = False
        self.state = state
        self._news.set()

    async def _watch(self, inbox: Inbox[Frame]) -> None:
        loop, missed = asyncio.get_running_loop(), 0
        half = None if self._silence is None else self._silence / 2
        while True:
            try:
                frame = await inbox.take(timeout=half)
            except TimeoutError:  # once it may be that this computer was held up
                missed += 1
                if missed == 2:
                    text = f"it has told nothing for {self._silence:g} s"
                    raise DeviceLostError(self.name, text) from None
                continue
            missed = 0
            if len(frame.data) < 2:
                continue
            self._hear(int.from_bytes(frame.data[:2], "little"))
            if self.state in {State.FAULT, State.FAULT_REACTION}:
                raise self._fault()
            if self._is_stopping and loop.time() - self._stopped_at > STOPS_WITHIN:
                text = f"it is enabled {STOPS_WITHIN:g} s after it was told to stop"
                raise DeviceFaultError(self.name, text)
            if self._is_on and self.state is not State.ENABLED:
                assert self.state is not None
                text = f"it is not enabled any more: it is {self.state.value}"
                raise DeviceFaultError(self.name, text)

    def _fault(self) -> DeviceFaultError:
        why = self._emergency or "no emergency told why"
        return DeviceFaultError(self.name, f"the drive has a fault: {why}")


@attrs.frozen
class DriveReading:
    """What a drive measures, and how it is.

    Attributes:
        position: In rad, or the unit that its factor gives. A drive counts in 32 bits:
            beyond them it goes on from the other end.
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
            devices on a bus. If one on its node has none, it tells by ``tell_every``.
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
        self._first: bytes | None = None

    async def stream(self) -> AsyncIterator[DriveReading]:
        """Yield what it tells; its second PDO completes a reading."""
        self._first = None
        ids = 0x180 + self.node, 0x280 + self.node
        with self.bus.frames(*ids, limit=64) as inbox:
            readings = heard(self, inbox, self._silence, self._completed, "no reading")
            async for reading in readings:
                yield reading

    def _completed(self, frame: Frame) -> DriveReading | None:
        is_first, told = frame.id == 0x180 + self.node, self._first
        if len(frame.data) < (6 if is_first else 4):
            self.bad_frames += 1
            return None
        self._first = frame.data if is_first else None  # each is told anew
        if is_first or told is None:
            return None
        return DriveReading(
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
    once; it is opened again and not enabled until a fresh command. So is one that tells
    nothing for 0.25 s, or ten times its period, or is enabled 0.25 s after its stop.

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
    mode = PROFILE_VELOCITY
    target = TARGET_VELOCITY

    def __init__(
        self, *, sync: float | None = None, **settings: Unpack[DriveActuatorSettings]
    ) -> None:
        super().__init__(**settings)
        self.sync: float | None = self._check_sync(sync)
        self.limits: tuple[float, float] = self._allowed

    async def write(self, command: float) -> float | None:
        """Tell the drive its velocity, and enable it if that is not 0; or stop it.

        Returns the velocity in its units, if that is another one.
        """
        if command == self.safe:
            await self._stop()
            return None
        value = in_units(command, self.factor, self.limits)
        await self._go(ENABLE, value=value)
        return applied(command, value * self.factor)


def _signed(data: bytes) -> int:
    return int.from_bytes(data, "little", signed=True)
