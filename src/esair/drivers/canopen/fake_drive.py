"""A drive of CiA 402 without a motor: its states, its ramps, its PDOs, its emergencies."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any, Final

from esair.buses import Frame
from esair.buses.can import FakeCan
from esair.drivers.canopen import drive as profile
from esair.drivers.canopen.drive import State
from esair.drivers.canopen.fake import FakeCanopenNode

STEP: Final = 0.005
"""How often it moves on, in seconds."""

_SHUT_DOWN, _SWITCH_ON, _ENABLE = 0x06, 0x07, 0x0F


class FakeDrive(FakeCanopenNode):
    """A node that obeys as a drive does: no way past a state, no motion without power.

    Its units are those of the wire: increments, and increments per second.

    Args:
        can: The bus that it is on.
        node: Its id.
        eds: Its EDS file; the objects of the standard if None.

    Attributes:
        drive_state: Where it is in the state machine.
        velocity: What its shaft does.
        position: Where its shaft is.
        moves: The positions that it took as new set-points.
        syncs: How many SYNCs it heard.
    """

    position: float

    velocity: float

    def __init__(
        self, can: FakeCan, *, node: int = 5, eds: Path | str | None = None
    ) -> None:
        self.drive_state: State = State.DISABLED
        self.velocity = self.position = 0.0
        self.moves: list[int] = []
        self.syncs: int = 0
        self._word = 0
        self._goal: float | None = None
        self._held: dict[int, bytes] = {}
        self._due: dict[int, float] = {}
        self._moving: asyncio.TimerHandle | None = None
        super().__init__(can, profile.standard(node) if eds is None else eds, node=node)

    def boot(self) -> None:
        """Start anew: no power for the motor, no PDO before it is started."""
        self._become(State.DISABLED)
        self.velocity, self._word, self._goal = 0.0, 0, None
        super().boot()
        if self._moving is not None:
            self._moving.cancel()
        self._loop = asyncio.get_running_loop()
        self._moving = self._loop.call_later(STEP, self._step)

    def stop(self) -> None:
        """Fall silent, as without power."""
        super().stop()
        if self._moving is not None:
            self._moving.cancel()

    def fault(self, code: int, *, clears: bool = True) -> None:
        """Have an error: tell it, and take the power from the motor.

        Args:
            code: The code of the error.
            clears: Whether a reset ends it.
        """
        self._clears = clears
        self._put(profile.ERROR_CODE, code)
        self.emergency(code)
        self._become(State.FAULT)

    def receive(self, frame: Frame) -> None:
        """Take a frame from the bus."""
        super().receive(frame)
        if not self._on or frame.extended or self.state != "OPERATIONAL":
            return
        if frame.id == 0x80:
            self.syncs += 1
            for number in tuple(self._held):
                self._apply(number, self._held.pop(number))
            for number in range(4):
                if self._pdo(0x1800 + number)[1] == 1:
                    self._tell(number)
            return
        for number in range(4):
            cob_id, kind = self._pdo(0x1400 + number)
            if cob_id == frame.id:
                self._held[number] = frame.data
                if kind >= 254:
                    self._apply(number, self._held.pop(number))

    def _pdo(self, index: int) -> tuple[int | None, int]:
        cob_id = self._get(index, 1)
        return None if cob_id >> 31 else cob_id & 0x7FF, self._get(index, 2)

    def _mapped(self, index: int) -> list[tuple[int, int, int]]:
        entries = (self._get(index, n + 1) for n in range(self._get(index, 0)))
        return [(each >> 16, each >> 8 & 0xFF, (each & 0xFF) // 8) for each in entries]

    def _apply(self, number: int, data: bytes) -> None:
        word = None
        for index, sub, size in self._mapped(0x1600 + number):
            value, data = data[:size], data[size:]
            if index == profile.CONTROLWORD:
                word = value
            self.local.data_store.setdefault(index, {})[sub] = value
        if word is not None:
            self._obey(int.from_bytes(word, "little"))

    def _tell(self, number: int) -> None:
        cob_id, _ = self._pdo(0x1800 + number)
        if cob_id is None or self.state != "OPERATIONAL" or not self._on:
            return
        data = b"".join(
            self.local.get_data(index, sub)
            for index, sub, _ in self._mapped(0x1A00 + number)
        )
        self._network.send_message(cob_id, data)

    def _write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        super()._write(index, subindex, od, data)
        if index == profile.CONTROLWORD:
            self._obey(int.from_bytes(data, "little"))

    def _obey(self, word: int) -> None:
        before, self._word = self._word, word
        state = self.drive_state
        on = word & 0x0F
        if state is State.NOT_READY:
            return
        if state is State.FAULT:
            if word & ~before & profile.RESET and self._clears:
                self._put(profile.ERROR_CODE, 0)
                self.emergency(0)
                self._become(State.DISABLED)
        elif state is State.QUICK_STOP:
            if not word & 0x02:
                self._become(State.DISABLED)
        elif not word & 0x02:
            self._become(State.DISABLED)
        elif not word & 0x04:
            enabled = state is State.ENABLED
            self._become(State.QUICK_STOP if enabled else State.DISABLED)
        elif on & 0x07 == _SHUT_DOWN:
            self._become(State.READY)
        elif on == _SWITCH_ON and state in {State.READY, State.ENABLED}:
            self._become(State.SWITCHED_ON)
        elif on == _ENABLE and state is State.SWITCHED_ON:
            self._become(State.ENABLED)
            self._goal = None
        elif on == _ENABLE and state is State.ENABLED:
            self._take_set_point(word & ~before)

    def _take_set_point(self, risen: int) -> None:
        if risen & profile.NEW_SET_POINT:
            self._goal = float(self._signed(profile.TARGET_POSITION))
            self.moves.append(int(self._goal))
        self._become(State.ENABLED)

    def _become(self, state: State) -> None:
        self.drive_state = state
        if not hasattr(self, "local"):  # it is being made
            return
        before = self._get(profile.STATUSWORD)
        status = profile.STATUS[state][1] | 0x0210
        goes = self._get(profile.MODE) == profile.PROFILE_POSITION
        if goes and state is State.ENABLED and self._word & profile.NEW_SET_POINT:
            status |= profile.ACKNOWLEDGED
        self._put(profile.STATUSWORD, status)
        if status != before and self._pdo(0x1800)[1] >= 254:
            self._tell(0)

    def _step(self) -> None:
        """Move on by the ramps of the drive."""
        self._moving = self._loop.call_later(STEP, self._step)
        wanted, ramp = 0.0, float("inf")  # without power it stands: it has a brake
        if self.drive_state is State.QUICK_STOP:
            ramp = self._get(0x6085)
            if not self.velocity:
                self._become(State.DISABLED)
        elif self.drive_state is State.ENABLED:
            ramp = self._get(0x6083)
            if not self._word & profile.HALT:
                wanted = self._wanted()
        change = wanted - self.velocity
        self.velocity += max(-ramp * STEP, min(ramp * STEP, change))
        self.position += self.velocity * STEP
        self._put(profile.POSITION, round(self.position))
        self._put(profile.VELOCITY, round(self.velocity))
        for number in range(2):
            timer = self._get(0x1800 + number, 5) / 1000
            if timer and self._pdo(0x1800 + number)[1] >= 254:
                now = self._loop.time()
                if now >= self._due.get(number, 0.0) - 1e-9:
                    self._due[number] = now + timer
                    self._tell(number)

    def _wanted(self) -> float:
        if self._get(profile.MODE) == profile.PROFILE_VELOCITY:
            return float(self._signed(profile.TARGET_VELOCITY))
        if self._goal is None:
            return 0.0
        left = self._goal - self.position
        fastest = min(
            self._get(0x6081),
            math.sqrt(self._get(0x6084) * abs(left)),
            abs(left) / STEP,
        )
        return math.copysign(fastest, left)

    def _get(self, index: int, subindex: int = 0) -> int:
        return int.from_bytes(self.local.get_data(index, subindex), "little")

    def _signed(self, index: int) -> int:
        return int.from_bytes(self.local.get_data(index, 0), "little", signed=True)

    def _put(self, index: int, value: int) -> None:
        size = len(self.local.get_data(index, 0))
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        self.local.data_store.setdefault(index, {})[0] = data
