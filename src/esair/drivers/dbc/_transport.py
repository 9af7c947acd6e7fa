"""J1939's transport protocol: messages of more than 8 bytes, in packets of 7.

Source: SAE J1939-21, transport protocol functions. A node announces a message to all
(BAM), or asks one other node for leave (RTS), and sends its packets; both are only
listened to here, so that nobody needs an address for it.
"""

from __future__ import annotations

from typing import Final

import attrs

from esair.buses import Frame
from esair.buses.can import Mask
from esair.drivers.dbc._j1939 import BROADCAST_FORMATS, SOURCE

ANNOUNCE: Final = 0xEC
PACKETS: Final = 0xEB
"""The formats of the frames that announce a message, and that carry it."""

TRANSPORT: Final = Mask(0x00E8_0000, 0x03F8_0000)
"""The ids of both, and of some that are left alone."""

RTS, CTS, DONE, BAM, ABORT = 16, 17, 19, 32, 255

MOST: Final = 1785
"""The bytes of the longest message: 255 packets."""

GAP: Final = 0.75
"""After how many seconds without a packet a message is given up."""

MESSAGES: Final = 64
"""How many messages may be under way at once; then the oldest is given up."""


@attrs.define
class _Begun:
    group: int
    size: int
    heard: float
    data: bytearray = attrs.field(factory=bytearray)
    packets: int = 0


class Reassembly:
    """Puts the packets of one kind of message together. No I/O."""

    def __init__(self, frame_id: int) -> None:
        self._group = group_of(frame_id)
        self._begun: dict[tuple[int, int], _Begun] = {}

    def feed(self, frame: Frame) -> Frame | None:
        """Take a frame; return the message that it completes, as if it were one frame."""
        place, data = frame.id >> 16 & 0xFF, frame.data
        ends = frame.id & SOURCE, frame.id >> 8 & 0xFF
        if len(data) != 8:
            return None
        if place == ANNOUNCE:
            self._announced(ends, data, frame.time)
            return None
        begun = self._begun.get(ends)
        if place != PACKETS or begun is None:
            return None
        if frame.time - begun.heard > GAP or data[0] > begun.packets + 1:
            del self._begun[ends]  # a packet is missing, or late
            return None
        begun.heard = frame.time
        begun.packets = data[0]
        begun.data[7 * (data[0] - 1) :] = data[1:]  # or once more, asked for again
        if len(begun.data) < begun.size:
            return None
        del self._begun[ends]
        number = 6 << 26 | begun.group << 8 | ends[0]
        return frame._replace(id=number, data=bytes(begun.data[: begun.size]))

    def _announced(self, ends: tuple[int, int], data: bytes, time: float) -> None:
        kind, size = data[0], int.from_bytes(data[1:3], "little")
        if kind not in {RTS, BAM, ABORT}:
            return
        sender = ends if kind != ABORT else ends[::-1]  # either of both may end it
        for each in {ends, sender}:
            self._begun.pop(each, None)
        group = int.from_bytes(data[5:8], "little")
        if kind == ABORT or group != self._group or not 8 < size <= MOST:
            return
        if len(self._begun) >= MESSAGES:
            del self._begun[next(iter(self._begun))]
        self._begun[ends] = _Begun(group, size, time)


def group_of(frame_id: int) -> int:
    """Return the number of a parameter group, by an id of one of its messages."""
    group = frame_id >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= BROADCAST_FORMATS else group & ~0xFF
