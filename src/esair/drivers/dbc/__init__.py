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

On a bus of J1939 (``VFrameFormat`` of the file) a message is heard from every source
address; one of more than 8 bytes is heard and sent in packets. An address that is not this
robot's alone by design is claimed::

    [actuator.limit]
    driver = "dbc"
    bus = "engine"
    database = "engine.dbc"
    message = "Torque"
    signal = "limit"
    safe = 0.0
    source = 0x80
    j1939_name = "8000000000001234"   # its highest bit: another address will do
    own_timeout = 0.25                # the node stops by itself

Source: the file itself, read by cantools (DBC; ARXML, KCD and SYM as well).
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, Unpack

from esair.buses import CanBus, Frame, Inbox
from esair.buses.can import FD_SIZES, Mask
from esair.drivers._files import described, narrowed
from esair.drivers._on_bus import applied, ended, heard, in_units
from esair.drivers.dbc._j1939 import (
    SOURCE,
    TRANSPORT,
    Claim,
    Reassembly,
    Source,
    absences,
    checked_name,
    claim_of,
    id_to,
    ids_from,
    is_j1939,
    not_available,
    seconds_for,
    send_in_packets,
)
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    describe,
    hint_for,
)
from esair.loading import of_extra
from esair.resources import Actuator, ActuatorSettings, Sensor, SensorSettings
from esair.values import check_choice, check_seconds, check_whole
from esair.watchdog import SafeFrames, can_frame

with of_extra("dbc"):
    import cantools.database
    from cantools.database.can import Database, Message, Signal
    from cantools.database.errors import Error as CantoolsError

__all__ = [
    "DbcActuator",
    "DbcSensor",
    "FrameError",
    "MessageCodec",
    "bounds",
    "choices_of",
    "find_message",
    "find_signal",
]

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
        sizes = () if is_j1939(message) else FD_SIZES  # that may come in packets
        fitting = [size for size in sizes if size >= message.length]
        self.size: int = min(fitting, default=message.length)
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
        ones = is_j1939(self.message)  # where nothing is, nothing is asked for
        try:
            packed = self.message.encode(values, padding=ones, strict=not ones)
            return packed.ljust(self.size, b"\0")
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
        there = filter(values.__contains__, self._multiplexers)
        return tuple(self.number(name, values[name]) for name in there)

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
    scaled: Any = signal.conversion.raw_to_scaled
    low, high = sorted(float(scaled(each, decode_choices=False)) for each in raw)
    if signal.minimum is not None:
        low = max(float(signal.minimum), low)
    if signal.maximum is not None:
        high = min(float(signal.maximum), high)
    return low, high


def choices_of(signal: Signal) -> dict[int, str]:
    """Return the names of a signal's values, by number; empty if it has none."""
    return {number: str(name) for number, name in (signal.choices or {}).items()}


def at_rest(signal: Signal) -> float:
    """What a signal is that nobody commands: its initial value, or the nearest to 0."""
    if (raw := signal.raw_initial) is not None:
        scaled: Any = signal.conversion.raw_to_scaled(raw, decode_choices=False)
        return float(scaled)
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
        told = f"{path.name} has no message {name!r}{hint}"
        raise ConfigError(component, "message", told)
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
        told = f"{codec.message.name} has no signal {name!r}{hint}"
        raise ConfigError(component, field, told)
    return codec.signals[name]


def modulus_of(component: str, codec: MessageCodec, name: str | None) -> int:
    """Return where a signal that counts frames begins anew; 1 if there is none."""
    if name is None:
        return 1
    signal = find_signal(component, "sequence", codec, name)
    plain = (signal.scale, signal.offset) == (1, 0)
    if signal.is_float or signal.is_signed or not plain:
        told = f"{name!r} is no unsigned whole number"
        raise ConfigError(component, "sequence", told)
    highest = (1 << signal.length) - 1
    return int(highest if signal.maximum is None else min(signal.maximum, highest)) + 1


