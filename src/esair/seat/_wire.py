"""Lines of the control socket: one JSON object each, refused unless it is plain."""

from __future__ import annotations

import collections
import json
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from esair.exceptions import BadValueError, EsairError, describe

VERSION = 1
"""The version of the protocol; a line of another one is refused."""

LIMIT = 64 * 1024
"""How long a line may be, in bytes, its end included."""

DEPTH = 16  # How deep a message may be nested

_OWN = frozenset({"v", "id", "act", "until"})


class Message(NamedTuple):
    """What a client wants."""

    id: str  # How the client names it: the same id is done once
    act: str
    fields: Mapping[str, Any]
    # When it is too late for it, in seconds of the monotonic clock; or None
    until: float | None = None


def decode(line: bytes) -> dict[str, Any]:
    """Return the object of a line."""
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _bad(f"expected UTF-8; byte {error.start} is none") from None
    try:
        found = json.loads(
            text,
            parse_constant=_finite,
            parse_float=_finite,
            parse_int=_whole,
            object_pairs_hook=_without_doubles,
        )
    except BadValueError:
        raise
    except RecursionError:
        raise _bad(f"expected at most {DEPTH} levels") from None
    except ValueError as error:
        where = getattr(error, "pos", 0)
        told = getattr(error, "msg", str(error))
        raise _bad(f"expected JSON; at character {where}: {told:.80}") from None
    if not isinstance(found, dict):
        raise _bad(f"expected an object, not a {type(found).__name__}")
    _check(found, DEPTH)
    return found


def message_of(found: Mapping[str, Any]) -> Message:
    """Return the message that an object is."""
    version = found.get("v")
    if type(version) is not int or version != VERSION:
        raise BadValueError("message", "v", f"expected {VERSION}, not {version!r:.40}")
    name = id_of(found)
    if name is None:
        raise BadValueError("message", "id", "expected 1 to 64 printable characters")
    act = found.get("act")
    if not isinstance(act, str):
        raise BadValueError("message", "act", f"expected its name, not {act!r:.40}")
    until = None if act == "stop" else found.get("until")  # no stop is too late
    if until is not None and type(until) not in {int, float}:
        raise BadValueError("message", "until", f"expected seconds, not {until!r:.40}")
    fields = {key: value for key, value in found.items() if key not in _OWN}
    return Message(name, act, fields, until)


def id_of(found: Mapping[str, Any]) -> str | None:
    """Return the id of a message; None if it has no good one."""
    name = found.get("id")
    good = isinstance(name, str) and 1 <= len(name) <= 64 and name.isprintable()
    return name if good else None


def encode(found: Mapping[str, Any]) -> bytes:
    """Return the line of an object; ASCII alone, so that nothing in it ends a line."""
    return json.dumps(found, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def outcome(name: str | None, result: Any) -> dict[str, Any]:
    """Return the answer to a message that was done."""
    return {"v": VERSION, "id": name, "ok": True, "result": result}


def failure(name: str | None, error: BaseException) -> dict[str, Any]:
    """Return the answer to a message that was not done."""
    kind = type(error).__name__ if isinstance(error, EsairError) else "EsairError"
    return {
        "v": VERSION,
        "id": name,
        "ok": False,
        "error": {"type": kind, "text": _told_by(error)[:4096]},
    }


def _told_by(error: BaseException) -> str:
    """Say what is wrong; of several mistakes each."""
    if isinstance(error, ExceptionGroup):
        return "; ".join(map(_told_by, error.exceptions))
    return str(error) if isinstance(error, EsairError) else describe(error)


def _bad(told: str) -> BadValueError:
    return BadValueError("message", "", told)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise _bad(f"expected finite numbers, not {text:.40}")
    return number


def _whole(text: str) -> int:
    if len(text) > 20 or abs(number := int(text)) >= 1 << 63:
        raise _bad(f"expected whole numbers of 64 bit, not {text:.40}")
    return number


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        ((twice, _),) = collections.Counter(name for name, _ in pairs).most_common(1)
        raise _bad(f"the key {twice!r:.40} is there twice")
    return found


def _check(value: Any, depth: int) -> None:
    if isinstance(value, str):
        if not value.isascii() and any("\ud800" <= each <= "\udfff" for each in value):
            raise _bad("expected text; it has half a surrogate pair")
        return
    if not isinstance(value, dict | list):
        return
    if depth <= 0:
        raise _bad(f"expected at most {DEPTH} levels")
    for each in [*value, *value.values()] if isinstance(value, dict) else value:
        _check(each, depth - 1)
