"""J1939: who sends a message is in its id, and so is how urgent it is.

Source: SAE J1939-21. An id is 3 bits of priority, 18 of the parameter group (in which a
format below 240 leaves 8 bits for who shall get it) and 8 of who sends it.
"""

from __future__ import annotations

from typing import Any, Final, Literal

from cantools.database.can import Message

from esair.buses.can import Ids, Mask
from esair.exceptions import ConfigError

PRIORITY: Final = 7 << 26
SPECIFIC: Final = 0xFF << 8
SOURCE: Final = 0xFF
BROADCAST_FORMATS: Final = 240

Source = int | Literal["any"] | None


def is_j1939(message: Message) -> bool:
    """Whether the file says that a message is one of J1939."""
    return bool(message.protocol == "j1939")


def ids_from(component: str, message: Message, source: Source) -> Ids:
    """Return the ids that a message of J1939 comes with: from any node, or from one."""
    if source is None and not is_j1939(message):
        return int(message.frame_id)
    counts = 0x1FFF_FFFF & ~PRIORITY & ~SOURCE
    if _is_to_one(message):
        counts &= ~SPECIFIC  # whoever it is for
    if source is None or source == "any":
        _check_extended(component, "source", message)
        return Mask(message.frame_id & counts, counts)
    number = _with(component, "source", message, source, SOURCE)
    return Mask(number & (counts | SOURCE), counts | SOURCE)


def id_to(
    component: str, message: Message, source: int | None, destination: int | None
) -> int:
    """Return the id to send a message with; that of the file as far as not given."""
    number = int(message.frame_id)
    if source is not None:
        number = _with(component, "source", message, source, SOURCE)
    if destination is not None:
        if not _is_to_one(message):
            raise ConfigError(
                component, "destination", f"{message.name} is for all nodes"
            )
        with_it = _with(component, "destination", message, destination, SPECIFIC)
        number = number & ~SPECIFIC | with_it & SPECIFIC
    return number


def _is_to_one(message: Message) -> bool:
    return bool(message.frame_id >> 16 & 0xFF < BROADCAST_FORMATS)


def _with(component: str, field: str, message: Message, address: Any, bits: int) -> int:
    _check_extended(component, field, message)
    if type(address) is not int or not 0 <= address <= 0xFF:
        raise ConfigError(
            component, field, f"expected an address 0 to 255, not {address!r:.80}"
        )
    lowest = bits & -bits
    return int(message.frame_id) & ~bits | address * lowest


def _check_extended(component: str, field: str, message: Message) -> None:
    if not message.is_extended_frame:
        raise ConfigError(
            component, field, f"{message.name} has an id of 11 bits: it is not J1939"
        )