class DbcSensor(Sensor[Any]):
    """A message of a DBC file that a node on the bus sends.

    Each frame is a reading. A frame of the wrong length, or one that cannot be decoded, is
    counted and left out; ten in a row are a fault. Without frames the newest reading grows old.

    A message of J1939 with more than 8 bytes is put together of its packets (the transport
    protocol), announced to all or sent to another node; this one asks for none. Of it a
    reading has no signals that say "error" or "not available", beyond their greatest value;
    if that is the only one again and again, without ``silent_after``, the sensor is lost.

    Args:
        database: The DBC file.
        message: The name of the message.
        signal: The name of the only signal that counts; all of them unless given.
        choices: Whether values that have names are given as ``"numbers"`` or
            ``"names"``; a value without a name is a number in any case.
        sequence: The name of a signal that counts the frames. A frame with the number
            of the one before is no reading: a node whose program hangs may send it for
            ever.
        source: Of a message of J1939, the address of the node that sends it, or
            ``"any"``, which it is unless given: then the messages of all of them are
            readings, whatever their priority and whomever they are for.
        silent_after: After how many seconds without a frame the node is lost; None: never.
        buffer: How many frames are kept until they are taken; then the newest win.

    Attributes:
        sources: How many frames came from each address, of a message of J1939.
        bad_frames: How many frames could not be decoded.
        repeated: How many frames had the number of the one before.
        missed: How many frames never came, by their numbers.
    """

    bus: CanBus
    counted: ClassVar[tuple[str, ...]] = "bad_frames", "repeated", "dropped"

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
        source: Source = None,
        silent_after: float | None = None,
        buffer: int = 64,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        check_choice(self.name, "choices", choices, ("numbers", "names"))
        self.codec: MessageCodec = MessageCodec(
            find_message(self.name, database, message), names=choices == "names"
        )
        self.signal = signal
        if signal is not None:
            find_signal(self.name, "signal", self.codec, signal)
        self.sequence = sequence
        self._modulus = modulus_of(self.name, self.codec, sequence)
        self.silent_after = silent_after
        if silent_after is not None:
            check_seconds(self.name, "silent_after", silent_after)
            self.period = self.period or silent_after
        self.source = source
        self._ids = ids_from(self.name, self.codec.message, source)
        self._transport: Reassembly | None = None
        if isinstance(self._ids, Mask) and self.codec.message.length > 8:
            self._transport = Reassembly(self.codec.message.frame_id)
            sender = self._ids.mask & SOURCE
            self._ids = Mask(
                TRANSPORT.id | self._ids.id & sender, TRANSPORT.mask | sender
            )
        self._is_absent = absences(self.codec.message)
        self.sources: dict[int, int] = {}
        self.buffer: int = check_whole(self.name, "buffer", buffer, 1)
        self.bad_frames = self.repeated = self.missed = self._absent_in_row = 0
        self._numbers: dict[int, int] = {}
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

    async def open(self) -> None:
        """Wait for the first message, if the node may not be silent."""
        if self.silent_after is not None:
            with self._frames() as inbox:
                async for _ in self._heard(inbox):
                    return

    def _heard(self, inbox: Inbox[Frame]) -> AsyncIterator[Frame]:
        """Yield each message: a frame, or what several are together."""
        made = None if self._transport is None else self._transport.feed
        return heard(self, inbox, self.silent_after, made)

    def _frames(self) -> Inbox[Frame]:
        return self.bus.frames(
            self._ids, extended=self.codec.message.is_extended_frame, limit=self.buffer
        )

    async def stream(self) -> AsyncIterator[Any]:
        """Yield the signals of each frame."""
        signal = self.signal
        as_text = self.value_type is str
        bad_in_row = 0
        self._inbox = self._frames()
        with self._inbox:
            async for frame in self._heard(self._inbox):
                try:
                    values = self._decoded(frame)
                except FrameError as error:
                    bad_in_row += 1
                    if bad_in_row >= self.bad_frame_limit:
                        told = f"{bad_in_row} bad frames in a row: {error}"
                        raise DeviceFaultError(self.name, told) from error
                    continue
                bad_in_row = 0
                if signal is None:
                    yield values
                elif signal in values:  # it is not multiplexed away
                    self._absent_in_row = 0
                    yield str(values[signal]) if as_text else values[signal]
                elif self._absent_in_row >= self.fault_limit and not self.silent_after:
                    told = f"{signal} is not available"  # else the last value stayed
                    raise DeviceLostError(self.name, told)

    def _decoded(self, frame: Frame) -> Signals:
        """Return the signals of a frame that is none of before once more."""
        try:
            values = self.codec.decode(frame.data)
        except FrameError:
            self.bad_frames += 1
            raise
        for name in [each for each in self._is_absent if self._is_absent[each](values)]:
            del values[name]
            self._absent_in_row += name == self.signal
        if not isinstance(self._ids, int):
            sender = frame.id & SOURCE
            self.sources[sender] = self.sources.get(sender, 0) + 1
        if self.sequence is not None and self.sequence in values:
            number = int(self.codec.number(self.sequence, values[self.sequence]))
            before = self._numbers.get(frame.id)  # each node counts its own
            self._numbers[frame.id] = number
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


