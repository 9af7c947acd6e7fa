"""What a CAN controller says about itself: error frames, and the states it is in.

Source: ``linux/can/error.h`` and ``linux/can/netlink.h`` of the kernel.
"""

from __future__ import annotations

import enum
from typing import Final, NamedTuple


class CanState(enum.IntEnum):
    """How a controller stands on its bus, by its error counters; the worse the higher.

    A controller that made too many errors may only listen and wait (passive), then
    takes itself off the bus (bus-off). The numbers are the kernel's.
    """

    ACTIVE = 0
    """Fewer than 96 errors: it takes part as it should."""

    WARNING = 1
    """96 errors or more."""

    PASSIVE = 2
    """128 errors or more: it no longer disturbs the bus to report an error."""

    BUS_OFF = 3
    """256 errors in sending: it takes no part until somebody starts it again."""


class ErrorFrame(NamedTuple):
    """What an error frame says.

    Attributes:
        state: The state that the controller has entered; None if it tells none.
        unacknowledged: Whether a frame was sent and no other node acknowledged it.
        overflow: Whether the controller lost a frame that came.
        restarted: Whether the controller was bus-off and has started again.
        text: All of it in words.
    """

    state: CanState | None
    unacknowledged: bool
    overflow: bool
    restarted: bool
    text: str


TX_TIMEOUT: Final = 0x001
LOST_ARBITRATION: Final = 0x002
CONTROLLER: Final = 0x004
PROTOCOL: Final = 0x008
TRANSCEIVER: Final = 0x010
NO_ACKNOWLEDGE: Final = 0x020
BUS_OFF: Final = 0x040
BUS_ERROR: Final = 0x080
RESTARTED: Final = 0x100
COUNTERS: Final = 0x200

CONTROLLER_BITS: Final[dict[CanState, int]] = {
    CanState.WARNING: 0x08,
    CanState.PASSIVE: 0x20,
    CanState.ACTIVE: 0x40,
}
"""The bit in byte 1 by which a controller says that sending took it to a state."""

_STATES: Final = (
    (0x30, CanState.PASSIVE),
    (0x0C, CanState.WARNING),
    (0x40, CanState.ACTIVE),
)
_CONTROLLER: Final = {
    0x01: "receive buffer overflow",
    0x02: "send buffer overflow",
    0x04: "warning: many errors in receiving",
    0x08: "warning: many errors in sending",
    0x10: "error-passive in receiving",
    0x20: "error-passive in sending",
    0x40: "error-active again",
}
_PROTOCOL: Final = {
    0x01: "single bit error",
    0x02: "frame format error",
    0x04: "bit stuffing error",
    0x08: "unable to send a dominant bit",
    0x10: "unable to send a recessive bit",
    0x20: "overload",
    0x40: "active error announcement",
    0x80: "in sending",
}
_LOCATION: Final = {
    0x03: "start of frame", 0x02: "ID bits 28-21", 0x06: "ID bits 20-18",
    0x04: "substitute RTR", 0x05: "identifier extension", 0x07: "ID bits 17-13",
    0x0F: "ID bits 12-5", 0x0E: "ID bits 4-0", 0x0C: "RTR", 0x0D: "reserved bit 1",
    0x09: "reserved bit 0", 0x0B: "data length code", 0x0A: "data section",
    0x08: "CRC sequence", 0x18: "CRC delimiter", 0x19: "ACK slot",
    0x1B: "ACK delimiter", 0x1A: "end of frame", 0x12: "intermission",
}  # fmt: skip
_TRANSCEIVER: Final = {
    0x04: "CANH has no wire", 0x05: "CANH shorted to battery",
    0x06: "CANH shorted to VCC", 0x07: "CANH shorted to ground",
    0x40: "CANL has no wire", 0x50: "CANL shorted to battery",
    0x60: "CANL shorted to VCC", 0x70: "CANL shorted to ground",
    0x80: "CANL shorted to CANH",
}  # fmt: skip


def decode_error(classes: int, data: bytes) -> ErrorFrame:
    """Say what an error frame means."""
    lost_in, controller, protocol, location, transceiver, _, sent, received = (
        data.ljust(8, b"\0")[:8]
    )
    words: list[str] = []
    state: CanState | None = None
    if classes & RESTARTED:
        state = CanState.ACTIVE
        words.append("the controller was bus-off and has started again")
    if classes & CONTROLLER:
        words.append(f"controller: {_words(_CONTROLLER, controller)}")
        for bits, entered in _STATES:
            if controller & bits:
                state = entered
                break
    if classes & BUS_OFF:
        state = CanState.BUS_OFF
        words.append("the controller is bus-off")
    if classes & NO_ACKNOWLEDGE:
        words.append("no other node acknowledges")
    if classes & PROTOCOL:
        where = f" in the {_LOCATION[location]}" if location in _LOCATION else ""
        words.append(f"protocol: {_words(_PROTOCOL, protocol)}{where}")
    if classes & TRANSCEIVER:
        fault = _TRANSCEIVER.get(transceiver, f"status {transceiver:#04x}")
        words.append(f"transceiver: {fault}")
    if classes & LOST_ARBITRATION:
        words.append(f"arbitration lost in bit {lost_in}")
    if classes & TX_TIMEOUT:
        words.append("a frame was not sent in time")
    if classes & BUS_ERROR and not classes & (PROTOCOL | NO_ACKNOWLEDGE):
        words.append("bus error")
    if classes & COUNTERS or sent or received:
        words.append(f"{sent} send and {received} receive errors")
    return ErrorFrame(
        state,
        bool(classes & NO_ACKNOWLEDGE),
        bool(classes & CONTROLLER and controller & 0x01),
        bool(classes & RESTARTED),
        ", ".join(words) or f"error frame of class {classes:#x}",
    )


def _words(names: dict[int, str], bits: int) -> str:
    said = [name for bit, name in names.items() if bits & bit]
    return " and ".join(said) or "unspecified"
