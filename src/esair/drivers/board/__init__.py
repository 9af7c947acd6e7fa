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

The board beats, and this computer answers each beat. When the answers stay away, whatever
it moved is safe on the board at once, and what comes late moves nothing; when the beats
do, or get too old, its sensors and actuators are lost here. Readings that the line has kept
while this computer stood still are none. The board tells what it did with a command.

Source: `esair.boards.link`, which the board runs.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import math
from collections.abc import AsyncIterator
from typing import Any, Unpack

from esair.boards.link import AT_ONCE, BEAT_MS, SILENCE_MS, VERSION
from esair.buses import Inbox, SerialBus
from esair.drivers._on_bus import SharedTask, shared
from esair.drivers.board.wire import (
    Answer,
    Beat,
    BoardState,
    Heard,
    Wire,
    refusal,
    tuples,
)
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.loop import clock_of
from esair.messages import Refused
from esair.resources import Actuator, ActuatorSettings, Sensor, SensorSettings

__all__ = ["Board", "BoardActuator", "BoardSensor", "BoardState"]

_log = logging.getLogger("esair")

SILENCE = 0.5
"""After so many seconds without a beat the board is lost."""

_LATE = SILENCE_MS / 1000
"""A beat that is heard so much later than others was is old, and so is what it brings."""

_ASK_AGAIN = 1.0
"""The board is asked again for its readings, so often: a message may be lost."""

_PATIENCE = 0.15
"""An answer takes a few steps of the board, and so long on the line, in seconds."""

_MISSING = "the board has no {} of this name: build and deploy it anew"

_RESTARTED = -2
"""The time of a board that has gone back: it forgot what it was told."""


