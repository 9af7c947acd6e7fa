"""Where servos keep what they are told, by their makers."""

from __future__ import annotations

import math
from typing import Final, NamedTuple


class Entry(NamedTuple):
    """A number in a servo's control table.

    Attributes:
        address: Its first byte.
        size: How many bytes it has.
        has_sign_bit: Whether its highest bit is its sign; else it is a two's complement.
    """

    address: int
    size: int
    has_sign_bit: bool = False

    def pack(self, number: int) -> int:
        """Return a number as the table has it."""
        bits = 8 * self.size
        if not self.has_sign_bit:
            return number & (1 << bits) - 1
        if abs(number) >> (bits - 1):
            raise OverflowError(f"{number} has more than {bits - 1} bits")
        return abs(number) | (number < 0) << (bits - 1)

    def unpack(self, raw: int) -> int:
        """Return the number that the table has."""
        sign = 1 << (8 * self.size - 1)
        if self.has_sign_bit:
            return -(raw & ~sign) if raw & sign else raw
        return raw - 2 * sign if raw & sign else raw


class Snapshot(NamedTuple):
    """What one answer of a servo tells: where it is, and whether it has restarted.

    Attributes:
        has_torque: Whether it holds its goal.
        is_lit: Whether its light is lit, which a restart puts out; True if it has none.
        position: Where it is, in steps.
        speed: How fast it goes to its goal, in units of its table.
    """

    has_torque: bool
    is_lit: bool
    position: int
    speed: int


class Table(NamedTuple):
    """The entries of a servo's control table that are used here.

    Attributes:
        torque: Whether it holds its goal.
        mode: Its mode of operation.
        modes: The values of that for a current, a velocity and a position; None if it
            has no such mode.
        goal: Where it goes.
        position: Where it is.
        velocity: How fast it turns in velocity mode.
        speed: How fast it goes to its goal.
        velocity_unit: The unit of both in rad/s.
        no_limit: The speed that is none.
        current: How hard it pushes in current mode; None if it has no such mode.
        current_unit: The unit of that in A, unless its model has another.
        errors: The bits of why it has shut down.
        look: What is read for a `Snapshot`: its entries, as they are in one block.
        mapped: Where the addresses of the bytes of that block are put; None if they are
            there by themselves.
        light: Its light, which a restart puts out; None if it has none.
        lock: What keeps its mode from being changed; None if nothing does.
    """

    torque: int
    mode: int
    modes: tuple[int | None, int, int]
    goal: Entry
    position: Entry
    velocity: Entry
    speed: Entry
    velocity_unit: float
    errors: int
    look: Entry
    no_limit: int = 0
    current: Entry | None = None
    current_unit: float = 0.0
    mapped: int | None = None
    light: int | None = None
    lock: int | None = None

    @property
    def places(self) -> list[int]:
        """The addresses of the bytes of the block."""
        if self.mapped is None:
            return [*range(self.look.address, self.look.address + self.look.size)]
        assert self.light is not None
        entries = (
            Entry(self.torque, 1),
            Entry(self.light, 1),
            self.position,
            self.speed,
        )
        return [each.address + n for each in entries for n in range(each.size)]

    def snapshot(self, block: int) -> Snapshot:
        """Return what a block tells."""
        places = self.places
        data = block.to_bytes(self.look.size, "little")

        def number(entry: Entry) -> int:
            at = places.index(entry.address)
            raw = int.from_bytes(data[at : at + entry.size], "little")
            return entry.unpack(raw)

        return Snapshot(
            has_torque=bool(number(Entry(self.torque, 1))),
            is_lit=self.light is None or bool(number(Entry(self.light, 1))),
            position=number(self.position),
            speed=number(self.speed),
        )


DYNAMIXEL_X: Final = Table(
    torque=64,
    mode=11,
    modes=(0, 1, 3),
    goal=Entry(116, 4),
    position=Entry(132, 4),
    velocity=Entry(104, 4),
    speed=Entry(112, 4),
    velocity_unit=0.229 * math.tau / 60,
    errors=70,
    look=Entry(224, 10),
    current=Entry(102, 2),
    current_unit=0.00269,
    mapped=168,
    light=65,
)
"""The X series of ROBOTIS: the control table of the XL430-W250."""

FEETECH_STS: Final = Table(
    torque=40,
    mode=33,
    modes=(None, 1, 0),
    goal=Entry(42, 2, has_sign_bit=True),
    position=Entry(56, 2, has_sign_bit=True),
    velocity=Entry(46, 2, has_sign_bit=True),
    speed=Entry(46, 2, has_sign_bit=True),
    velocity_unit=math.tau / 4096,
    errors=65,
    look=Entry(40, 18),
    lock=55,
)
"""The STS and SMS series of Feetech: the memory table of the STS3215."""

FEETECH_HLS: Final = FEETECH_STS._replace(
    modes=(2, 1, 0),
    velocity_unit=0.732 * math.tau / 60,
    no_limit=0x7FFF,
    current=Entry(44, 2, has_sign_bit=True),
    current_unit=0.0065,
)
"""The HLS series of Feetech, which has a current mode; a speed of 0 stops it."""
