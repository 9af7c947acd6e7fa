"""A microcontroller with ESAIR MIN as a part of the robot, on a serial line.

The board runs what ``esair min build --link`` has written: its reactions stay on it, and
outrank this computer. Its sensors and actuators appear here under the same names::

    [board.base]
    port = "usb:2e8a:0005"
    robot = "base.toml"      # what the board was built from

That stands for these tables::

    [bus.base]
    type = "serial"
    port = "usb:2e8a:0005"
    framing = "cobs"

    [sensor.base]            # how the board is
    driver = "esair.drivers.board:Board"
    bus = "base"

    [sensor.bumper]
    driver = "esair.drivers.board:BoardSensor"
    bus = "base"

    [actuator.wheels]
    driver = "esair.drivers.board:BoardActuator"
    bus = "base"
    safe = [0.0, 0.0]

Both sides send beats. When this computer's stay away, whatever it moved is safe on the
board at once; when the board's do, its sensors and actuators are lost here.

Source: `esair.boards.link`, which the board runs.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import logging
from binascii import crc32
from collections.abc import AsyncIterator
from typing import Any, Unpack

import attrs

from esair.boards.link import BEAT_MS, VERSION
from esair.buses import Inbox, SerialBus
from esair.drivers._on_bus import SharedTask, shared
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.resources import Actuator, ActuatorSettings, Sensor, SensorSettings

__all__ = ["Board", "BoardActuator", "BoardSensor", "BoardState"]

_log = logging.getLogger("esair")

SILENCE = 0.5
"""After so many seconds without a beat the board is lost."""

_RESTARTED = -2
"""The time of a board that has gone back: it forgot what it was told."""


@attrs.frozen
class BoardState:
    """How a board is.

    Attributes:
        now_ms: Its time, in milliseconds since its start.
        steps: How many steps it has made.
        late: How many steps it has left out because they came too late.
        refused: How many commands it has refused.
        faults: How many times a part of it has failed.
        fault: The last fault; empty if there was none.
        memory: The bytes of memory that are free on it.
        cause: Why it has started: ``"power-on"``, ``"watchdog"``, ...
        armed: Whether its actuators may move.
        damaged: How many messages of this computer it could not read.
        sensors: The names of those of its sensors that have given a reading.
        actuators: The names of its actuators.
    """

    now_ms: int
    steps: int
    late: int
    refused: int
    faults: int
    fault: str
    memory: int
    cause: str
    armed: bool
    damaged: int
    sensors: tuple[str, ...]
    actuators: tuple[str, ...]


class _Beats(SharedTask):
    """What all devices of one board share: the beats, one task of a bus that is open."""

    @classmethod
    def of(cls, bus: SerialBus) -> _Beats:
        """Return that of a bus."""
        beats = shared(bus, cls)
        if not beats:
            beats[VERSION] = cls(bus)
        return beats[VERSION]

    def __init__(self, bus: SerialBus) -> None:
        super().__init__(bus)
        self._heard = -1.0
        self._now_ms = -1
        """The board's own time at its last beat."""
        self._first: asyncio.Event = asyncio.Event()
        self.version = 0
        """What the board speaks; 0 before its first beat."""
        self.armed: bool | None = None
        """What the board is told; None to leave it as it is."""

    async def join(self, user: object, bus: SerialBus, name: str) -> None:
        """Wait for the first beat of the board."""
        if self.begin(user, functools.partial(self._run, bus)):
            self._heard, self._now_ms, self.version = -1.0, -1, 0
            self._first = asyncio.Event()
        try:
            async with asyncio.timeout(1.6 * SILENCE):
                await self._first.wait()
        except TimeoutError:
            await self.leave(user)
            raise DeviceLostError(name, "the board is silent") from None
        except BaseException:
            await self.leave(user)
            raise
        if self.version != VERSION:
            await self.leave(user)
            raise DeviceFaultError(
                name,
                f"the board speaks version {self.version} of the link, this computer "
                f"{VERSION}: build and deploy it anew",
            )

    def check(self, name: str) -> None:
        """Raise if the board has been silent for too long, or has started anew."""
        if self._now_ms == _RESTARTED:
            raise DeviceLostError(name, "the board has restarted")
        silent = asyncio.get_running_loop().time() - self._heard
        if self._task is None or self._task.done() or silent > SILENCE:
            raise DeviceLostError(name, "the board is silent")

    async def _run(self, bus: SerialBus) -> None:
        loop = asyncio.get_running_loop()
        with bus.frames(b"B\0") as inbox:
            due = loop.time()
            while True:
                if loop.time() >= due:
                    due = loop.time() + BEAT_MS / 1000
                    await bus.send(_signed(b"B" + str(VERSION).encode()))
                    if self.armed is not None:
                        await bus.send(_signed(b"A" + str(int(self.armed)).encode()))
                try:
                    frame = await inbox.take(timeout=max(0.0, due - loop.time()))
                except TimeoutError:
                    continue
                value = _value_of(frame, b"B\0")
                if not isinstance(value, list) or len(value) < 2:
                    continue
                self._heard = loop.time()
                self.version, now_ms = value[:2]
                self._first.set()
                if isinstance(now_ms, int):
                    if now_ms < self._now_ms:
                        self._now_ms = _RESTARTED
                        return
                    self._now_ms = now_ms


