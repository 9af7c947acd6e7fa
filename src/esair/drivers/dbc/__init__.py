"""Any message that a DBC file describes, as a sensor or as an actuator.

The value is a dictionary of the message's signals in their units, or one signal alone::

    [sensor.speed]
    driver = "dbc"
    bus = "drive"
    database = "rover.dbc"
    message = "WheelFeedback"
    signal = "speed"

    [actuator.wheels]
    driver = "dbc"
    bus = "drive"
    database = "rover.dbc"
    message = "WheelCommand"
    safe = { left = 0.0, right = 0.0 }

Of a multiplexed message a value has the signals that its multiplexer selects.

Source: the file itself, read by cantools (DBC; ARXML, KCD and SYM as well).
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as CantoolsError

from esair.buses import CanBus
from esair.buses.can import FD_SIZES
from esair.drivers._on_can import can_bus
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceFaultError,
    DriverStuckError,
    describe,
    did_you_mean,
)
from esair.resources import Actuator, Sensor
from esair.values import check_seconds

__all__ = ["DbcActuator", "DbcSensor"]

_NUMBERS = (int, float)

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
        self.signals: dict[str, Signal] = {
            signal.name: signal for signal in message.signals
        }

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


class DbcSensor(Sensor[Any]):
    """A message of a DBC file that a node on the bus sends.

    Each frame is a reading. A frame of the wrong length, or one that cannot be decoded,
    is counted and left out; ten of them in a row are a fault of the device. When no
    frames come the newest reading grows old, and ``max_age`` tells.

    Args:
        database: The DBC file.
        message: The name of the message.
        signal: The name of the only signal that counts; all of them unless given.
        choices: Whether values that have names are given as ``"numbers"`` or
            ``"names"``; a value without a name is a number in any case.
        sequence: The name of a signal that counts the frames. A frame with the number
            of the one before is no reading: a node whose program hangs may send it for
            ever.
        buffer: How many frames are kept until they are taken; then the newest win.

    Attributes:
        bad_frames: How many frames could not be decoded.
        repeated: How many frames had the number of the one before.
        missed: How many frames never came, by their numbers.
    """

    bus: CanBus

    bad_frame_limit: int = 10
    """How many frames in a row may be bad, or repeated, before it is a fault."""

    def __init__(
        self,
        *,
        database: Path | str,
        message: str,
        signal: str | None = None,
        choices: Literal["numbers", "names"] = "numbers",
        sequence: str | None = None,
        buffer: int = 64,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        if choices not in {"numbers", "names"}:
            raise ConfigError(
                self.name, "choices", f"expected 'numbers' or 'names', not {choices!r}"
            )
        if type(buffer) is not int or buffer < 1:
            raise ConfigError(
                self.name, "buffer", f"expected 1 or more, not {buffer!r}"
            )
        self.codec = MessageCodec(
            find_message(self.name, database, message), names=choices == "names"
        )
        self.signal = signal
        if signal is not None:
            find_signal(self.name, "signal", self.codec, signal)
        self.sequence = sequence
        self._modulus = _modulus(self.name, self.codec, sequence)
        self.buffer = buffer
        self.bad_frames = 0
        self.repeated = 0
        self.missed = 0
        self._number: int | None = None
        self._dropped = 0
        self._inbox: Any = None

    @property
    def dropped(self) -> int:
        """How many frames gave way because nobody took them in time."""
        return self._dropped + (0 if self._inbox is None else self._inbox.dropped)

    @property
    def value_type(self) -> Any:
        """A dictionary of signals, or the type of the only one."""
        if self.signal is None:
            return dict
        if self.codec.names and self.codec.signals[self.signal].choices:
            return str
        return float

    async def stream(self) -> AsyncIterator[Any]:
        """Yield the signals of each frame."""
        message, signal = self.codec.message, self.signal
        as_text = self.value_type is str
        bad_in_row = 0
        self._number = None
        self._inbox = can_bus(self).frames(
            message.frame_id, extended=message.is_extended_frame, limit=self.buffer
        )
        with contextlib.closing(self._inbox):
            async for frame in self._inbox:
                try:
                    values = self._decoded(frame.data)
                except FrameError as error:
                    bad_in_row += 1
                    if bad_in_row >= self.bad_frame_limit:
                        raise DeviceFaultError(
                            self.name, f"{bad_in_row} bad frames in a row: {error}"
                        ) from error
                    continue
                bad_in_row = 0
                if signal is None:
                    yield values
                elif signal in values:  # it is not multiplexed away
                    yield str(values[signal]) if as_text else values[signal]

    def _decoded(self, data: bytes) -> Signals:
        """Return the signals of a frame that counts.

        Raises:
            FrameError: It cannot be decoded, or is that of before once more.
        """
        try:
            values = self.codec.decode(data)
        except FrameError:
            self.bad_frames += 1
            raise
        if self.sequence is not None and self.sequence in values:
            number = int(self.codec.number(self.sequence, values[self.sequence]))
            before, self._number = self._number, number
            if before is not None:
                step = (number - before) % self._modulus
                if step == 0:
                    self.repeated += 1
                    raise FrameError(f"its {self.sequence} stays at {number}")
                self.missed += step - 1
        return values

    async def close(self) -> None:
        """Listen no more."""
        self._dropped, self._inbox = self.dropped, None


class DbcActuator(Actuator[Any]):
    """A message of a DBC file that a node on the bus obeys.

    A command has exactly the signals of the message, each as a number in its unit, as
    the name of one of its choices, or as a truth value if it has but one bit; what
    does not fit is refused before it leaves.

    A command is sent once. A node that wants its frames in a cycle gets them from a
    behavior that writes in that cycle; or, with ``cycle``, from this driver, which
    repeats what was written last, from the event loop and never from the kernel: a
    command for ``command_timeout`` after its write and no longer, the safe command
    until the device is closed. When this process hangs or dies the frames end, and the
    node stops by its own time-out; say which that is with ``own_timeout``.

    Args:
        database: The DBC file.
        message: The name of the message.
        safe: The safe command: its signals, or the value of the only one.
        signal: The name of the only signal that commands are; all of them unless given.
        fixed: Signals that are the same in every frame, and are not in commands.
        sequence: The name of a signal that counts the frames; it is not in commands.
        cycle: How often the last command is repeated, in seconds; it is not if None.
        limits: Narrower limits than those of the file.
        slew: The fastest change, in units per second: of the only signal, or of signals
            by name that are not multiplexed.
    """

    bus: CanBus

    def __init__(
        self,
        *,
        database: Path | str,
        message: str,
        safe: Any,
        signal: str | None = None,
        fixed: Mapping[str, float | str] | None = None,
        sequence: str | None = None,
        cycle: float | None = None,
        limits: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
        slew: float | Mapping[str, float] | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.codec = codec = MessageCodec(find_message(self.name, database, message))
        if not codec.message.is_multiplexed():  # else others may have a share of it
            kind = "extended frame" if codec.message.is_extended_frame else "frame"
            self.claim = f"the {kind} {codec.message.frame_id:#x}"
        self.signal = signal
        self.sequence = sequence
        self.cycle = None if cycle is None else check_seconds(self.name, "cycle", cycle)
        self._fixed = dict(fixed or {})
        for name in self._fixed:
            find_signal(self.name, f"fixed.{name}", codec, name)
        self._modulus = _modulus(self.name, codec, sequence)
        if signal is not None:
            find_signal(self.name, "signal", codec, signal)
        self._count = 0
        self._last: Signals | None = None
        self._last_is_safe = True
        self._written = 0.0
        self._writing = 0
        self._repeating: asyncio.Task[None] | None = None
        self.safe = safe
        self.limits = self._narrowed(limits)
        self._limited_only = self._names_with_limits()
        self._value_type = self._type_of_commands()
        self._check_safe()
        if slew is not None:
            self.slew = slew
        self._check_slew()

    @property
    def value_type(self) -> Any:
        """A dictionary of signals, or the type of the only one."""
        return self._value_type

    async def open(self) -> None:
        """Begin to repeat, if that is asked for."""
        can_bus(self)
        self._last = None
        if self.cycle is not None:
            self._repeating = asyncio.get_running_loop().create_task(
                self._repeat(self.cycle), name=f"{self.name} cycle"
            )

    async def close(self) -> None:
        """Repeat no more."""
        task, self._repeating = self._repeating, None
        if task is not None:
            task.cancel()
            await asyncio.wait({task})

    async def write(self, command: Any) -> None:
        """Send a command."""
        values = self._values(command)
        self._last = values
        self._last_is_safe = command == self.safe
        self._written = asyncio.get_running_loop().time()
        self._writing += 1
        try:
            await self._send(values)
        finally:
            self._writing -= 1

    async def _send(self, values: Signals) -> None:
        message = self.codec.message
        if self.sequence is not None:
            values = {**values, self.sequence: self._count % self._modulus}
            self._count += 1
        try:
            data = self.codec.encode(values)
        except FrameError as error:
            raise BadValueError(self.name, "command", str(error)) from error
        await can_bus(self).send(
            message.frame_id, data, extended=message.is_extended_frame
        )

    async def _repeat(self, cycle: float) -> None:
        loop = asyncio.get_running_loop()
        faults = 0
        while True:
            await asyncio.sleep(cycle)
            values = self._last
            if values is None or self._writing:
                continue
            if (
                not self._last_is_safe
                and loop.time() - self._written >= self.command_timeout
            ):
                continue
            try:
                await self._send(values)
            except (BusyError, DriverStuckError):
                continue  # a newer command took its place, or the next repeat will
            except Exception as error:
                faults += 1
                if isinstance(error, ConnectionError) or faults >= self.fault_limit:
                    self.report_lost(error)
                    return
            else:
                faults = 0

    def _values(self, command: Any) -> Signals:
        given = command if self.signal is None else {self.signal: command}
        values = {**given, **self._fixed}
        if self.signal is not None:
            for name in self._others(values):
                values[name] = _at_rest(self.codec.signals[name])
        return values

    def _others(self, values: Signals) -> list[str]:
        """The signals that a frame with the only signal needs besides."""
        wanted = {
            name: values.get(name, _at_rest(signal))
            for name, signal in self.codec.signals.items()
        }
        return [
            name
            for name in self.codec.selected(wanted)
            if name not in values and name != self.sequence
        ]

    def _check_slew(self) -> None:
        """Refuse to limit how fast a signal changes that not all commands have."""
        for name in self.slew if isinstance(self.slew, Mapping) else ():
            if find_signal(self.name, "slew", self.codec, name).multiplexer_ids:
                raise ConfigError(
                    self.name,
                    f"slew.{name}",
                    "it is multiplexed: a command without it has nothing to begin from",
                )

    def _narrowed(self, given: Any) -> Any:
        """Return the limits of the file, narrowed by those that were given."""
        by_file = {
            name: bounds(signal)
            for name, signal in self.codec.signals.items()
            if self._is_free(name)
            and not signal.choices
            and (not signal.multiplexer_ids or self.signal is not None)
        }
        if self.signal is not None:
            free = {} if given is None else {self.signal: given}
        elif given is None or isinstance(given, Mapping):
            free = dict(given or {})
        else:
            raise ConfigError(
                self.name, "limits", f"expected a table by signal, not {given!r:.80}"
            )
        for name, limit in free.items():
            field = "limits" if self.signal is not None else f"limits.{name}"
            signal = find_signal(self.name, field, self.codec, name)
            try:
                low, high = limit
                fits = -math.inf <= low <= high <= math.inf
            except (TypeError, ValueError):
                fits = False
            if not fits:
                raise ConfigError(
                    self.name, field, f"expected (least, greatest), not {limit!r:.80}"
                )
            if self.signal is None and signal.multiplexer_ids:
                raise ConfigError(
                    self.name, field, "it is multiplexed: it has the limits of the file"
                )
            allowed = bounds(signal)
            if not (allowed[0] <= low and high <= allowed[1]):
                raise ConfigError(
                    self.name,
                    field,
                    f"the file allows {allowed[0]:g} to {allowed[1]:g}, not {limit!r}",
                )
            by_file[name] = (low, high)
        if self.signal is not None:
            return by_file.get(self.signal)
        return by_file or None

    def _names_with_limits(self) -> frozenset[str]:
        """The signals of all commands, if numbers within the limits are all they are."""
        free = frozenset(name for name in self.codec.signals if self._is_free(name))
        limits = self.limits if isinstance(self.limits, Mapping) else {}
        if self.codec.message.is_multiplexed() or not free <= limits.keys():
            return frozenset()
        return free

    def _is_free(self, name: str) -> bool:
        """Whether a signal is in commands."""
        if self.signal is not None:
            return name == self.signal
        return name not in self._fixed and name != self.sequence

    def _type_of_commands(self) -> Any:
        if self.signal is None:
            return _checked_type(self.codec.message.name, dict, self._check_signals)
        signal = self.codec.signals[self.signal]
        if isinstance(self.safe, str):
            return _checked_type("str", str, self._check_alone)
        if signal.choices or signal.is_multiplexer:  # limits do not tell what is good
            return _checked_type("float", float, self._check_alone)
        return float

    def _check_safe(self) -> None:
        safe: Any = self.safe
        kind: Any = dict if self.signal is None else float | int | str
        try:
            if not isinstance(safe, kind):
                expected = "a table of signals" if self.signal is None else "a number"
                raise BadValueError(
                    self.name, "safe", f"expected {expected}, not {safe!r:.80}"
                )
            if self.signal is None:
                self._check_signals(safe)
                within: Any = self.limits or {}
            else:
                self._check(self.codec.signals[self.signal], safe)
                within = {} if self.limits is None else {self.signal: self.limits}
            values = self._values(safe)
            for name, (low, high) in within.items():
                if not low <= values[name] <= high:
                    raise BadValueError(
                        self.name,
                        name,
                        f"expected {low:g} to {high:g}, not {values[name]!r:.80}",
                    )
            if self.sequence is not None:
                values[self.sequence] = 0
            self.codec.encode(values)
        except (BadValueError, FrameError) as error:
            text = str(error).removeprefix(f"{self.name}: ").removeprefix("command: ")
            text = text.removeprefix("safe: ")
            raise ConfigError(self.name, "safe", text) from error

    def _check_signals(self, command: Mapping[str, Any]) -> None:
        """Refuse a command that does not have exactly the signals of a frame.

        Limits that are checked for every command anyway are left to that check.
        """
        if (
            self._limited_only
            and command.keys() == self._limited_only
            and all(type(value) in _NUMBERS for value in command.values())
        ):
            return  # as most commands
        for name, value in command.items():
            if name not in self.codec.signals or not self._is_free(name):
                free = [each for each in self.codec.signals if self._is_free(each)]
                hint = did_you_mean(str(name), free) or _among(free)
                raise BadValueError(
                    self.name, str(name), f"there is no such signal{hint}"
                )
            self._check(self.codec.signals[name], value)
        values = {**command, **self._fixed}
        if self.sequence is not None:
            values[self.sequence] = 0
        try:
            selected = self.codec.selected(values)
        except FrameError as error:
            raise BadValueError(self.name, "command", str(error)) from error
        for name in command:
            if name not in selected:
                raise BadValueError(
                    self.name, name, "the multiplexer does not select this signal"
                )

    def _check_alone(self, command: Any) -> None:
        """Refuse a value of the only signal with which there is no frame."""
        assert self.signal is not None
        self._check(self.codec.signals[self.signal], command)
        try:
            self._values(command)
        except FrameError as error:
            raise BadValueError(self.name, self.signal, str(error)) from error

    def _check(self, signal: Signal, value: Any) -> None:
        name = signal.name
        choices = choices_of(signal)
        if isinstance(value, str):
            if value not in choices.values():
                hint = did_you_mean(value, choices.values()) or _among(choices.values())
                raise BadValueError(
                    self.name, name, f"{value!r:.80} is no choice{hint}"
                )
            return
        is_flag = isinstance(value, bool) and signal.length == 1
        if not isinstance(value, int | float) or (type(value) is bool and not is_flag):
            raise BadValueError(
                self.name, name, f"expected a number, not {value!r:.80}"
            )
        limits = self.limits if isinstance(self.limits, Mapping) else {}
        if name in limits or value in choices:
            return
        allowed = bounds(signal)
        if not allowed[0] <= value <= allowed[1]:
            raise BadValueError(
                self.name,
                name,
                f"expected {allowed[0]:g} to {allowed[1]:g}, not {value!r:.80}",
            )


def find_message(component: str, database: Path | str, name: str) -> Message:
    """Return a message of a file.

    Raises:
        ConfigError: The file cannot be read, or has no such message.
    """
    path = Path(database)
    try:
        state = path.stat()
        found = _load(path, state.st_mtime_ns, state.st_size)
    except OSError as error:
        raise ConfigError(
            component, "database", f"{path} cannot be read: {error.strerror}"
        ) from error
    except Exception as error:  # each of cantools' readers has errors of its own
        raise ConfigError(
            component, "database", f"{path} cannot be understood: {describe(error)}"
        ) from error
    if not isinstance(found, Database):
        raise ConfigError(component, "database", f"{path} describes no CAN messages")
    by_name: dict[str, Message] = {each.name: each for each in found.messages}
    if name not in by_name:
        hint = did_you_mean(name, by_name) or _among(by_name)
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
        hint = did_you_mean(name, codec.signals) or _among(codec.signals)
        raise ConfigError(
            component, field, f"{codec.message.name} has no signal {name!r}{hint}"
        )
    return codec.signals[name]


def _modulus(component: str, codec: MessageCodec, name: str | None) -> int:
    """Return where a signal that counts frames begins anew; 1 if there is none.

    Raises:
        ConfigError: There is no such signal, or it cannot count.
    """
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


@functools.lru_cache(maxsize=16)
def _load(path: Path, _modified: int, _size: int) -> Any:
    return cantools.database.load_file(path)


def _among(names: Any) -> str:
    known = sorted(names)
    return f"; there are {', '.join(known[:12])}" if known else "; there are none"


def _at_rest(signal: Signal) -> float:
    """What a signal is that nobody commands: its initial value, or the nearest to 0."""
    if signal.initial is not None and not isinstance(signal.initial, str):
        with contextlib.suppress(TypeError, ValueError):
            return _number(signal.initial)
    low, high = bounds(signal)
    return min(max(0.0, low), high)


class _Checked(type):
    """The class of types whose instances are all values that pass a check."""

    check: Callable[[Any], None]

    def __instancecheck__(cls, value: object) -> bool:
        if not issubclass(type(value), cls):
            return False
        cls.check(value)
        return True

    def __subclasscheck__(cls, other: type) -> bool:  # each value is looked at
        plain = cls.__mro__[1]
        return issubclass(other, plain) or (plain is float and other is int)


def _checked_type(name: str, plain: type, check: Callable[[Any], None]) -> type:
    """Make a subclass of a type; the check raises for a value that is no instance."""
    return _Checked(name, (plain,), {"check": staticmethod(check)})
