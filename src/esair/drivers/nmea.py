"""Lines of text with a checksum, framed as NMEA 0183 does it.

``$``, an address of letters and digits, fields after commas, ``*``, and the exclusive
or of all characters in between as two hexadecimal digits: ``$RFACK,RTE,20*24``.
Pure functions: bytes in, fields out, no I/O.

Source: NMEA 0183, chapter 5 (data format protocol).
"""

from __future__ import annotations

import functools
import operator

_FORBIDDEN = frozenset("$*,\r\n!\\^~")


class SentenceError(ValueError):
    """A line that is no sentence, or one that was damaged on its way."""


def checksum(body: bytes) -> int:
    """Return the exclusive or of all bytes between ``$`` and ``*``."""
    return functools.reduce(operator.xor, body, 0)


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
    begin = line.rfind(b"$")
    body, star, digits = line[begin + 1 :].rstrip(b"\r\n").rpartition(b"*")
    if begin < 0 or not star:
        raise SentenceError(f"expected $...*XX, not {line!r:.80}")
    try:
        told = int(digits, 16) if len(digits) == 2 and digits.isalnum() else -1
        text = body.decode("ascii")
    except ValueError:
        raise SentenceError(
            f"expected ASCII and a checksum, not {line!r:.80}"
        ) from None
    if told != checksum(body):
        raise SentenceError(f"the checksum of {line!r:.80} is {checksum(body):02X}")
    return text.split(",")
