"""Servos of Feetech that answer their packets, in memory."""

from __future__ import annotations

from collections.abc import Iterable

from esair.drivers.servo._bus import FEETECH, FEETECH_STS, PING, READ, WRITE
from esair.drivers.servo.fake import FakeServos

TABLE_SIZE = 71


class FakeFeetechServo:
    """One servo, whose shaft is at its goal at once.

    Attributes:
        table: Its memory table, as bytes.
        faults: The bits of what is wrong with it, which each answer tells.
    """

    def __init__(self, *, steps: int = 2048) -> None:
        self.table: bytearray = bytearray(TABLE_SIZE)
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

    def obey(self, instruction: int, parameters: bytes) -> bytes:
        """Return what stands in the answer: the faults, and what was asked for."""
        told = b""
        if instruction == READ:
            address, size = parameters
            told = bytes(self.table[address : address + size])
        elif instruction == WRITE:
            self._write(parameters[0], parameters[1:])
        elif instruction != PING:
            return b""
        return bytes([self.faults]) + told

    def _write(self, address: int, data: bytes) -> None:
        if address == FEETECH_STS.mode and self.table[55]:
            return  # it is locked
        self.table[address : address + len(data)] = data
        if self.torque and self.table[FEETECH_STS.mode] == 0:
            goal = self.get(FEETECH_STS.goal.address)
            place = FEETECH_STS.limits.address
            least, most = self.get(place), self.get(place + 2)
            if least or most:
                goal = min(max(least, goal), most)
            self.put(FEETECH_STS.position.address, goal)


class FakeFeetechServos(FakeServos):
    """Servos on one line, which is the ``wire`` of a `FeetechBus`."""

    feetech: dict[int, FakeFeetechServo]

    _packets = FEETECH
    _mark = b""
    _word = 1
    _in_turn = False

    def __init__(self, servos: Iterable[int] = (1,)) -> None:
        super().__init__(())
        self._there = self.feetech = {number: FakeFeetechServo() for number in servos}
