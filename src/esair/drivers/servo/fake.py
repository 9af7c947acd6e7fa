"""Dynamixel servos that answer packets of protocol 2.0, in memory or on any line."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Iterable, Mapping
from typing import Any

from esair.buses import Bus, Wire
from esair.buses.serial import MemoryLine
from esair.drivers.servo import (
    CENTER,
    GOAL_CURRENT,
    GOAL_POSITION,
    GOAL_VELOCITY,
    HARDWARE_ERROR,
    OPERATING_MODE,
    PRESENT_POSITION,
    TORQUE_ENABLE,
)
from esair.drivers.servo._bus import (
    DYNAMIXEL_X,
    PING,
    READ,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    X330,
    Packets,
)
from esair.framing import Framing

ALERT = 0x80
"""The bit of an answer that says that the servo has shut down."""

ACCESS_ERROR = 7
"""What a servo answers to a request beyond its control table."""

LIMIT_ERROR = 6
"""What it answers to a goal beyond its limits, which it does not take."""

STRONGEST, FASTEST, GREATEST, LEAST = 38, 44, 48, 52
"""Where the table has them."""

MAP = 168
"""Where the table has addresses; what is at them follows behind."""


def packet(servo: int, instruction: int, parameters: bytes) -> bytes:
    """Return a packet: header, id, length, instruction, parameters, checksum."""
    return Packets().encode(bytes([servo, instruction]) + parameters)


class FakeServo:
    """One servo: a control table, and a shaft that is at its goal at once.

    Attributes:
        model: The model number; 1060 is an XL430-W250, 1200 an XL330-M288.
        table: The control table, as bytes.
        shut_down: The bits of its hardware error; 0 while it works.
    """

    def __init__(self, *, model: int = 1060, steps: int = CENTER) -> None:
        self.model = model
        self._mapped = X330.get(model, DYNAMIXEL_X.look).address
        self._size = self._mapped + (self._mapped - MAP) // 2
        self._start(mode=3, steps=steps)

    def power_cycle(self) -> None:
        """Lose the power for a moment: it stays where it is, without torque."""
        self._start(mode=self.table[OPERATING_MODE], steps=self.get(PRESENT_POSITION))

    def _start(self, mode: int, steps: int) -> None:
        self.table: bytearray = bytearray(self._size)
        self.table[OPERATING_MODE] = mode
        for place in range(self._size - self._mapped):
            self.table[MAP + 2 * place] = self._mapped + place
        self.shut_down = 0
        self.put(STRONGEST, 2047)
        self.put(FASTEST, 265)
        self.put(GREATEST, 4095)
        self.put(GOAL_POSITION, steps)
        self.put(PRESENT_POSITION, steps)

    @property
    def torque(self) -> bool:
        """Whether it holds its goal."""
        return bool(self.table[TORQUE_ENABLE])

    def get(self, address: int) -> int:
        """Return an entry of four bytes, signed."""
        return int.from_bytes(self.table[address : address + 4], "little", signed=True)

    def put(self, address: int, value: int) -> None:
        """Change an entry of four bytes."""
        self.table[address : address + 4] = value.to_bytes(4, "little", signed=True)

    def _at(self, address: int) -> int:
        """Return where a byte really is, which is another place if it is mapped."""
        if address < self._mapped:
            return address
        place = MAP + 2 * (address - self._mapped)
        return int.from_bytes(self.table[place : place + 2], "little") % self._size

    def _takes(self, address: int) -> tuple[float, float]:
        if address == GOAL_POSITION and self.table[OPERATING_MODE] == 3:
            return self.get(LEAST), self.get(GREATEST)
        limits = {GOAL_VELOCITY: self.get(FASTEST), GOAL_CURRENT: self.get(STRONGEST)}
        most = limits.get(address, math.inf)
        return -most, most

    def obey(self, instruction: int, parameters: bytes) -> bytes:
        """Return what stands in the answer: the error, and what was asked for."""
        self.table[HARDWARE_ERROR] = self.shut_down
        error = ALERT if self.shut_down else 0
        if instruction == PING:
            return struct.pack("<BHB", error, self.model, 45)
        address = int.from_bytes(parameters[:2], "little")
        if instruction == READ:
            size = int.from_bytes(parameters[2:4], "little")
            if address + size > self._size:
                return bytes([error | ACCESS_ERROR])
            told = (self.table[self._at(address + n)] for n in range(size))
            return bytes([error, *told])
        if instruction != WRITE or address + len(parameters) - 2 > self._size:
            return bytes([error | ACCESS_ERROR])
        if address == OPERATING_MODE and self.torque:
            return bytes([error | ACCESS_ERROR])
        in_turn = self.table[OPERATING_MODE] == 3
        least, most = self._takes(address)
        if not least <= int.from_bytes(parameters[2:], "little", signed=True) <= most:
            return bytes([error | LIMIT_ERROR])
        if address == TORQUE_ENABLE and in_turn and not self.torque:
            self.put(PRESENT_POSITION, self.get(PRESENT_POSITION) % 4096)
        for n, byte in enumerate(parameters[2:]):
            self.table[self._at(address + n)] = byte
        if self.torque and not self.shut_down and self.table[OPERATING_MODE] == 3:
            self.put(PRESENT_POSITION, self.get(GOAL_POSITION))
        return bytes([error])


class FakeServos(Wire):
    """Servos on one line, which is the ``wire`` of a `ServoBus`.

    Args:
        servos: Them, by id.

    Attributes:
        servos: Them, by id; take one out and it is silent.
        written: The packets that came for them: id, instruction, parameters.
        delay: How long each turn of the wire takes, in seconds: 0.016 is the latency
            that a USB adapter of FTDI comes with.
        turns: How often the wire was turned, from asking to answering.
    """

    _packets: Framing = Packets()
    _mark = bytes([STATUS])
    _word = 2  # the bytes of an address and a size
    _in_turn = True

    def __init__(self, servos: dict[int, FakeServo] | Iterable[int] = (1,)) -> None:
        super().__init__()
        self.servos: dict[int, FakeServo] = (
            servos
            if isinstance(servos, dict)
            else {number: FakeServo() for number in servos}
        )
        self._there: Mapping[int, Any] = self.servos  # or those of another make
        self.written: list[tuple[int, int, bytes]] = []
        self.plugged: bool = True
        self.delay: float = 0.0
        self.turns: int = 0
        self._garble = 0
        self._stalled = False
        self._framing = self._packets.fresh()
        self._line: MemoryLine | None = None

    def unplug(self) -> None:
        """Be gone, from this moment on."""
        self.plugged = False
        if self._line is not None:
            self._line.unplug()

    def plug(self) -> None:
        """Be there again."""
        self.plugged = True
        if self._line is not None:
            self._line.plug()

    def power_cycle(self) -> None:
        """Lose the power for a moment, all of them."""
        for servo in self._there.values():
            servo.power_cycle()

    def stall(self) -> None:
        """Answer nothing until `resume`."""
        self._stalled = True

    def resume(self) -> None:
        """Answer again."""
        self._stalled = False

    def garble(self, count: int = 1) -> None:
        """Damage the next answers on their way."""
        self._garble = count

    async def join(self, bus: Bus) -> MemoryLine:
        """Return the line, as it is opened now."""
        self._framing.reset()
        self._line = line = MemoryLine(bus.name)
        line.heard = self._answer
        if self.plugged:
            line.plug()
        return line

    def _answer(self, data: bytes) -> None:
        answers, line = self.heard(data), self._line
        if answers and line is not None:
            self.turns += 1
            loop = asyncio.get_running_loop()
            loop.call_later(self.delay, line.write, answers)

    def heard(self, data: bytes) -> bytes:
        """Take bytes from the line; return the answers of the servos."""
        answers = b""
        for number, instruction, *parameters in self._framing.feed(data):
            request = number, instruction, bytes(parameters)
            self.written.append(request)
            answers += b"" if self._stalled else self._reply(*request)
        return answers

    def _reply(self, number: int, instruction: int, parameters: bytes) -> bytes:
        two = 2 * self._word
        entry, rest = parameters[:two], parameters[two:]
        if instruction == SYNC_WRITE:
            size = 1 + int.from_bytes(entry[self._word :], "little")
            for begin in range(0, len(rest), size):
                one, *data = rest[begin : begin + size]
                if one in self._there:
                    self._there[one].obey(WRITE, entry[: self._word] + bytes(data))
            return b""
        if instruction != SYNC_READ:
            return self._status(number, instruction, parameters)
        answers = b""
        for one in rest:
            if self._in_turn and one not in self._there:
                break  # those after it wait for its answer
            answers += self._status(one, READ, entry)
        return answers

    def _status(self, number: int, instruction: int, parameters: bytes) -> bytes:
        if number not in self._there:
            return b""
        told = self._there[number].obey(instruction, parameters)
        if not told:
            return b""
        answer = self._framing.encode(bytes([number]) + self._mark + told)
        if self._garble:
            self._garble -= 1
            answer = answer[:-1] + bytes([answer[-1] ^ 0x55])
        return answer