class _Beats(SharedTask):
    """What all devices of one board share: a task of a bus that is open.

    It answers the beats, asks for the readings, and hands on what the board says.
    """

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
        self._way = math.inf
        """How far the board's time is behind this computer's, in seconds."""
        self._good_until = -1.0
        """Until then what the board says is not old, by its last beat."""
        self._first: asyncio.Event = asyncio.Event()
        self.wire = Wire()
        self._turn = 0.0
        self._sending = asyncio.Lock()
        self._waiting: dict[str, bytes] = {}
        """The newest command of each actuator that was not sent yet, the oldest first."""
        self._asked: dict[str, asyncio.Future[Answer]] = {}
        """Who waits for what came of the newest command of an actuator."""
        self.armed: bool | None = None
        """What the board is told; None to leave it as it is."""
        self.rates: dict[str, float] = {}
        """How often each of its sensors is read, in Hz."""
        self.listeners: dict[str, Inbox[Any]] = {}
        """Who hears the readings, by sensor, and the states, by no name."""

    async def join(self, user: object, bus: SerialBus, name: str) -> None:
        """Wait for the first beat of the board, and its names."""
        if self.begin(user, functools.partial(self._run, bus)):
            self._heard, self._now_ms, self.wire = -1.0, -1, Wire()
            self._way = math.inf
            self._first, self._sending = asyncio.Event(), asyncio.Lock()
            self._waiting = {}
        elif self._silent:
            self._first.clear()  # another device of it has not noticed yet
        try:
            async with asyncio.timeout(1.6 * SILENCE):
                await self._first.wait()
            if self.wire.version != VERSION:
                raise DeviceFaultError(name, refusal(self.wire.version))
        except TimeoutError:
            await self.leave(user)
            raise DeviceLostError(name, "the board is silent") from None
        except BaseException:
            await self.leave(user)
            raise

    @property
    def _silent(self) -> bool:
        heard = min(self._heard, self._good_until)  # what is old is no sign of life
        return asyncio.get_running_loop().time() - heard > SILENCE

    def check(self, name: str) -> None:
        """Raise if nothing new has come for too long, or the board has started anew."""
        if self._now_ms == _RESTARTED:
            raise DeviceLostError(name, "the board has restarted")
        if self._task is None or self._task.done() or self._silent:
            raise DeviceLostError(name, "the board is silent")

    async def _run(self, bus: SerialBus) -> None:
        loop = asyncio.get_running_loop()
        asks = loop.time()
        with bus.frames() as inbox:
            async for frame in inbox:
                for said in self.wire.read(frame):
                    if isinstance(said, Answer):
                        self._answered(said)
                    elif isinstance(said, Beat):
                        if self._beaten(said, loop.time()):
                            return
                    elif loop.time() <= self._good_until:
                        self._hand_on(said.name, said)
                if not self.wire.owes:
                    continue
                if loop.time() > self._good_until:  # this computer stood still
                    asks = loop.time()  # and the board tells nobody its readings
                    continue
                for message in self.wire.beat(self.armed):
                    await self._send(bus, message)
                if self.wire.named and loop.time() >= asks:
                    asks = loop.time() + _ASK_AGAIN
                    for message in self.wire.rates(self.rates):
                        await self._send(bus, message)

    async def command(
        self, bus: SerialBus, name: str, command: object
    ) -> Answer | None:
        """Send a command, in one message with the others that wait for the next step.

        Returns:
            What the board has answered; None if it says nothing.
        """
        wire, waiting = self.wire, self._waiting
        mine = wire.command(name, command)
        if mine is None:
            raise DeviceFaultError(name, _MISSING.format("actuator"))
        waiting[name] = mine
        answer = self._asked[name] = asyncio.get_running_loop().create_future()
        try:
            async with self._sending:
                while waiting.get(name) is mine:  # it did not go with another
                    await self._step_of_the_board()
                    if wire is not self.wire:
                        raise DeviceLostError(name, "the board has restarted")
                    message, names = wire.commands(waiting)
                    sent = [(each, waiting[each]) for each in names]
                    await self._put(bus, message)
                    for each, what in sent:
                        if waiting.get(each) is what:
                            del waiting[each]
            async with asyncio.timeout(_PATIENCE + 5 * wire.period):
                said: Answer = await answer
                return said
        except TimeoutError:
            return None
        finally:
            if waiting.get(name) is mine:
                del waiting[name]
            if self._asked.get(name) is answer:
                del self._asked[name]

    def _answered(self, said: Answer) -> None:
        answer = self._asked.get(said.name)
        is_newest = self.wire.numbers.get(said.name) == said.number
        if answer and not answer.done() and is_newest:
            answer.set_result(said)

    async def _send(self, bus: SerialBus, message: bytes) -> None:
        async with self._sending:
            await self._step_of_the_board()
            await self._put(bus, message)

    async def _step_of_the_board(self) -> None:
        """Wait until the board has taken the message before, in a step or more."""
        left = self._turn - asyncio.get_running_loop().time()
        if left > 0:
            await asyncio.sleep(left)

    async def _put(self, bus: SerialBus, message: bytes) -> None:
        steps = 1 + len(message) // AT_ONCE
        period = 1.05 * steps * self.wire.period * self.wire.named
        self._turn = asyncio.get_running_loop().time() + period
        await bus.send(message)

    def _hand_on(self, name: str, said: object) -> None:
        inbox = self.listeners.get(name)
        if inbox is not None:
            inbox.offer(said)

    def _beaten(self, beat: Beat, now: float) -> bool:
        """Take a beat; tell whether the board has started anew."""
        passed, self._heard = now - self._heard, now
        state = beat.state
        if state is None or self.wire.named:
            self._first.set()
        if state is None:
            return False
        if state.now_ms < self._now_ms:
            self._now_ms = _RESTARTED
            return True
        self._now_ms = state.now_ms
        # The clocks differ, and one may stand still: in time each way is a usual one.
        way = now - state.now_ms / 1000
        self._way = min(way, self._way + min(passed, BEAT_MS / 1000) / 4)
        self._good_until = now - way + self._way + _LATE
        self._hand_on("", state)
        return False


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
    period: float = SILENCE

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
                for message in beats.wire.beat(armed=False):
                    await self.bus.send(message)
        await super().close()

    async def stream(self) -> AsyncIterator[BoardState]:
        """Yield the state with each beat.

        Raises:
            DeviceLostError: The beats stay away.
        """
        faults = None
        with _listening(self.bus, "") as inbox:
            async for state in _values(self.bus, self.name, inbox):
                if faults is not None and state.faults > faults:
                    _log.warning(
                        "%s: %s, fault %d", self.name, state.fault, state.faults
                    )
                faults = state.faults
                yield state


