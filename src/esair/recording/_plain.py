"""Values of any class as plain JSON, and a schema of them."""

from __future__ import annotations

import base64
import datetime
import enum
import functools
import math
from collections.abc import Mapping
from typing import Any

import attrs

from esair.exceptions import describe

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
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(part, depth - 1) for part in value]
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
