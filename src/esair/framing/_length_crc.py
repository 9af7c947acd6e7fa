"""Frames with a length in front and a CRC behind."""

from __future__ import annotations

import binascii
import zlib
from collections.abc import Callable
from typing import Literal

from esair.exceptions import ConfigError
from esair.framing._framing import Framing
from esair.framing._looks import Looks
from esair.values import check_choice

_CRCS: dict[str, tuple[int, Callable[[bytes | bytearray], int]]] = {
    "crc-16/xmodem": (2, lambda data: binascii.crc_hqx(data, 0)),
    "crc-16/ibm-3740": (2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc-32": (4, zlib.crc32),
}


CRC_SHARE = 512
"""How many bytes of a CRC cost as much as the look at a place."""


class LengthCrc(Framing):
    """Sync bytes, the length of the payload, the payload, a CRC.

    The length counts the payload only and is never 0; the CRC is over the length and
    the payload. After a bad frame the search goes on one byte later, so a good frame
    inside it is found: at the latest when one longest frame has arrived after it began.
    What begins inside a bad frame is not counted as bad once more.

    The work for garbage is bounded: a reserve of `RESERVE` places is looked at whatever
    they cost, and then one in `SPARSE` bytes, until good frames have filled it again. So
    after a short disturbance the next frame is found, and after long garbage one of
    the next ones. Sync bytes make that rare.

    Args:
        sync: What each frame begins with; a string is in hexadecimal, ``"AA 55"``.
        length_size: Bytes of the length, 1 or 2.
        byteorder: Order of the bytes of the length and of the CRC.
        crc: ``"crc-16/xmodem"``, ``"crc-16/ibm-3740"`` (also known as CCITT-FALSE) or
            ``"crc-32"`` (ISO-HDLC, as in zlib).
        max_length: The longest payload, in bytes.

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
    ) -> None:
        super().__init__(max_length=max_length)
        if isinstance(sync, str):
            try:
                sync = bytes.fromhex(sync)
            except ValueError:
                raise ConfigError(
                    "framing", "sync", f"expected hexadecimal, not {sync!r:.80}"
                ) from None
        if not isinstance(sync, bytes):
            raise ConfigError("framing", "sync", f"expected bytes, not {sync!r:.80}")
        check_choice("framing", "length_size", length_size, (1, 2))
        check_choice("framing", "byteorder", byteorder, ("big", "little"))
        check_choice("framing", "crc", crc, _CRCS)
        if max_length >= 1 << 8 * length_size:
            raise ConfigError(
                "framing",
                "max_length",
                f"expected at most {(1 << 8 * length_size) - 1}, which the length "
                f"field can say, not {max_length}",
            )
        self.sync = sync
        self.length_size = length_size
        self.byteorder: Literal["big", "little"] = byteorder
        self.crc = crc
        self._crc_size, self._crc = _CRCS[crc]
        self._inside = 0  # how many of the next bytes are in a frame counted as bad
        self._left_out = 0
        self.looks: Looks = Looks()
        """Pays for the places that began no good frame."""

    def feed(self, data: bytes) -> list[bytes]:
        """Take the bytes that arrived; return the payloads that are complete now."""
        buffer = self._buffer
        buffer += data
        payloads: list[bytes] = []
        at = self._pass(0, self._left_out)
        head = len(self.sync) + self.length_size
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
            body = at + len(self.sync)
            length = int.from_bytes(buffer[body : at + head], self.byteorder)
            end = at + head + length
            cost = 1.0
            if not 1 <= length <= self.max_length:
                end = at + head
            elif len(buffer) < end + self._crc_size:
                break
            else:
                told = buffer[end : end + self._crc_size]
                end += self._crc_size
                covered = buffer[body : end - self._crc_size]
                cost += len(covered) / CRC_SHARE
                if self._crc(covered) == int.from_bytes(told, self.byteorder):
                    payloads.append(bytes(covered[self.length_size :]))
                    self._inside = max(0, self._inside - (end - at))
                    self.looks.earn(end - at)
                    at = end
                    continue
            if not self._inside:
                self.bad_frames += 1
                self._inside = end - at
            at = self._pass(at, self.looks.pay(cost) or 1)
        del buffer[:at]
        return payloads

    def encode(self, payload: bytes) -> bytes:
        """Return the whole frame.

        Raises:
            BadValueError: It is empty or too long.
        """
        payload = self._checked(payload, least=1)
        body = len(payload).to_bytes(self.length_size, self.byteorder) + payload
        crc = self._crc(body).to_bytes(self._crc_size, self.byteorder)
        return self.sync + body + crc

    def reset(self) -> None:
        """Forget a partial frame: after an opening, or after a silence."""
        super().reset()
        self._inside = self._left_out = 0
        self.looks.fill()

    def _pass(self, at: int, step: int) -> int:
        """Go further, as far as bytes have come; the rest is left out when it comes."""
        now = min(step, len(self._buffer) - at)
        self._left_out = step - now
        self._skip(now)
        return at + now

    def _skip(self, count: int) -> None:
        self.discarded += count
        self.looks.earn(count)
        self._inside = max(0, self._inside - count)