class BoardSensor(_OnBoard, Sensor[Any]):
    """A sensor of the board, under the same name: its readings, as they come.

    Numbers, truth values and texts come as they are, infinity and NaN in rows too, lists
    as tuples. If it has given none for three of its periods, the board says so with each
    of its beats.

    Args:
        link_rate: How often a reading is sent at most, in Hz. The reactions on the board
            see each one; only those that are asked for go over the line.
    """

    bus: SerialBus

    def __init__(
        self, *, link_rate: float = 10.0, **settings: Unpack[SensorSettings]
    ) -> None:
        super().__init__(**settings)
        if not 0.0 < link_rate <= 1000.0:
            told = f"expected more than 0 and at most 1000 Hz, not {link_rate!r:.80}"
            raise ConfigError(self.name, "link_rate", told)
        self.link_rate = link_rate
        self._inbox: Inbox[Heard] | None = None

    async def open(self) -> None:
        """Wait until the board beats, ask for the readings, and listen from now on.

        Raises:
            DeviceFaultError: The board has no such sensor.
        """
        beats = _Beats.of(self.bus)
        beats.rates[self.name] = self.link_rate
        await super().open()
        if self.name not in beats.wire.sensors:
            await self.close()
            raise DeviceFaultError(self.name, _MISSING.format("sensor"))
        self._inbox = _listening(self.bus, self.name)  # beyond an error of the stream

    async def close(self) -> None:
        """Listen no more, and let the line go, with the last of the board's devices."""
        _Beats.of(self.bus).rates.pop(self.name, None)
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
        async for said in _values(self.bus, self.name, self._inbox):
            if said.gone:
                raise DeviceFaultError(self.name, "it gives no reading on the board")
            yield said.value


class BoardActuator(_OnBoard, Actuator[Any]):
    """An actuator of the board, under the same name. It has to be told ``safe``.

    The board stops by itself when this computer is silent: `own_timeout`.
    """

    bus: SerialBus
    own_timeout: float = 0.35

    def __init__(self, *, safe: Any, **settings: Unpack[ActuatorSettings]) -> None:
        super().__init__(**settings)
        self.safe: Any = tuples(safe)

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

    async def open(self) -> None:
        """Wait until the board beats."""
        self.refused: Refused | None = None
        """What the board has answered last, if that was a refusal."""
        await super().open()

    async def write(self, command: Any) -> Any:
        """Send a command, and wait for what the board did with it in its next step.

        Returns:
            What its guards have let pass; or a refusal with the reaction of the board
            that holds it, or what else is in the way.

        Raises:
            DeviceLostError: The board is silent, or does not answer a safe command.
        """
        beats, name = _Beats.of(self.bus), self.name
        for _ in range(2 if command == self.safe else 1):  # what is safe may come twice
            beats.check(name)
            said = await beats.command(self.bus, name, command)
            if said is not None:
                self.refused = self._refusal(said.who, said.reason)
                return said.done if self.refused is None else self.refused
        beats.check(name)
        if command == self.safe:
            raise DeviceLostError(name, "the board does not answer")
        told = "the board does not answer: what came of it is unknown"
        self.refused = self._refusal("", told)
        return self.refused

    def _refusal(self, who: str, reason: str) -> Refused | None:
        holder = f"{self.bus.name}:{who}" if who else self.bus.name
        now = clock_of(asyncio.get_running_loop())()
        return Refused(holder, 0, reason, now, None) if reason else None


def _listening(bus: SerialBus, name: str) -> Inbox[Any]:
    """Hear what the board says of a sensor, or of itself."""
    listeners = _Beats.of(bus).listeners

    def forget(inbox: Inbox[Any]) -> None:
        if listeners.get(name) is inbox:
            del listeners[name]

    listeners[name] = Inbox(64, forget)
    return listeners[name]


async def _values(bus: SerialBus, name: str, inbox: Inbox[Any]) -> AsyncIterator[Any]:
    beats = _Beats.of(bus)
    while True:
        try:
            value = await inbox.take(timeout=SILENCE / 2)
        except TimeoutError:
            beats.check(name)
            continue
        beats.check(name)
        yield value
