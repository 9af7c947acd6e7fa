"""Messages of Modbus, as a serial line and as TCP carry them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from esair.framing._framing import Searching
from esair.loading import of_extra

LONGEST: Final = 254
"""Bytes of the longest message: the unit, and 253 of what it is told."""

CRC_SHARE: Final = 32
"""How many bytes of a CRC cost as much as the look at a place."""

_READS, _SHORT, _LONG = frozenset({1, 2, 3, 4}), frozenset({5, 6}), frozenset({15, 16})


class ModbusRtu(Searching):
    """Modbus RTU: the unit, the function and its data, a CRC.

    A message has no beginning and no length of its own; silence separates them, which
    no computer sees. So its length is that of its function: 1 to 6, 15 and 16. Master and
    unit take turns: what came before a message is sent is no part of its answer.

    Args:
        max_length: The longest message, in bytes without its CRC.

    Raises:
        ConfigError: A parameter is wrong.

    Source: MODBUS over Serial Line V1.02; MODBUS Application Protocol V1.1b3.
    """

    def __init__(self, *, max_length: int = LONGEST) -> None:
        super().__init__(max_length=max_length)
        with of_extra("modbus"):
            from pymodbus.framer.rtu import FramerRTU

        self._sum: Callable[[bytes | bytearray], int] = FramerRTU.compute_CRC

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that are complete now, without their CRC."""
        at, buffer = self._begin(data), self._buffer
        found = []
        while len(buffer) - at >= 4:
            sizes = _sizes(buffer, at)
            end = next((at + n for n in sizes if self._fits(at, at + n)), 0)
            if end:
                found.append(bytes(buffer[at : end - 2]))
                at = self._good(at, end)
            elif sizes and at + sizes[-1] > len(buffer):
                break
            else:
                cost = 1.0 + sum(sizes) / CRC_SHARE
                at = self._bad(at, at + max(sizes, default=1), cost)
        del buffer[:at]
        return found

    def encode(self, payload: bytes) -> bytes:
        """Return a message with its CRC; what has come so far is thrown away.

        Raises:
            BadValueError: It is too long, or has no function.
        """
        payload = self._checked(payload, least=2)
        self.reset()
        return payload + self._crc(payload)

    def _crc(self, data: bytes | bytearray) -> bytes:
        return self._sum(data).to_bytes(2, "big")

    def _fits(self, at: int, end: int) -> bool:
        buffer = self._buffer
        return (
            end <= len(buffer)
            and self._crc(buffer[at : end - 2]) == buffer[end - 2 : end]
        )


def _sizes(buffer: bytearray, at: int) -> tuple[int, ...]:
    """Return how long a message can be, an answer or a request, the shortest first."""
    function, count = buffer[at + 1], buffer[at + 2]
    if function in _READS:
        if not 0 < count <= 250:
            return (8,)
        return (5 + count, 8) if count < 3 else (8, 5 + count)
    if function in _SHORT:
        return (8,)
    if function in _LONG:
        count = buffer[at + 6] if len(buffer) > at + 6 else 0
        return (8, 9 + count) if count <= 246 else (8,)
    return (5,) if 0x80 < function <= 0x90 else ()


class ModbusTcp(Searching):
    """Modbus TCP: a number that the answer repeats, a length, the unit, the function.

    A payload is the number (two bytes), the unit, and the function with its data.

    Args:
        max_length: The longest payload, in bytes.

    Raises:
        ConfigError: A parameter is wrong.

    Source: MODBUS Messaging on TCP/IP V1.0b.
    """

    def __init__(self, *, max_length: int = 2 + LONGEST) -> None:
        super().__init__(max_length=max_length)
        self._number = 0

    def number(self) -> bytes:
        """Return the number of the next request."""
        self._number = self._number % 0xFFFF + 1
        return self._number.to_bytes(2, "big")

    def feed(self, data: bytes) -> list[bytes]:
        at, buffer = self._begin(data), self._buffer
        found = []
        while len(buffer) - at >= 8:
            protocol, length = struct.unpack_from(">HH", buffer, at + 2)
            if protocol or not 2 <= length <= LONGEST:
                at = self._bad(at, at + 6 + LONGEST, 1.0)
                continue
            end = at + 6 + length
            if len(buffer) < end:
                break
            found.append(bytes(buffer[at : at + 2] + buffer[at + 6 : end]))
            at = self._good(at, end)
            self._inside = 0
        del buffer[:at]
        return found

    def encode(self, payload: bytes) -> bytes:
        """Return a message with its length.

        Raises:
            BadValueError: It is too long, or has no function.
        """
        payload = self._checked(payload, least=4)
        return payload[:2] + struct.pack(">HH", 0, len(payload) - 2) + payload[2:]