class _OnBoard:
    """What a board's devices have in common."""

    bus: SerialBus
    name: str

    async def open(self) -> None:
        """Wait until the board beats."""
        await _Beats.of(self.bus).join(self, self.bus, self.name)

    async def close(self) -> None:
        """Let the line go, with the last of the board's devices."""
        await _Beats.of(self.bus).leave(self)


class Board(_OnBoard, Sensor[BoardState]):
    """How the board is: steps, faults, memory; one reading for each of its beats.

    It arms the board while it is open, if ``arm`` is set.
    """

    bus: SerialBus
    period = SILENCE

    def __init__(self, *, arm: bool = True, **settings: Unpack[SensorSettings]) -> None:
        super().__init__(**settings)
        self.arm = arm

    async def open(self) -> None:
        """Wait until the board beats, and arm it."""
        beats = _Beats.of(self.bus)
        beats.armed = True if self.arm else None
        await super().open()

    async def close(self) -> None:
        """Disarm the board, and let the line go."""
        beats = _Beats.of(self.bus)
        if beats.armed:
            beats.armed = None
            with contextlib.suppress(Exception):  # it is lost: it is safe by itself
                await self.bus.send(_signed(b"A0"))
        await super().close()

    async def stream(self) -> AsyncIterator[BoardState]:
        """Yield the state with each beat.

        Raises:
            DeviceLostError: The beats stay away.
        """
        faults = None
        with self.bus.frames(b"B\0") as inbox:
            async for value in _values(self.bus, self.name, b"B\0", inbox):
                state = _state(value)
                if state is None:
                    continue
                if faults is not None and state.faults > faults:
                    _log.warning(
                        "%s: %s, fault %d", self.name, state.fault, state.faults
                    )
                faults = state.faults
                yield state


class BoardSensor(_OnBoard, Sensor[Any]):
    """A sensor of the board, under the same name: its readings, as they come.

    Numbers, truth values and texts come as they are, lists as tuples. If it has given
    none for three of its periods, the board says so with each of its beats.
    """

    bus: SerialBus

    def __init__(self, **settings: Unpack[SensorSettings]) -> None:
        super().__init__(**settings)
        self._inbox: Inbox[bytes] | None = None

    async def open(self) -> None:
        """Wait until the board beats, and listen from now on."""
        await super().open()
        self._prefix = b"S" + self.name.encode() + b"\0"
        self._inbox = self.bus.frames(self._prefix)  # beyond an error of the stream

    async def close(self) -> None:
        """Listen no more, and let the line go, with the last of the board's devices."""
        if self._inbox is not None:
            self._inbox.close()
        await super().close()

    async def stream(self) -> AsyncIterator[Any]:
        """Yield each reading of the board.

        Raises:
            DeviceLostError: The board is silent.
            DeviceFaultError: It gives no reading on the board.
        """
        assert self._inbox is not None
        async for value in _values(self.bus, self.name, self._prefix, self._inbox):
            if value == []:
                raise DeviceFaultError(self.name, "it gives no reading on the board")
            if isinstance(value, list) and len(value) == 2:
                yield _tuples(value[1])


class BoardActuator(_OnBoard, Actuator[Any]):
    """An actuator of the board, under the same name. It has to be told ``safe``.

    The board stops by itself when this computer is silent: `own_timeout`.
    """

    bus: SerialBus
    own_timeout = 0.35

    def __init__(self, *, safe: Any, **settings: Unpack[ActuatorSettings]) -> None:
        super().__init__(**settings)
        self.safe = _tuples(safe)

    @property
    def value_type(self) -> Any:
        """The type of its safe command, as on the board."""
        return type(self.safe)

    async def is_set_up(self) -> bool:
        """Notice a board that is silent, or has restarted, though nobody writes.

        Raises:
            DeviceLostError: It is.
        """
        _Beats.of(self.bus).check(self.name)
        return True

    async def write(self, command: Any) -> None:
        """Send a command; the board's own reactions may outrank it.

        Raises:
            DeviceLostError: The board is silent.
        """
        _Beats.of(self.bus).check(self.name)
        body = json.dumps(command).encode()
        await self.bus.send(_signed(b"W" + self.name.encode() + b"\0" + body))


async def _values(
    bus: SerialBus, name: str, prefix: bytes, inbox: Inbox[bytes]
) -> AsyncIterator[Any]:
    beats = _Beats.of(bus)
    while True:
        try:
            frame = await inbox.take(timeout=SILENCE / 2)
        except TimeoutError:
            beats.check(name)
            continue
        beats.check(name)
        value = _value_of(frame, prefix)
        if value is not None:
            yield value


def _signed(payload: bytes) -> bytes:
    return payload + crc32(payload).to_bytes(4, "little")


def _value_of(frame: bytes, prefix: bytes) -> Any:
    """Return what a message says; None if it is damaged."""
    payload = frame[:-4]
    if frame != _signed(payload):
        return None
    try:
        return json.loads(payload[len(prefix) :])
    except ValueError:
        return None


def _state(value: Any) -> BoardState | None:
    try:
        words = [each.name for each in attrs.fields(BoardState)]
        found = dict(zip(words, value[1:], strict=True))
        found["sensors"] = tuple(found["sensors"])
        found["actuators"] = tuple(found["actuators"])
        return BoardState(**found)
    except (TypeError, ValueError):
        return None


def _tuples(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return tuple(map(_tuples, value))
    return value
