"""Frames with a length in front and a checksum behind, as a table describes them."""

from __future__ import annotations

import binascii
import functools
import operator
import zlib
from collections.abc import Callable
from typing import Literal

from esair.exceptions import ConfigError
from esair.framing._framing import Searching
from esair.values import check_choice, check_whole

_CRCS: dict[str, tuple[int, Callable[[bytes | bytearray], int]]] = {
    "crc-16/xmodem": (2, lambda data: binascii.crc_hqx(data, 0)),
    "crc-16/ibm-3740": (2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc-32": (4, zlib.crc32),
    "sum-8": (1, lambda data: sum(data) & 0xFF),
    "sum-8/inverted": (1, lambda data: ~sum(data) & 0xFF),
    "xor-8": (1, lambda data: functools.reduce(operator.xor, data, 0)),
    "fletcher-8": (2, lambda data: _fletcher(data)),
}


def _fletcher(data: bytes | bytearray) -> int:
    """Return both sums of 8 bits, the first as the first byte on the wire."""
    first = second = 0
    for byte in data:
        first += byte
        second += first
    return (first & 0xFF) << 8 | second & 0xFF


CRC_SHARE = 512
"""How many bytes of a CRC cost as much as the look at a place."""


class LengthCrc(Searching):
    """Sync bytes, a header, a length, the rest of the payload, a checksum, a trailer.

    Header and trailer may be empty: then the length counts the payload only and is never
    0, and the checksum is over both. Three that are in use::

        # LX-16A and other bus servos of Hiwonder: a payload is id, command, parameters
        { type = "length-crc", sync = "55 55", header = 1, counted = 2,
          crc = "sum-8/inverted" }
        # MSP 1 of flight controllers: command, data
        { type = "length-crc", sync = "24 4D 3E", sent = "24 4D 3C", counted = -1,
          crc = "xor-8" }
        # UBX of u-blox receivers: class, id, data
        { type = "length-crc", sync = "B5 62", header = 2, length_size = 2,
          byteorder = "little", crc = "fletcher-8", max_length = 1024 }

    A good frame inside a bad one is found at the latest when one longest frame has
    arrived after that began.

    The work for garbage is bounded: a reserve of `RESERVE` places is looked at whatever
    they cost, and then one in `SPARSE` bytes, until good frames have filled it again. So
    after a short disturbance the next frame is found, and after long garbage one of
    the next ones. Sync bytes make that rare.

    Args:
        sync: What each frame begins with; a string is in hexadecimal, ``"AA 55"``.
        length_size: Bytes of the length, 1 or 2.
        byteorder: Order of the bytes of the length and of a CRC; a Fletcher sum is sent as
            it is added up.
        crc: ``"crc-16/xmodem"``, ``"crc-16/ibm-3740"`` (also known as CCITT-FALSE),
            ``"crc-32"`` (ISO-HDLC, as in zlib), ``"sum-8"``, ``"sum-8/inverted"``,
            ``"xor-8"`` or ``"fletcher-8"``; over header, length and payload, an
            ``"xor-8"`` without the header.
        max_length: The longest payload, its header included, in bytes.
        sent: What the frames that are sent begin with, if that is another ``sync``.
        header: How many bytes of the payload are before the length.
        counted: What the length says beyond the bytes between it and the checksum: 2 if
            it counts itself and the checksum, -1 if it leaves a command out.
        trailer: What comes behind the checksum.

    Raises:
        ConfigError: A parameter is wrong.
    """

    def __init__(
        self,
        *,
        sync: bytes | str = b"",
        length_size: int = 1,
        byteorder: Literal["big", "little"] = "big",
        crc: str = "crc-16/xmodem",
        max_length: int = 255,
        sent: bytes | str | None = None,
        header: int = 0,
        counted: int = 0,
        trailer: bytes | str = b"",
    ) -> None:
        super().__init__(max_length=max_length)
        self.sync: bytes = _bytes_of("sync", sync)
        self.sent: bytes = self.sync if sent is None else _bytes_of("sent", sent)
        self.trailer: bytes = _bytes_of("trailer", trailer)
        self.header: int = check_whole("framing", "header", header, 0, 16)
        self.counted: int = check_whole("framing", "counted", counted, -16, 16)
        check_choice("framing", "length_size", length_size, (1, 2))
        check_choice("framing", "byteorder", byteorder, ("big", "little"))
        check_choice("framing", "crc", crc, _CRCS)
        most = (1 << 8 * length_size) - 1 - counted + header
        if max_length > most and max_length != 255:
            raise ConfigError(
                "framing",
                "max_length",
                f"expected at most {most}, which the length field can say, "
                f"not {max_length}",
            )
        self.max_length = min(max_length, most)
        self.length_size = length_size
        self.byteorder: Literal["big", "little"] = byteorder
        self.crc = crc
        self._crc_size, self._crc = _CRCS[crc]

    def feed(self, data: bytes) -> list[bytes]:
        at, buffer = self._begin(data), self._buffer
        payloads: list[bytes] = []
        before, trailer = len(self.sync) + self.header, self.trailer
        head = before + self.length_size
        covered_from = len(self.sync) if self.crc != "xor-8" else before
        behind = self._crc_size + len(trailer)
        while True:
            begin = buffer.find(self.sync, at) if self.sync else at
            if begin < 0:  # sync bytes that are cut over chunks can begin at the end
                begin = max(at, len(buffer) - len(self.sync) + 1)
                self._skip(begin - at)
                at = begin
                break
            self._skip(begin - at)
            at = begin
            if len(buffer) < at + head:
                break
            length = int.from_bytes(buffer[at + before : at + head], self.byteorder)
            length -= self.counted
            end = at + head + length
            cost = 1.0
            if length < 0 or not 1 <= length + self.header <= self.max_length:
                end = at + head
            elif len(buffer) < end + behind:
                break
            else:
                told = buffer[end : end + behind]
                covered = buffer[at + covered_from : end]
                payload = buffer[at + len(self.sync) : at + before]
                payload += buffer[at + head : end]
                end += behind
                cost += len(covered) / CRC_SHARE
                if told == self._told(covered) + trailer:
                    payloads.append(bytes(payload))
                    at = self._good(at, end)
                    continue
            at = self._bad(at, end, cost)
        del buffer[:at]
        return payloads

    def encode(self, payload: bytes) -> bytes:
        """Return the whole frame.

        Raises:
            BadValueError: It is empty or too long.
        """
        payload = self._checked(payload, least=max(1, self.header, -self.counted))
        first, rest = payload[: self.header], payload[self.header :]
        length = len(rest) + self.counted
        body = length.to_bytes(self.length_size, self.byteorder) + rest
        covered = body if self.crc == "xor-8" else first + body
        return self.sent + first + body + self._told(covered) + self.trailer

    def _told(self, covered: bytes | bytearray) -> bytes:
        """Return the checksum of bytes, as it is on the wire."""
        order = "big" if self.crc == "fletcher-8" else self.byteorder
        return self._crc(covered).to_bytes(self._crc_size, order)


def _bytes_of(field: str, given: bytes | str) -> bytes:
    if isinstance(given, str):
        try:
            given = bytes.fromhex(given)
        except ValueError:
            told = f"expected hexadecimal, not {given!r:.80}"
            raise ConfigError("framing", field, told) from None
    if not isinstance(given, bytes):
        raise ConfigError("framing", field, f"expected bytes, not {given!r:.80}")
    return given
