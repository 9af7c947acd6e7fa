"""What a driver declares ahead of time: the bytes that make its device safe."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any, Literal

import attrs

_EXTENDED = 0x8000_0000


def _tuple(frames: Iterable[bytes]) -> tuple[bytes, ...]:
    return tuple(frames)


@attrs.frozen
class SafeFrames:
    """The safe command of an actuator as bytes, sent without any code of its driver.

    Attributes:
        frames: What is sent, one after the other. On a serial line bytes; on CAN what
            `can_frame` makes; on I²C what is written to the chip; on GPIO the structure
            ``gpio_v2_line_values``.
        resync: What is sent before the first of them on a serial line, so that the device
            ends a message that was cut in half; must be nothing to a device that waits.
        repeat: How often all of it is sent.
        gap: The silence before each of them, in seconds, where nothing else ends a message
            that was cut in half; how long a frame takes to be sent included. It is twice
            as long where several devices are on the line, of which one may answer.
        address: The address of the chip on I²C.
    """

    frames: tuple[bytes, ...] = attrs.field(converter=_tuple)
    resync: bytes = b""
    repeat: int = 1
    gap: float = 0.0
    address: int = 0


@attrs.frozen
class Outlet:
    """Where the frames go: told by a bus, or by a driver that has its own descriptor.

    Attributes:
        kind: The medium.
        target: What the watchdog opens itself: ``channel`` and ``fd`` on CAN, ``path`` on
            I²C.
        descriptor: What it gets a duplicate of, on a serial line and for GPIO lines.
    """

    kind: Literal["serial", "can", "i2c", "gpio"]
    target: Mapping[str, Any] = attrs.field(factory=dict)
    descriptor: int | None = None


def can_frame(
    identifier: int, data: bytes, *, extended: bool = False, fd: bool = False
) -> bytes:
    """Return a CAN frame as the kernel's sockets take it (``struct can_frame``).

    Args:
        identifier: The id: 11 bits, 29 if it is extended.
        data: Up to 8 bytes; 64 of CAN FD.
        extended: Whether the id is one of 29 bits.
        fd: Whether it is a frame of CAN FD.
    """
    number = identifier | (_EXTENDED if extended else 0)
    if fd:
        return struct.pack("=IBBxx64s", number, len(data), 0, data)
    return struct.pack("=IB3x8s", number, len(data), data)
