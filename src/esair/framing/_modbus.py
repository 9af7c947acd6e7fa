"""Messages of Modbus, as a serial line and as TCP carry them."""

from __future__ import annotations

import struct
from typing import Final

from esair.framing._framing import Framing

LONGEST: Final = 254
"""Bytes of the longest message: the unit, and 253 of what it is told."""

PATIENCE: Final = 16
"""After how many places that begin no message all that has come is thrown away."""

_READS, _SHORT, _LONG = frozenset({1, 2, 3, 4}), frozenset({5, 6}), frozenset({15, 16})


def _table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
        table.append(value)
    return tuple(table)


_TABLE: Final = _table()


def _crc(data: bytes | bytearray) -> bytes:
    value = 0xFFFF
    for byte in data:
        value = value >> 8 ^ _TABLE[(value ^ byte) & 0xFF]
    return value.to_bytes(2, "little")


class _Searching(Framing):
    """Looks for the beginning of a message, place by place.

    After `PATIENCE` places that begin none a chunk is thrown away whole, so that garbage
    costs next to nothing.
    """

    def __init__(self, *, max_length: int) -> None:
        super().__init__(max_length=max_length)
        self._failed = 0

    def _drop(self, is_bad: bool) -> None:
        self.bad_frames += is_bad
        self._failed += 1
        count = len(self._buffer) if self._failed > PATIENCE else 1
        self.discarded += count
        del self._buffer[:count]


class ModbusRtu(_Searching):
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

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that are complete now, without their CRC."""
        buffer = self._buffer
        buffer += data
        found = []
        while len(buffer) >= 4:
            sizes = _sizes(buffer)
            size = next((n for n in sizes if self._fits(n)), 0)
            if size:
                found.append(bytes(buffer[: size - 2]))
                del buffer[:size]
                self._failed = 0
            elif any(n > len(buffer) for n in sizes):
                break
            else:
                self._drop(bool(sizes))
        return found

    def encode(self, payload: bytes) -> bytes:
        """Return a message with its CRC; what has come so far is thrown away.

        Raises:
            BadValueError: It is too long, or has no function.
        """
        payload = self._checked(payload, least=2)
        self.reset()
        return payload + _crc(payload)

    def _fits(self, size: int) -> bool:
        buffer = self._buffer
        return (
            size <= len(buffer) and _crc(buffer[: size - 2]) == buffer[size - 2 : size]
        )


def _sizes(buffer: bytearray) -> tuple[int, ...]:
    """Return how long a message can be, an answer or a request, with its CRC."""
    function = buffer[1]
    if function in _READS:
        return (5 + buffer[2], 8) if 0 < buffer[2] <= 250 else (8,)
    if function in _SHORT:
        return (8,)
    if function in _LONG:
        count = buffer[6] if len(buffer) > 6 else 0
        return (8, 9 + count) if count <= 246 else (8,)
    return (5,) if 0x80 < function <= 0x90 else ()


class ModbusTcp(_Searching):
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
        """Return the messages that are complete now."""
        buffer = self._buffer
        buffer += data
        found = []
        while len(buffer) >= 8:
            number, protocol, length = struct.unpack_from(">HHH", buffer)
            if protocol or not 2 <= length <= LONGEST:
                self._drop(is_bad=not self._failed)
                continue
            if len(buffer) < 6 + length:
                break
            self._failed = 0
            found.append(number.to_bytes(2, "big") + buffer[6 : 6 + length])
            del buffer[: 6 + length]
        return found

    def encode(self, payload: bytes) -> bytes:
        """Return a message with its length.

        Raises:
            BadValueError: It is too long, or has no function.
        """
        payload = self._checked(payload, least=4)
        return payload[:2] + struct.pack(">HH", 0, len(payload) - 2) + payload[2:]
