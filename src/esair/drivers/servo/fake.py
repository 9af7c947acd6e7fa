"""Dynamixel servos that answer packets of protocol 2.0, in memory or on any line."""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Iterable, Mapping
from typing import Protocol

from dynamixel_sdk import Protocol2PacketHandler  # type: ignore[import-untyped]

from esair.drivers.servo import (
    CENTER,
    GOAL_POSITION,
    HARDWARE_ERROR,
    OPERATING_MODE,
    PRESENT_POSITION,
    TORQUE_ENABLE,
    ServoLink,
)
from esair.loop import now, sleep_in_thread

PING, READ, WRITE, STATUS = 0x01, 0x02, 0x03, 0x55
SYNC_READ, SYNC_WRITE = 0x82, 0x83
HEADER = b"\xff\xff\xfd\x00"

ALERT = 0x80
"""The bit of an answer that says that the servo has shut down."""

ACCESS_ERROR = 7
"""What a servo answers to a request beyond its control table."""

TABLE_SIZE = 252

MAP, MAPPED = 168, 224
"""Where the table has 28 addresses, and where it has what is at them."""

_crc = Protocol2PacketHandler().updateCRC


def packet(servo: int, instruction: int, parameters: bytes) -> bytes:
    """Return a packet: header, id, length, instruction, parameters, checksum."""
    body = bytes([instruction]) + parameters
    body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = HEADER + struct.pack("<BH", servo, len(body) + 2)
    return head + body + struct.pack("<H", _crc(0, head + body, len(head + body)))


class FakeServo:
    """One servo: a control table, and a shaft that is at its goal at once.

    Attributes:
        model: The model number; 1060 is an XL430-W250.
        table: The control table, as bytes.
        shut_down: The bits of its hardware error; 0 while it works.
    """

    def __init__(self, *, model: int = 1060, steps: int = CENTER) -> None:
        self.model = model
        self._start(mode=3, steps=steps)

    def power_cycle(self) -> None:
        """Lose the power for a moment: it stays where it is, without torque."""
        self._start(mode=self.table[OPERATING_MODE], steps=self.get(PRESENT_POSITION))

    def _start(self, mode: int, steps: int) -> None:
        self.table: bytearray = bytearray(TABLE_SIZE)
        self.table[OPERATING_MODE] = mode
        for place in range(28):
            self.table[MAP + 2 * place] = MAPPED + place
        self.shut_down = 0
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
        if address < MAPPED:
            return address
        place = MAP + 2 * (address - MAPPED)
        return int.from_bytes(self.table[place : place + 2], "little") % TABLE_SIZE

    def obey(self, instruction: int, parameters: bytes) -> bytes:
        """Return what stands in the answer: the error, and what was asked for."""
        self.table[HARDWARE_ERROR] = self.shut_down
        error = ALERT if self.shut_down else 0
        if instruction == PING:
            return struct.pack("<BHB", error, self.model, 45)
        address = int.from_bytes(parameters[:2], "little")
        if instruction == READ:
            size = int.from_bytes(parameters[2:4], "little")
            if address + size > TABLE_SIZE:
                return bytes([error | ACCESS_ERROR])
            told = (self.table[self._at(address + n)] for n in range(size))
            return bytes([error, *told])
        if instruction != WRITE or address + len(parameters) - 2 > TABLE_SIZE:
            return bytes([error | ACCESS_ERROR])
        if address == OPERATING_MODE and self.torque:
            return bytes([error | ACCESS_ERROR])
        for n, byte in enumerate(parameters[2:]):
            self.table[self._at(address + n)] = byte
        if self.torque and not self.shut_down and self.table[OPERATING_MODE] == 3:
            self.put(PRESENT_POSITION, self.get(GOAL_POSITION))
        return bytes([error])


class _Obeying(Protocol):
    """A servo of any make; who returns nothing from ``obey`` is silent."""

    def power_cycle(self) -> None: ...
    def obey(self, instruction: int, parameters: bytes) -> bytes: ...


class FakeServos:
    """Servos on one line; ``open`` is the opener of a `ServoBus`.

    Args:
        servos: Them, by id.

    Attributes:
        servos: Them, by id; take one out and it is silent.
        written: The packets that came for them: id, instruction, parameters.
        delay: How long each turn of the wire takes, in seconds: 0.016 is the latency
            that a USB adapter of FTDI comes with.
        turns: How often the wire was turned, from asking to answering.
    """

    _header = HEADER
    _word = 2  # the bytes of a length, an address and a size
    _in_turn = True

    def __init__(self, servos: dict[int, FakeServo] | Iterable[int] = (1,)) -> None:
        self.servos: dict[int, FakeServo] = (
            servos
            if isinstance(servos, dict)
            else {number: FakeServo() for number in servos}
        )
        self._there: Mapping[int, _Obeying] = self.servos
        self.written: list[tuple[int, int, bytes]] = []
        self.plugged: bool = True
        self.delay: float = 0.0
        self.turns = 0
        self._garble = 0
        self._stalled = False
        self._rest = b""

    def unplug(self) -> None:
        """Be gone, from this moment on."""
        self.plugged = False

    def plug(self) -> None:
        """Be there again."""
        self.plugged = True

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

    def open(self) -> ServoLink:
        """Open the robot's end.

        Raises:
            OSError: They are unplugged.
        """
        self.check()
        self._rest = b""
        return _MemoryLink(self)

    def check(self) -> None:
        """Raise what the kernel says about a line that is gone."""
        if not self.plugged:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def heard(self, data: bytes) -> bytes:
        """Take bytes from the line; return the answers of the servos."""
        data, answers = self._rest + data, b""
        header, size_at = self._header, len(self._header) + 1
        head = size_at + self._word
        while (begin := data.find(header)) >= 0 and len(data) >= begin + head:
            size = int.from_bytes(data[begin + size_at : begin + head], "little")
            end = begin + head + size
            if len(data) < end:
                break
            request, data = self._opened(data[begin:end]), data[end:]
            if request is not None:
                self.written.append(request)
                answers += b"" if self._stalled else self._reply(*request)
        self._rest = data[-1024:]
        return answers

    def _opened(self, request: bytes) -> tuple[int, int, bytes] | None:
        """Return id, instruction and parameters of a packet, if it is not damaged."""
        if _crc(0, request, len(request) - 2) != int.from_bytes(request[-2:], "little"):
            return None
        plain = request[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        return request[4], request[7], plain

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
        answer = self._packed(number, told) if told else b""
        if answer and self._garble:
            self._garble -= 1
            answer = answer[:-1] + bytes([answer[-1] ^ 0x55])
        return answer

    def _packed(self, number: int, told: bytes) -> bytes:
        return packet(number, STATUS, told)


class _MemoryLink:
    """The robot's end, for the thread of the bus."""

    def __init__(self, servos: FakeServos) -> None:
        self._servos = servos
        self._answers = b""
        self._late = 0.0

    def write(self, data: bytes, seconds: float) -> None:
        self._servos.check()
        answers = self._servos.heard(data)
        if answers:
            self._servos.turns += 1
            self._late = now() + self._servos.delay
        self._answers += answers

    def read(self, size: int, seconds: float) -> bytes:
        self._servos.check()
        early = self._late - now()
        if not self._answers or early > 0:
            sleep_in_thread(min(seconds, early) if self._answers else seconds)
        if now() < self._late:
            return b""
        data, self._answers = self._answers[:size], self._answers[size:]
        return data

    def discard(self) -> None:
        if now() >= self._late:
            self._answers = b""

    def close(self) -> None:
        """Have nothing to let go."""
