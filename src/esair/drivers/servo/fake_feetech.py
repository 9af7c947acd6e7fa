"""Servos of Feetech that answer their packets, in memory."""

from __future__ import annotations

from collections.abc import Iterable

from esair.drivers.servo._tables import FEETECH_STS
from esair.drivers.servo.fake import (
    PING,
    READ,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    FakeServos,
)

TABLE_SIZE = 71


def packet(servo: int, head: int, parameters: bytes) -> bytes:
    """Return a packet: header, id, length, instruction or error, parameters, checksum."""
    body = bytes([servo, len(parameters) + 2, head]) + parameters
    return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])


class FakeFeetechServo:
    """One servo, whose shaft is at its goal at once.

    Attributes:
        table: Its memory table, as bytes.
        faults: The bits of what is wrong with it, which each answer tells.
    """

    def __init__(self, *, steps: int = 2048) -> None:
        self.table = bytearray(TABLE_SIZE)
        self.table[3:5] = (777).to_bytes(2, "little")
        self.faults = 0
        for entry in (FEETECH_STS.goal, FEETECH_STS.position):
            self.put(entry.address, steps)
        self.table[55] = 1

    @property
    def torque(self) -> bool:
        """Whether it holds its goal."""
        return bool(self.table[FEETECH_STS.torque])

    def power_cycle(self) -> None:
        """Lose the power for a moment: it stays where it is, without torque."""
        self.table[FEETECH_STS.torque] = 0
        self.put(FEETECH_STS.velocity.address, 0)

    def get(self, address: int) -> int:
        """Return an entry of two bytes, as it is."""
        return int.from_bytes(self.table[address : address + 2], "little")

    def put(self, address: int, value: int) -> None:
        """Change an entry of two bytes."""
        self.table[address : address + 2] = value.to_bytes(2, "little")

    def write(self, address: int, data: bytes) -> None:
        """Be told something."""
        if address == FEETECH_STS.mode and self.table[55]:
            return  # it is locked
        self.table[address : address + len(data)] = data
        if self.torque and self.table[FEETECH_STS.mode] == 0:
            self.put(FEETECH_STS.position.address, self.get(FEETECH_STS.goal.address))


class FakeFeetechServos(FakeServos):
    """Servos on one line; ``open`` is the opener of a `FeetechBus`."""

    def __init__(self, servos: Iterable[int] = (1,)) -> None:
        super().__init__(())
        self.feetech = {number: FakeFeetechServo() for number in servos}

    def power_cycle(self) -> None:
        """Lose the power for a moment, all of them."""
        for servo in self.feetech.values():
            servo.power_cycle()

    def heard(self, data: bytes) -> bytes:
        """Take bytes from the line; return the answers of the servos."""
        data, answers = self._rest + data, b""
        while (begin := data.find(b"\xff\xff")) >= 0 and len(data) >= begin + 4:
            end = begin + 4 + data[begin + 3]
            if len(data) < end:
                break
            body = data[begin + 2 : end]
            data = data[end:]
            if ~sum(body[:-1]) & 0xFF == body[-1]:
                self.written.append((body[0], body[2], body[3:-1]))
                answers += self._reply(body[0], body[2], body[3:-1])
        self._rest = data[-1024:]
        return answers

    def _reply(self, number: int, instruction: int, parameters: bytes) -> bytes:
        if self._stalled:
            return b""
        if instruction == SYNC_WRITE:
            address, size = parameters[:2]
            for at in range(2, len(parameters), size + 1):
                one, *told = parameters[at : at + size + 1]
                if one in self.feetech:
                    self.feetech[one].write(address, bytes(told))
            return b""
        if instruction == SYNC_READ:
            address, size = parameters[:2]
            asked = [one for one in parameters[2:] if one in self.feetech]
            return b"".join(self._say(one, address, size) for one in asked)
        servo = self.feetech.get(number)
        if servo is None:
            return b""
        if instruction == READ:
            return self._say(number, parameters[0], parameters[1])
        if instruction == WRITE:
            servo.write(parameters[0], parameters[1:])
        elif instruction != PING:
            return b""
        return packet(number, servo.faults, b"")

    def _say(self, number: int, address: int, size: int) -> bytes:
        servo = self.feetech[number]
        return packet(
            number, servo.faults, bytes(servo.table[address : address + size])
        )
