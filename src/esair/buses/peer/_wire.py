"""What peers say to each other: a head of 40 bytes, then plain data.

The page ``docs/reference/network.md`` is for those who speak it from elsewhere.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from esair.codec import CodecError, Kinds, decode, encode

VERSION: Final = 1
LIMIT: Final = 1 << 20
"""How many bytes a message may have."""

ITEMS: Final = 20_000
"""How many items: it is read in one piece, and that may take 10 ms."""

LISTED: Final = 256
"""How many sensors, or requests, a message may list: each may be answered."""

_NUMBERED: Final = re.compile(rb"\x01t\x03\0\0\0i(.{8})", re.DOTALL)

_NAMED: Final = re.compile(rb"\x01t\x03\0\0\0s(.)", re.DOTALL)

_HEAD: Final = struct.Struct("<QQQQd")

FORMS: Final[Mapping[str, tuple[Any, ...]]] = {
    "beat": (),
    "bye": (),
    "ready": (),  # what could not be had before can be tried again
    "follow": (dict,),  # how often each sensor is wanted, in Hz, by its name
    "reading": (str, float, object),  # sensor, age, value
    "gone": (str, str),  # sensor, why; no reason if it is there but has said nothing
    "write": (int, str, object),  # number, actuator, command
    "release": (int, str),
    "ask": (int, str, object),  # number, behavior, request
    "because": (int, object),  # an ask's number, and those of the asks it is made for
    "cancel": (int,),
    "pending": (list,),  # the numbers of asks that have no answer yet
    "answer": (int, str, object),  # number, how, what
    "progress": (int, object),
}
"""What there is to say, and what each consists of."""

FOR_OWNER: Final = frozenset(
    {"follow", "write", "release", "ask", "because", "cancel", "pending"}
)
"""What asks for something here."""


class Head(NamedTuple):
    """What each message says of the beats of both sides.

    Attributes:
        run: A number of the sender's run: another one after a restart.
        beat: Its newest beat.
        echo_run: The run of the other side that it has heard last.
        echo: The newest beat that it has heard of that.
        held: How long ago it has heard that, in seconds.
    """

    run: int
    beat: int
    echo_run: int
    echo: int
    held: float


def packed(head: Head, parts: tuple[Any, ...], kinds: Kinds) -> bytes:
    """Return a message.

    Raises:
        CodecError: A part is no plain data.
    """
    return _HEAD.pack(*head) + (
        encode(parts, kinds, LIMIT - 64, ITEMS) if parts else b""
    )


def head_of(data: bytes) -> tuple[Head, bytes] | None:
    """Return the head of a message, and its body; None if it is none."""
    if not _HEAD.size <= len(data) <= LIMIT:
        return None
    head = Head(*_HEAD.unpack_from(data))
    if max(head.beat, head.echo) >= 1 << 62 or not 0.0 <= head.held < math.inf:
        return None
    return head, data[_HEAD.size :]


def parts_of(what: str, body: bytes, kinds: Kinds) -> tuple[Any, ...]:
    """Return the parts of a message.

    Raises:
        CodecError: It is nothing that a peer of this version says.
    """
    form = FORMS[what]
    if not form:
        return ()
    parts = decode(body, kinds, LIMIT, ITEMS)
    if type(parts) is not tuple or len(parts) != len(form):
        raise CodecError(f"expected {len(form)} parts")
    for part, kind in zip(parts, form, strict=True):
        if kind is not object and type(part) is not kind:
            raise CodecError(f"expected {kind.__name__}, not {type(part).__name__}")
        if kind in {dict, list} and len(part) > LISTED:
            raise CodecError(f"expected at most {LISTED}, not {len(part)}")
        if kind is float and not 0.0 <= part < math.inf:
            raise CodecError(f"expected seconds, not {part}")
    return parts


def number_of(body: bytes) -> int | None:
    """Return the number of an ask, or a write, whose rest cannot be read."""
    found = _NUMBERED.match(body)
    return None if found is None else int.from_bytes(found[1], "little", signed=True)


def name_of(body: bytes) -> str:
    """Return the name of a sensor whose reading cannot be read."""
    found = _NAMED.match(body)
    end = 0 if found is None else found.end()
    return body[end : end + body[end - 1]].decode(errors="replace") if end else ""


def key_of(to: str, sender: str, what: str) -> str:
    """Return the key of a message on the network."""
    return f"esair/{VERSION}/{to}/{sender}/{what}"
