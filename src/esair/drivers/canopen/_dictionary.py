"""The objects of a node, from its EDS or DCF file."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import attrs
from canopen.objectdictionary import (
    FLOAT_TYPES,
    INTEGER_TYPES,
    SIGNED_TYPES,
    ObjectDictionary,
    ODVariable,
    import_od,
)

from esair.drivers._files import described
from esair.exceptions import ConfigError, hint_for

BOOLEAN = 0x1
TEXT = frozenset({0x9, 0xB})


@attrs.frozen
class Mapped:
    """Where an object is in a PDO, and what its bits mean.

    Attributes:
        variable: The object.
        id: The CAN id of the PDO.
        size: How many bytes the PDO has.
        offset: The first bit of the object in it.
        length: How many bits the object has there.
    """

    variable: ODVariable
    id: int
    size: int
    offset: int
    length: int

    def decode(self, data: bytes) -> Any:
        """Unpack the object from the bytes of the PDO, which are not too few."""
        number = int.from_bytes(data, "little") >> self.offset & (1 << self.length) - 1
        kind = self.variable.data_type
        if kind == BOOLEAN:
            return bool(number)
        if kind in INTEGER_TYPES:
            negative = kind in SIGNED_TYPES and number >> (self.length - 1)
            return number - (1 << self.length) if negative else number
        return self.variable.decode_raw(number.to_bytes(-(-self.length // 8), "little"))


def bounds(variable: ODVariable) -> tuple[float, float] | None:
    """Return what an object can be, by its limits and its type; None for no number."""
    low, high = variable.min, variable.max
    if variable.data_type in INTEGER_TYPES:
        bits = len(variable)
        signed = variable.data_type in SIGNED_TYPES
        least = -(1 << (bits - 1)) if signed else 0
        most = (1 << (bits - 1 if signed else bits)) - 1
        return (
            least if low is None else max(low, least),
            most if high is None else min(high, most),
        )
    if variable.data_type not in FLOAT_TYPES or (low is None and high is None):
        return None
    inf = float("inf")
    return (-inf if low is None else low, inf if high is None else high)


def find_object(
    component: str, dictionary: ObjectDictionary, wanted: str | int | tuple[int, int]
) -> ODVariable:
    """Return an object of a dictionary; a `ConfigError` if it is none, or has members."""
    names = _names_of(dictionary)
    found: Any = None
    with contextlib.suppress(KeyError, TypeError, ValueError):
        if isinstance(wanted, str | int):
            found = dictionary[wanted]
        else:
            index, subindex = wanted
            found = dictionary[index]
            if not isinstance(found, ODVariable) or subindex:
                found = found[subindex]
    shown = repr(wanted)
    if isinstance(wanted, int):
        shown = f"{wanted:#06x}"
    elif not isinstance(wanted, str):
        shown = ", ".join(f"{number:#x}" for number in wanted)
    if found is None:
        hint = hint_for(wanted if isinstance(wanted, str) else "", sorted(names))
        raise ConfigError(component, "object", f"there is no object {shown}{hint}")
    if not isinstance(found, ODVariable):
        members = [f"{found.name}.{each.name}" for each in found.values()]
        raise ConfigError(
            component,
            "object",
            f"{shown} has members; expected one of {', '.join(members)}",
        )
    return found


def _names_of(dictionary: ObjectDictionary) -> list[str]:
    names: list[str] = []
    for item in dictionary.values():
        if isinstance(item, ODVariable):
            names.append(item.name)
        else:
            names += [f"{item.name}.{member.name}" for member in item.values()]
    return names


def read_eds(component: str, eds: Path | str, node: int) -> ObjectDictionary:
    return described(component, "eds", eds, import_od, node)