CLAIM_TIME = 2.0
"""How long claiming an address may take, in seconds."""

SAFE_FRAMES = 16
"""How many numbered safe frames the watchdog sends at most."""


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
            The others are as the file begins them, or 0; "not available" in J1939.
        fixed: Signals that are the same in every frame, and are not in commands.
        sequence: The name of a signal that counts the frames; it is not in commands.
            The watchdog tries 16 numbers of it, not knowing which is next.
        source: Of a message of J1939, the address that this robot has; that of the file
            unless given. Without a ``j1939_name`` it is not claimed: no other node may
            have it.
        destination: Of a message of J1939 for one node, the address of that node.
        j1939_name: The NAME by which the address is claimed, which all devices of this
            robot on the bus share: 64 bits, as a number or 16 hexadecimal digits. Lost
            to a lesser NAME, the actuator is lost, and gets no frame, not even its safe
            one, until an address is claimed: say with ``own_timeout`` when the node
            stops by itself. A NAME with its highest bit set takes another address.
        cycle: How often the last command is repeated, in seconds; it is not if None.
        limits: Narrower limits than those of the file.
        slew: The fastest change, in units per second: of the only signal, or of signals
            by name that are not multiplexed.
        own_timeout: After how many seconds without a command the node itself stops.
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
        source: int | None = None,
        destination: int | None = None,
        j1939_name: int | str | None = None,
        cycle: float | None = None,
        limits: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
        slew: float | Mapping[str, float] | None = None,
        own_timeout: float | None = None,
        **settings: Unpack[ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        codec = MessageCodec(find_message(self.name, database, message))
        self.codec: MessageCodec = codec
        self._id = id_to(self.name, codec.message, source, destination)
        self._in_packets = codec.size > 8 and is_j1939(codec.message)
        if self._in_packets:
            needed = seconds_for(codec.size, self._id) + 0.5
            self.deadline: float = max(self.deadline, needed)
        self._claim: Claim | None = None
        self._own_name: int | None = None
        if j1939_name is not None:
            id_to(self.name, codec.message, self._id & SOURCE, None)  # or it has none
            self._own_name = checked_name(self.name, j1939_name)
            self.deadline = max(self.deadline, CLAIM_TIME)
        if not codec.message.is_multiplexed():  # else others may have a share of it
            kind = "extended frame" if codec.message.is_extended_frame else "frame"
            self.claim: str = f"the {kind} {self._id:#x}"
        self.signal = signal
        self.sequence = sequence
        self.cycle: float | None = (
            None if cycle is None else check_seconds(self.name, "cycle", cycle)
        )
        self._fixed = dict(fixed or {})
        for name in self._fixed:
            find_signal(self.name, f"fixed.{name}", codec, name)
        self._modulus = modulus_of(self.name, codec, sequence)
        self._free = codec.signals.keys() - self._fixed.keys() - {sequence}
        if signal is not None:
            find_signal(self.name, "signal", codec, signal)
            self._free = {signal}
        self.own_timeout = own_timeout
        self._count = 0
        self._last: Signals | None = None
        self._last_is_safe = True
        self._written = 0.0
        self._writing = 0
        self._repeating: asyncio.Task[None] | None = None
        self.safe = safe
        self.limits: tuple[float, float] | Mapping[str, tuple[float, float]] | None = (
            self._narrowed(limits)
        )
        self._within = {} if self.limits is None else self._by_name(self.limits)
        plain = not codec.message.is_multiplexed()
        if signal is not None:
            alone = codec.signals[signal]
            special = alone.choices or alone.is_multiplexer
            plain = self.value_type is float and not special
        self._is_plain = plain and self._free <= self._within.keys()
        """Whether numbers within limits are all that commands have."""
        self._check_safe()
        if slew is not None:
            self.slew: float | Mapping[str, float] = slew
        for name in self.slew if isinstance(self.slew, Mapping) else ():
            if find_signal(self.name, "slew", codec, name).multiplexer_ids:
                told = (
                    "it is multiplexed: a command without it has nothing to begin from"
                )
                raise ConfigError(self.name, f"slew.{name}", told)

    @property
    def value_type(self) -> Any:
        """A dictionary of signals, or the type of the only one."""
        if self.signal is None:
            return dict
        return str if isinstance(self.safe, str) else float

    def check(self, command: Any) -> None:
        """Refuse a command with which there is no frame: it is encoded on trial.

        Raises:
            BadValueError: A signal is missing, unknown, no choice, or outside of what
                the file allows.
        """
        if self._is_plain and (
            self.signal is not None
            or (
                command.keys() == self._free
                and all(type(value) in {int, float} for value in command.values())
            )
        ):
            return  # as most commands: numbers, each within the limits of the file
        # The file may forbid it by other means: a choice out of range, say.
        self._encoded(self._checked_signals(self._by_name(command)))

    def safe_frames(self) -> SafeFrames | None:
        """The safe command; with ``sequence`` once for each number that a node expects.

        None of a message that goes in packets, which takes its time.
        """
        if self._in_packets:
            return None
        message, values = self.codec.message, self._values(self.safe)
        return SafeFrames(
            can_frame(
                self._id,
                self._encoded(self._numbered(values, self._count + step)),
                extended=message.is_extended_frame,
                fd=bool(message.is_fd),
            )
            for step in range(min(self._modulus, SAFE_FRAMES))
        )

    async def open(self) -> None:
        """Claim the address and begin to repeat, if that is asked for.

        Raises:
            DeviceLostError: The address belongs to another node.
        """
        self._last = None
        if self._own_name is not None:
            source = self._id & SOURCE if self._claim is None else self._claim.preferred
            claim = self._claim = claim_of(self.name, self.bus, self._own_name, source)
            address = await claim.join(self.report_lost)
            self._id = self._id & ~SOURCE | address
        if self.cycle is not None:
            self._repeating = asyncio.get_running_loop().create_task(
                self._repeat(self.cycle), name=f"{self.name} cycle"
            )

    async def close(self) -> None:
        """Repeat no more, and let the address go."""
        if self._claim is not None:
            await self._claim.leave(self.report_lost)
        await ended(self._repeating)

    async def write(self, command: Any) -> Any:
        """Send a command; returns what it is in the units of its signals, if another."""
        sent = self._rounded(command)
        values = self._values(command if sent is None else sent)
        self._last = values
        self._last_is_safe = command == self.safe
        self._written = asyncio.get_running_loop().time()
        self._writing += 1
        try:
            await self._send(values)
        except BaseException:  # it was not sent, and is not repeated
            if self._last is values and not self._last_is_safe:
                self._last = None
            raise
        finally:
            self._writing -= 1
        return sent

    def _rounded(self, command: Any) -> Any:
        rounded = {}
        for name, value in self._by_name(command).items():
            signal = self.codec.signals[name]
            if not (signal.is_float or isinstance(value, str)):
                unit, offset = signal.scale, signal.offset
                low, high = self._within.get(name) or bounds(signal)
                units = in_units(value, unit, (low, high), offset)
                if (sent := applied(value, units * unit + offset)) is not None:
                    rounded[name] = min(max(low, sent), high)
        if not rounded:
            return None
        return {**command, **rounded} if self.signal is None else rounded[self.signal]

    async def _send(self, values: Signals) -> None:
        values = self._numbered(values, self._count)
        self._count += 1
        data = self._encoded(values)
        if self._claim is not None and self._claim.address is None:
            raise DeviceLostError(self.name, "another node has its address")
        if self._in_packets:
            await send_in_packets(self.bus, self._id, data)
            return
        extended, topic = self.codec.message.is_extended_frame, self.codec.topic(values)
        await self.bus.send(self._id, data, extended=extended, replaces=topic)

    async def _repeat(self, cycle: float) -> None:
        loop = asyncio.get_running_loop()
        faults = 0
        while True:
            await asyncio.sleep(cycle)
            values = self._last
            is_old = loop.time() - self._written >= self.command_timeout
            if values is None or self._writing or (is_old and not self._last_is_safe):
                continue
            try:
                await self._send(values)
            except BusyError:
                continue  # a newer command took its place
            except Exception as error:
                faults += 1
                if isinstance(error, ConnectionError) or faults >= self.fault_limit:
                    self.report_lost(error)
                    return
            else:
                faults = 0

    def _values(self, command: Any) -> Signals:
        """Return all signals of a frame but the sequence; who has one gets the others."""
        if self.signal is None:
            return {**command, **self._fixed}
        values = {self.signal: command, **self._fixed}
        rest = {name: at_rest(each) for name, each in self.codec.signals.items()}
        rest.update(not_available(self.codec.message))
        for name in self.codec.selected({**rest, **values}) - {self.sequence}:
            values.setdefault(name, rest[name])
        return values

    def _numbered(self, values: Signals, number: int) -> Signals:
        """Return the signals with the one that counts, if there is one."""
        if self.sequence is None:
            return values
        return {**values, self.sequence: number % self._modulus}

    def _encoded(self, values: Signals) -> bytes:
        try:
            return self.codec.encode(values)
        except FrameError as error:
            raise self._refusal("command", str(error)) from error

    def _refusal(self, field: object, told: str) -> BadValueError:
        return BadValueError(self.name, str(field), told)

    def _by_name(self, command: Any) -> Mapping[str, Any]:
        return command if self.signal is None else {self.signal: command}

    def _narrowed(self, given: Any) -> Any:
        """Return the limits of the file, narrowed by those that were given."""
        by_file = {
            name: bounds(signal)
            for name, signal in self.codec.signals.items()
            if name in self._free
            and not signal.choices
            and (not signal.multiplexer_ids or self.signal is not None)
        }
        if self.signal is not None:
            free = {} if given is None else {self.signal: given}
        elif given is None or isinstance(given, Mapping):
            free = dict(given or {})
        else:
            told = f"expected a table by signal, not {given!r:.80}"
            raise ConfigError(self.name, "limits", told)
        for name, limit in free.items():
            field = "limits" if self.signal is not None else f"limits.{name}"
            signal = find_signal(self.name, field, self.codec, name)
            if self.signal is None and signal.multiplexer_ids:
                told = "it is multiplexed: it has the limits of the file"
                raise ConfigError(self.name, field, told)
            by_file[name] = narrowed(self.name, field, limit, bounds(signal))
        if self.signal is not None:
            return by_file.get(self.signal)
        return by_file or None

    def _check_safe(self) -> None:
        safe: Any = self.safe
        kind: Any = dict if self.signal is None else float | int | str
        if not isinstance(safe, kind):
            expected = "a table of signals" if self.signal is None else "a number"
            told = f"expected {expected}, not {safe!r:.80}"
            raise ConfigError(self.name, "safe", told)
        try:
            for name, value in self._fixed.items():
                self._check(self.codec.signals[name], value)
            self._encoded(self._checked_signals(self._by_name(safe)))
        except BadValueError as error:
            text = str(error).removeprefix(f"{self.name}: ").removeprefix("command: ")
            raise ConfigError(self.name, "safe", text) from error

    def _checked_signals(self, command: Mapping[str, Any]) -> Signals:
        """Return all signals of a frame, if a command has exactly those that it may."""
        for name, value in command.items():
            if name not in self._free:
                hint = hint_for(str(name), sorted(self._free))
                raise self._refusal(name, f"there is no such signal{hint}")
            self._check(self.codec.signals[name], value)
        whole = command if self.signal is None else command[self.signal]
        try:
            values = self._numbered(self._values(whole), self._count)
            selected = self.codec.selected(values)
        except FrameError as error:
            raise self._refusal(self.signal or "command", str(error)) from error
        for name in command:
            if name not in selected:
                told = "the multiplexer does not select this signal"
                raise self._refusal(name, told)
        return values

    def _check(self, signal: Signal, value: Any) -> None:
        name = signal.name
        choices = choices_of(signal)
        if isinstance(value, str):
            if value not in choices.values():
                hint = hint_for(value, sorted(choices.values()))
                raise self._refusal(name, f"{value!r:.80} is no choice{hint}")
            return
        is_many = isinstance(value, bool) and signal.length > 1
        if is_many or not isinstance(value, int | float):
            raise self._refusal(name, f"expected a number, not {value!r:.80}")
        low, high = self._within.get(name) or bounds(signal)
        if not low <= value <= high and value not in choices:
            told = f"expected {low:g} to {high:g}, not {value!r:.80}"
            raise self._refusal(name, told)
