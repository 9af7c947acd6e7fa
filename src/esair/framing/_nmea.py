"""Lines of text with a checksum, framed as NMEA 0183 does it.

``$``, an address of letters and digits, fields after commas, ``*``, and the exclusive
or of all characters in between as two hexadecimal digits: ``$RFACK,RTE,20*24``.
Pure functions: bytes in, fields out, no I/O.

Source: NMEA 0183, chapter 5 (data format protocol).
"""

from __future__ import annotations

import itertools
import re

from esair.exceptions import BadValueError
from esair.framing._framing import Framing, Looks

_HALVES = [tuple(8 << place for place in reversed(range(n))) for n in range(32)]
"""How wide the halves of 1, 2, 4 and so on bytes are, in bits."""

_NUMBERS = {
    bytes(pair): int(bytes(pair), 16)
    for pair in itertools.product(b"0123456789ABCDEFabcdef", repeat=2)
}

_LINE = re.compile(rb"(?s).*\$([^$\x80-\xff]*)\*([0-9A-Fa-f]{2})[\r\n]*\Z")

_FORBIDDEN = frozenset("$*,\r\n!\\^~")


class SentenceError(ValueError):
    """A line that is no sentence, or one that was damaged on its way."""


def checksum(body: bytes) -> int:
    """Return the exclusive or of all bytes between ``$`` and ``*``."""
    number = int.from_bytes(body)
    for bits in _HALVES[len(body).bit_length()]:
        number ^= number >> bits  # the upper half onto the lower one, at once
    return number & 0xFF


def encode_sentence(*fields: str | int) -> bytes:
    r"""Make a line of an address and its fields, with ``\r\n`` at its end.

    Raises:
        SentenceError: A field has characters that a sentence cannot carry.
    """
    texts = [str(field) for field in fields]
    for text in texts:
        if not text.isascii() or not text.isprintable() or _FORBIDDEN & set(text):
            raise SentenceError(f"a sentence cannot carry the field {text!r:.80}")
    body = ",".join(texts).encode("ascii")
    return b"$%b*%02X\r\n" % (body, checksum(body))


def decode_sentence(line: bytes) -> list[str]:
    """Return the address and the fields of a line, with or without its end.

    What stands before the last ``$`` is the rest of something else and is left out.

    Raises:
        SentenceError: It is no sentence, or its checksum is wrong.
    """
    found = _LINE.match(line)
    if found is None or _NUMBERS[found[2]] != checksum(found[1]):
        raise SentenceError(f"expected $...*XX, and its checksum, not {line!r:.80}")
    return found[1].decode("ascii").split(",")


class Sentences(Framing):
    r"""Sentences of NMEA 0183: the payload is what stands between ``$`` and ``*``.

    A ``$`` always begins a new sentence, and a ``\n``, with or without a ``\r``, ends
    it. The standard allows 76 bytes; many devices say more. One without an address is
    none. The work for garbage is bounded: after 2048 sentences that are wrong, one
    place in 128 bytes is looked at until good ones have come again.

    Args:
        max_length: The longest payload, in bytes.

    Raises:
        ConfigError: A parameter is wrong.
    """

    def __init__(self, *, max_length: int = 256) -> None:
        super().__init__(max_length=max_length)
        self._max_frame = 1 + max_length + 5  # $, *XX and the end of the line
        self._sentence = re.compile(
            rb"\$([^$\n\x80-\xff]{1,%d})\*([0-9A-Fa-f]{2})\r*\n" % max_length
        )
        self.looks: Looks = Looks()
        """Pays for the sentences that are wrong."""
        self._paid = self._next = 0  # places, from the beginning of what is kept

    def feed(self, data: bytes) -> list[bytes]:
        data = bytes(self._buffer + data)
        self._buffer.clear()
        end = data.rfind(b"\n") + 1
        payloads, used = self._found(data[:end])
        begin = data.rfind(b"$", end)  # what began before was cut off
        begun = data.count(b"$") - (begin >= 0)
        self.bad_frames += begun - len(payloads)
        rest = data[begin:] if begin >= 0 else b""
        if len(rest) > self._max_frame:
            self.bad_frames += 1
            rest = b""
        gone = len(data) - len(rest)
        self.discarded += gone - used
        self._paid, self._next = self._paid - gone, self._next - gone
        self._buffer += rest
        return payloads

    def reset(self) -> None:
        super().reset()
        self._paid = self._next = 0
        self.looks.fill()

    def _found(self, lines: bytes) -> tuple[list[bytes], int]:
        """Return the payloads of whole lines, and how many bytes their frames have."""
        payloads: list[bytes] = []
        used = 0
        past = max(0, self._next)
        search, longest = self._sentence.search, self._max_frame
        while found := search(lines, past):
            begin, past = found.span()
            body, told = found.groups()
            if past - begin <= longest and _NUMBERS[told] == checksum(body):
                payloads.append(body)
                used += past - begin
            else:
                self.looks.earn(past - self._paid)
                self._paid = past
                past += self.looks.pay()
        self._next = past
        return payloads, used

    def encode(self, payload: bytes) -> bytes:
        r"""Return ``$``, the payload, ``*``, the checksum and ``\r\n``.

        Raises:
            BadValueError: It is empty, too long, or has bytes that no sentence can carry.
        """
        payload = self._checked(payload)
        text = payload.decode("latin-1")
        if (
            not text
            or not text.isascii()
            or not text.isprintable()
            or {"$", "*"} & set(text)
        ):
            raise BadValueError(
                "framing", "payload", f"a sentence cannot carry {payload!r:.80}"
            )
        return b"$%b*%02X\r\n" % (payload, checksum(payload))
