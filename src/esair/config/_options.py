"""Keys of buses that their classes hand on to the packages behind them.

Only these are known by name, so that a misspelling is found; whatever else a
package takes goes into the table ``options = { ... }`` of the bus.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

_SERIAL: Final[Mapping[str, Any]] = {
    "bytesize": Literal[5, 6, 7, 8],
    "parity": Literal["N", "E", "O", "M", "S"],
    "stopbits": Literal[1, 2] | float,
    "xonxoff": bool,
    "rtscts": bool,
    "dsrdtr": bool,
}
_CAN: Final[Mapping[str, Any]] = {
    "bitrate": int,
    "data_bitrate": int,
    "fd": bool,
    "receive_own_messages": bool,
    "local_loopback": bool,
}


def options_of(cls: type) -> Mapping[str, Any]:
    """Return the types of the further keys that a class of buses takes, by name."""
    names = {
        each.__name__ for each in cls.__mro__ if each.__module__.startswith("esair.")
    }
    if "SerialBus" in names:
        return _SERIAL
    return _CAN if "CanBus" in names else {}
