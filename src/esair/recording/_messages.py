"""Events as messages, their values as plain JSON: what viewers see, recorded and live."""

from __future__ import annotations

import base64
import datetime
import enum
import functools
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import attrs

from esair.exceptions import describe
from esair.journal import Event, Kind

DEPTH = 12  # How deep a value may be nested; what lies deeper is a text
_AS_IT_IS = {type(None), bool, int, str}
TEXT = 4096  # How long the text of a value without a form of its own may be


def plain(value: Any, depth: int = DEPTH) -> Any:
    """Return a value as JSON has it: numbers, texts, lists, and objects by name.

    Numbers that are not finite become ``"nan"``, ``"inf"`` and ``"-inf"``, arrays of
    NumPy an object with shape, type and data (base64), and errors their description.
    """
    kind: Any = type(value)
    if kind is float:
        return value if math.isfinite(value) else str(value)
    if kind in _AS_IT_IS:
        return value
    names = names_of(kind)
    if names is not None and depth > 0:
        found = {}
        for name in names:
            part = getattr(value, name)
            is_plain = type(part) is float and part - part == 0.0  # it is finite
            found[name] = part if is_plain else plain(part, depth - 1)
        return found
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, int):
        return value.name if isinstance(value, enum.Enum) else int(value)
    if depth <= 0:
        return _text(value)
    if isinstance(value, Mapping):
        return {str(key): plain(part, depth - 1) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part, depth - 1) for part in value]
    if isinstance(value, set | frozenset):  # its order is another in each process
        return sorted((plain(part, depth - 1) for part in value), key=repr)
    if isinstance(value, bytes | bytearray | memoryview):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, BaseException):
        return describe(value)
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    if hasattr(value, "__array_interface__"):
        return {
            "shape": list(value.shape),
            "dtype": str(value.dtype),
            "data": base64.b64encode(value.tobytes()).decode("ascii"),
        }
    if hasattr(value, "__index__") or hasattr(value, "__float__"):  # NumPy's numbers
        return plain(float(value), depth - 1)
    return _text(value)


def fields_of(value: Any) -> dict[str, Any] | None:
    """Return the fields of a structured value by name; None if it has none."""
    kind: object = type(value)
    names = names_of(kind)
    return None if names is None else {name: getattr(value, name) for name in names}


@functools.lru_cache(maxsize=1024)
def names_of(kind: Any) -> tuple[str, ...] | None:
    """Return the names of the fields of a class's objects; None if they have none."""
    if attrs.has(kind):
        return tuple(field.name for field in attrs.fields(kind))
    names = getattr(kind, "__dataclass_fields__", None)
    names = names or getattr(kind, "_fields", None)
    return None if names is None else tuple(names)


def _text(value: Any) -> str:
    try:
        return repr(value)[:TEXT]
    except Exception as error:  # it is somebody else's code
        return f"<{type(value).__name__} without a repr: {type(error).__name__}>"


def schema_of(value: Any) -> dict[str, Any]:
    """Return the JSON schema of a plain value, for viewers."""
    if isinstance(value, bool):
        return {"type": "boolean"}
    if isinstance(value, int | float):
        return {"type": "number"}
    if isinstance(value, str):
        return {"type": "string"}
    if isinstance(value, list):
        return {"type": "array", "items": schema_of(value[0]) if value else {}}
    if isinstance(value, dict):
        return {
            "type": "object",
            "properties": {name: schema_of(part) for name, part in value.items()},
        }
    return {}


EVENT = "esair.Event"
"""The name of the kind of all messages that viewers know no better name for."""

NUMBER = 8  # How many bytes an item of a list counts for
LONG = 256  # From how many items on none of them is looked at

_NUMBERS = {float, int, bool, type(None)}
_EXCHANGE = {Kind.PUT, Kind.GOT, Kind.ASKED, Kind.ANSWERED}
_COMMANDS = {
    Kind.COMMAND,
    Kind.REFUSED,
    Kind.SENT,
    Kind.APPLIED,
    Kind.SAFE,
    Kind.UNANSWERED,
}


class Seen(NamedTuple):
    """What one event is for a viewer.

    Attributes:
        topic: Its topic.
        schema: The name of its kind.
        fields: Plain values.
        when: The wall clock, in seconds.
    """

    topic: str
    schema: str
    fields: dict[str, Any]
    when: float


