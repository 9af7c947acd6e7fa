"""What the devices of a drive have in common: its PDOs, and its way through the states."""

from __future__ import annotations

import asyncio
import struct
from pathlib import Path
from typing import Any, Final, Literal

from canopen.sdo.exceptions import SdoAbortedError

from esair.buses import CanBus, Frame, Inbox
from esair.drivers._on_bus import SharedTask, ended, shared
from esair.drivers.canopen import _profile as profile
from esair.drivers.canopen._dictionary import read_eds
from esair.drivers.canopen._node import Emergency, sdo_frames
from esair.drivers.canopen._on_node import NodeSettings, OnNode
from esair.drivers.canopen._profile import State, state_of
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.resources import ActuatorSettings, Resource
from esair.values import check_choice, check_seconds
from esair.watchdog import SafeFrames, can_frame

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
        bus = self._bus()
        if bus is not None and self._users.keys() <= {device}:
            shared(bus, Sync).pop(SYNC, None)
        await super().leave(device)

    async def _send(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while (bus := self._bus()) is not None:
            assert isinstance(bus, CanBus)
            try:
                await bus.send(SYNC, b"", replaces=True, timeout=self.period)
            except DeviceLostError:
                return
            except (BusyError, DeviceFaultError, DriverStuckError):
                pass  # the next one comes soon; the bus counts
            del bus
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

LONGEST_SYNC: Final = 0.1
"""The longest period of the SYNC: a stop may wait for it, in seconds."""

TOLD: Final = (profile.STATUSWORD, profile.POSITION), (profile.VELOCITY,)
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
            profile.standard(node) if eds is None else read_eds(self.name, eds, node)
        )
        self.tell_every: float = check_seconds(self.name, "tell_every", tell_every)
        self._is_prepared = False
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
        for number, mapped in enumerate(TOLD, 1):
            pdo = remote.tpdo[number]
            pdo.rtr_allowed = False
            pdo.event_timer = round(self.tell_every * 1000) if self.sync is None else 0
            self._map(pdo, mapped)
        self._is_prepared = True

    def _map(self, pdo: Any, mapped: tuple[int, ...]) -> None:
        pdo.clear()
        for index in mapped:
            if pdo.add_variable(index) is None:
                raise DeviceFaultError(self.name, f"the file has no object {index:#x}")
        pdo.cob_id = pdo.predefined_cob_id
        pdo.trans_type = 255 if self.sync is None else 1
        if 5 not in pdo.com_record.od:
            pdo.event_timer = None
        pdo.enabled = True
        pdo.save()

    async def open(self) -> None:
        """Find the node and have it tell."""
        self._is_prepared = False
        await super().open()
        if not self._is_prepared:  # the node runs for another device already
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
        self._allowed = (-largest, largest) if limits is None else limits
        self.claim: str = f"the drive of node {self.node}"
        self.stop = check_choice(self.name, "stop", stop, ("quick_stop", "halt"))
        self.state: State | None = None
        """What the drive told last; None while it is not open."""
        self._is_on = False
        self._is_stopping = False
        self._newest = 0
        self._emergency: Emergency | None = None
        self._watching: asyncio.Task[None] | None = None
        self._news = asyncio.Event()

    @property
    def _stop_word(self) -> int:
        halts = self.stop == "halt" and self.state is State.ENABLED
        return profile.ENABLE | profile.HALT if halts else profile.QUICK_STOP

    def safe_frames(self) -> SafeFrames:
        """Stop, in the PDO of commands, with its SYNC; and once more by SDO."""
        data = struct.pack("<Hi", self._stop_word, 0)
        frames = [can_frame(0x200 + self.node, data)]
        if self.sync is not None:
            frames.append(can_frame(SYNC, b""))
        word = struct.pack("<H", self._stop_word)
        return SafeFrames(
            [*frames, *sdo_frames(self.node, profile.CONTROLWORD, 0, word)]
        )

    def heed(self, emergency: Emergency) -> None:
        """Remember what is wrong, for the fault that follows."""
        super().heed(emergency)
        self._emergency = emergency if emergency.code else None

    def _prepare(self, remote: Any) -> None:
        remote.sdo[profile.CONTROLWORD].raw = profile.QUICK_STOP
        remote.sdo[profile.MODE].raw = self.mode
        self._map(remote.rpdo[1], (profile.CONTROLWORD, self.target))
        super()._prepare(remote)

    async def open(self) -> None:
        """Find the node, set it up, and clear a fault; it is not enabled by that."""
        self._is_on = self._is_stopping = False
        self._emergency = None
        self.state = None
        await super().open()
        self.state = await self._call(self._reset, self._remote)
        inbox = self.bus.frames(0x180 + self.node, limit=8)
        self._watching = asyncio.get_running_loop().create_task(
            self._watch(inbox), name=f"{self.name} state"
        )

    async def close(self) -> None:
        """Leave the node."""
        task, self._watching = self._watching, None
        await ended(task)
        await super().close()
        self.state = None

    def _reset(self, remote: Any) -> State:
        """Clear a fault, in the thread; one that remains is a fault of the device."""
        for word in (0, profile.RESET, profile.RESET, profile.RESET):
            status = state_of(remote.sdo[profile.STATUSWORD].raw)
            if status not in {State.FAULT, State.FAULT_REACTION}:
                return status
            remote.sdo[profile.CONTROLWORD].raw = word
        try:
            code = remote.sdo[profile.ERROR_CODE].raw
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
        self._is_on = True

    async def _stop(self) -> None:
        word = self._stop_word
        self._is_on = self._is_on and word != profile.QUICK_STOP
        await self._tell(self._begin(), word, 0)
        if self.sync is not None:  # at once: the next one may be after the close
            await self.bus.send(SYNC, b"")
        if word == profile.QUICK_STOP and self.state is State.ENABLED:
            self.state = State.QUICK_STOP
            self._is_stopping = True  # what it told before may still come

    def _begin(self) -> int:
        self._newest += 1
        return self._newest

    async def _tell(self, mine: int, word: int, value: int) -> None:
        if mine != self._newest:
            raise BusyError(self.name, "number of waiting writes", 1)
        self._connected()
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
                raise DeviceFaultError(
                    self.name,
                    f"it is not enabled in {ENABLE_TIMEOUT:g} s: it is {word}",
                )
            word = profile.WAY.get(state) if state is not None else None
            if state is State.QUICK_STOP and loop.time() >= quick_stop_until:
                word = profile.DISABLE  # this drive does not go on from there
            self._news.clear()
            if word is not None:
                await self._tell(mine, word, 0)
            try:
                async with asyncio.timeout(ASK_PERIOD):
                    while self.state is state:
                        await self._news.wait()
                        self._news.clear()
            except TimeoutError:
                self._hear(await self._call(self._ask))

    def _ask(self) -> int:
        return int(self._remote.sdo[profile.STATUSWORD].raw)

    def _hear(self, status: int) -> None:
        state = state_of(status)
        if state is State.ENABLED and self._is_stopping:
            return
        self._is_stopping = False
        self.state = state
        self._news.set()

    async def _watch(self, inbox: Inbox[Frame]) -> None:
        try:
            async for frame in inbox:
                if len(frame.data) < 2:
                    continue
                self._hear(int.from_bytes(frame.data[:2], "little"))
                if self.state in {State.FAULT, State.FAULT_REACTION}:
                    self.report_lost(self._fault())
                    return
                if self._is_on and self.state is not State.ENABLED:
                    assert self.state is not None
                    text = f"it is not enabled any more: it is {self.state.value}"
                    self.report_lost(DeviceFaultError(self.name, text))
                    return
        except OSError as error:
            self.report_lost(error)
        finally:
            inbox.close()

    def _fault(self) -> DeviceFaultError:
        why = self._emergency or "no emergency told why"
        return DeviceFaultError(self.name, f"the drive has a fault: {why}")
