"""What the frames of a DBC message mean: bytes to signals and back, without I/O."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as CantoolsError

from esair.buses.can import FD_SIZES
from esair.drivers._files import described
from esair.drivers.dbc._j1939 import is_j1939
from esair.exceptions import ConfigError, describe, hint_for

NUMBERS = (int, float)

_LARGEST: Final = {16: 65_504.0, 32: (2 - 2**-23) * 2.0**127, 64: sys.float_info.max}
"""The largest number of a floating-point signal, by its bits; IEEE 754."""

Signals = dict[str, Any]
"""Signals by name: numbers in the unit of each, or the names of its choices."""


class FrameError(ValueError):
    """A frame that is none of its message."""


class MessageCodec:
    """What the frames of one message mean: bytes to signals and back, without I/O.

    With CAN FD a message has more bytes than it describes if no frame is that short.

    Args:
        message: The message, as cantools read it.
        names: Whether choices are decoded to their names; else they are numbers.
    """

    def __init__(self, message: Message, *, names: bool = False) -> None:
        self.message = message
        self.names = names
        fitting = [size for size in FD_SIZES if size >= message.length]
        self.size: int = min(fitting, default=message.length)
        if is_j1939(message):  # it may come in packets
            self.size = message.length
        self.signals: dict[str, Signal] = {
            signal.name: signal for signal in message.signals
        }
        self._multiplexers = tuple(
            signal.name for signal in message.signals if signal.is_multiplexer
        )

    def decode(self, data: bytes) -> Signals:
        """Unpack a frame.

        Raises:
            FrameError: The length is wrong, or the multiplexer selects nothing.
        """
        message = self.message
        if len(data) != self.size:
            raise FrameError(f"{message.name} has {self.size} bytes, not {len(data)}")
        try:
            values = message.decode_simple(
                data[: message.length], decode_choices=self.names
            )
        except (CantoolsError, ValueError, KeyError) as error:
            raise FrameError(f"{message.name}: {describe(error)}") from error
        if self.names:  # a choice is an object of cantools
            return {
                name: value if isinstance(value, int | float) else str(value)
                for name, value in values.items()
            }
        return dict(values)

    def encode(self, values: Signals) -> bytes:
        """Pack a frame of signals that were checked.

        Raises:
            FrameError: A signal is missing, or its value does not fit.
        """
        try:
            return self.message.encode(values).ljust(self.size, b"\0")
        except (CantoolsError, ValueError, KeyError, TypeError) as error:
            raise FrameError(f"{self.message.name}: {describe(error)}") from error

    def number(self, name: str, value: float | str) -> float:
        """Return the number behind a value of a signal, which may be a choice's name."""
        if isinstance(value, str):
            return float(self.signals[name].conversion.choice_to_number(value))
        return value

    def topic(self, values: Signals) -> tuple[float, ...]:
        """Return what its multiplexers select.

        A newer frame that selects the same makes an older one obsolete; no other does.
        """
        names = (name for name in self._multiplexers if name in values)
        return tuple(self.number(name, values[name]) for name in names)

    def selected(self, values: Mapping[str, Any]) -> set[str]:
        """Return which signals a frame with these values has.

        Raises:
            FrameError: A signal is missing, or a multiplexer selects nothing.
        """
        try:
            return set(self.message.gather_signals(dict(values)))
        except (CantoolsError, ValueError, KeyError, TypeError) as error:
            text = str(error).replace(f"{self.message.name}: ", "")
            raise FrameError(text) from error


def bounds(signal: Signal) -> tuple[float, float]:
    """Return what a signal can be at least and at most, by its limits and its bits."""
    raw: tuple[float, float]
    if signal.is_float:
        raw = (-_LARGEST[signal.length], _LARGEST[signal.length])
    else:
        bits = signal.length - 1 if signal.is_signed else signal.length
        raw = (-(1 << bits) if signal.is_signed else 0, (1 << bits) - 1)
    low, high = sorted(
        _number(signal.conversion.raw_to_scaled(each, decode_choices=False))
        for each in raw
    )
    if signal.minimum is not None:
        low = max(float(signal.minimum), low)
    if signal.maximum is not None:
        high = min(float(signal.maximum), high)
    return low, high


def _number(value: Any) -> float:
    return float(value)


def choices_of(signal: Signal) -> dict[int, str]:
    """Return the names of a signal's values, by number; empty if it has none."""
    return {number: str(name) for number, name in (signal.choices or {}).items()}


def at_rest(signal: Signal) -> float:
    """What a signal is that nobody commands: its initial value, or the nearest to 0."""
    if signal.initial is not None and not isinstance(signal.initial, str):
        with contextlib.suppress(TypeError, ValueError):
            return _number(signal.initial)
    low, high = bounds(signal)
    return min(max(0.0, low), high)


def find_message(component: str, database: Path | str, name: str) -> Message:
    """Return a message of a file.

    Raises:
        ConfigError: The file cannot be read, or has no such message.
    """
    path = Path(database)
    found: Any = described(component, "database", path, cantools.database.load_file)
    if not isinstance(found, Database):
        raise ConfigError(component, "database", f"{path} describes no CAN messages")
    by_name: dict[str, Message] = {each.name: each for each in found.messages}
    if name not in by_name:
        hint = hint_for(name, sorted(by_name))
        raise ConfigError(
            component, "message", f"{path.name} has no message {name!r}{hint}"
        )
    if by_name[name].is_container:
        raise ConfigError(component, "message", f"{name!r} is a container of messages")
    return by_name[name]


def find_signal(component: str, field: str, codec: MessageCodec, name: str) -> Signal:
    """Return a signal of a message.

    Raises:
        ConfigError: There is no such signal.
    """
    if name not in codec.signals:
        hint = hint_for(name, sorted(codec.signals))
        raise ConfigError(
            component, field, f"{codec.message.name} has no signal {name!r}{hint}"
        )
    return codec.signals[name]


def modulus_of(component: str, codec: MessageCodec, name: str | None) -> int:
    """Return where a signal that counts frames begins anew; 1 if there is none."""
    if name is None:
        return 1
    signal = find_signal(component, "sequence", codec, name)
    plain = (signal.scale, signal.offset) == (1, 0)
    if signal.is_float or signal.is_signed or not plain:
        raise ConfigError(
            component, "sequence", f"{name!r} is no unsigned whole number"
        )
    highest = (1 << signal.length) - 1
    return int(highest if signal.maximum is None else min(signal.maximum, highest)) + 1
