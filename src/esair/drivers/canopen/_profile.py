"""CiA 402: the states of a drive, the words that lead through them, its objects."""

from __future__ import annotations

import enum
import functools
from typing import Final

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

CONTROLWORD, STATUSWORD, ERROR_CODE = 0x6040, 0x6041, 0x603F
MODE, POSITION, VELOCITY = 0x6060, 0x6064, 0x606C
TARGET_POSITION, TARGET_VELOCITY = 0x607A, 0x60FF

PROFILE_POSITION, PROFILE_VELOCITY = 1, 3
"""The modes of operation that are used here."""

DISABLE, QUICK_STOP, SHUT_DOWN, SWITCH_ON, ENABLE = 0x00, 0x02, 0x06, 0x07, 0x0F
NEW_SET_POINT, AT_ONCE, RESET, HALT = 0x10, 0x20, 0x80, 0x100
"""Bits of the controlword that are no state."""


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