def size_of(value: Any, depth: int = 3) -> int:
    """Return about how many bytes a value has; of a long list it looks at no item."""
    kind: Any = type(value)
    if kind in _NUMBERS:
        return NUMBER
    names = names_of(kind)
    if names is not None:
        total = 0
        for name in names if depth else ():
            part = getattr(value, name)
            total += NUMBER if type(part) in _NUMBERS else size_of(part, depth - 1)
        return total
    size = getattr(value, "nbytes", None)
    if isinstance(size, int):
        return size
    if isinstance(value, bytes | bytearray | str):
        return len(value)
    if not isinstance(value, Collection):
        return NUMBER
    if len(value) > LONG:
        return NUMBER * len(value)
    parts = value.values() if isinstance(value, Mapping) else value
    return sum(size_of(part, depth - 1) for part in parts) if depth else 0


def seen_as(event: Event, offset: float, encode: Callable[[Any], Any] = plain) -> Seen:
    """Return the message of an event.

    Args:
        event: What happened.
        offset: The wall clock minus the robot's, in seconds.
        encode: Makes a value plain, or leaves it out.
    """
    kind, when = event.kind, event.time + offset
    envelope: dict[str, Any] = {
        "number": event.number,
        "time": event.time,
        "kind": kind.value,
        "component": event.component,
        "peer": event.peer,
        "text": event.text,
    }
    if kind is Kind.LOG:
        line = log_line(event.component, event.peer, event.text, when)
        return Seen("/log", "foxglove.Log", {**line, "esair": envelope}, when)
    value = event.value
    if kind is Kind.READING:
        topic = f"/sensor/{event.component}"
        envelope["sequence"] = value.sequence
        if value.time != event.time:
            envelope["measured"] = value.time
        seen = known(value.value, value.time + offset)
        envelope["value"] = encode(value.value)
        if seen is not None:
            name, fields = seen
            return Seen(topic, name, {**fields, "esair": envelope}, when)
        return Seen(topic, EVENT, envelope, when)
    envelope["value"] = encode(value)
    if kind in _COMMANDS:
        topic = f"/actuator/{event.component}"
    elif kind in _EXCHANGE:
        topic = "/exchange"
    else:
        topic = "/operator" if kind is Kind.OPERATOR else "/state"
    return Seen(topic, EVENT, envelope, when)


LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4, "critical": 5}


def known(value: Any, seconds: float) -> tuple[str, dict[str, Any]] | None:
    """Return the name of a viewer's schema with the value's fields in it.

    It goes by what a value has: a place on earth, a turn of a laser, a picture. None
    if it is of no kind that viewers know.
    """
    kind: object = type(value)
    form = _form(kind)
    if form is None:
        return None
    stamp = {"sec": int(seconds), "nsec": int(seconds % 1 * 1e9)}
    if form == "place":
        return "foxglove.LocationFix", {
            "timestamp": stamp,
            "frame_id": "earth",
            "latitude": value.latitude_deg,
            "longitude": value.longitude_deg,
            "altitude": getattr(value, "altitude", None) or 0.0,
        }
    if form == "scan" and len(value.angles) > 1:
        order = sorted(range(len(value.angles)), key=value.angles.__getitem__)
        return "foxglove.LaserScan", {
            "timestamp": stamp,
            "frame_id": "laser",
            "start_angle": value.angles[order[0]],
            "end_angle": value.angles[order[-1]],
            "ranges": [min(value.ranges[place], 1e6) for place in order],
            "intensities": [],
        }
    if form == "pose":
        half = value.heading / 2
        place = {"x": value.x, "y": value.y, "z": 0.0}
        turn = {"x": 0, "y": 0, "z": math.sin(half), "w": math.cos(half)}
        return "foxglove.PoseInFrame", {
            "timestamp": stamp,
            "frame_id": "world",
            "pose": {"position": place, "orientation": turn},
        }
    return None


_FORMS = {
    "place": ("latitude_deg", "longitude_deg"),
    "scan": ("angles", "ranges"),
    "pose": ("x", "y", "heading"),
}
"""What the values of a class have of which viewers know what it is."""


@functools.lru_cache(maxsize=1024)
def _form(kind: Any) -> str | None:
    has = (f for f, names in _FORMS.items() if all(hasattr(kind, n) for n in names))
    return next(has, None)


def log_line(name: str, level: str, text: str, seconds: float) -> dict[str, Any]:
    """Return a line of the log as viewers know it (``foxglove.Log``)."""
    return {
        "timestamp": {"sec": int(seconds), "nsec": int(seconds % 1 * 1e9)},
        "level": LEVELS.get(level, 0),
        "message": text,
        "name": name,
        "file": "",
        "line": 0,
    }
