"""A message that a node on the bus obeys."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any, Unpack

from cantools.database.can import Signal

from esair.buses import CanBus
from esair.drivers._files import narrowed
from esair.drivers._on_bus import ended
from esair.drivers.dbc._codec import (
    NUMBERS,
    FrameError,
    MessageCodec,
    Signals,
    at_rest,
    bounds,
    choices_of,
    find_message,
    find_signal,
    modulus_of,
)
from esair.drivers.dbc._j1939 import (
    SOURCE,
    Claim,
    checked_name,
    claim_of,
    id_to,
    is_j1939,
)
from esair.drivers.dbc._packets import seconds_for, send_in_packets
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceLostError,
    hint_for,
)
from esair.resources import Actuator, ActuatorSettings
from esair.values import check_seconds
from esair.watchdog import SafeFrames, can_frame

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
        fixed: Signals that are the same in every frame, and are not in commands.
        sequence: The name of a signal that counts the frames; it is not in commands.
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

    codec: MessageCodec

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
        self.codec = codec = MessageCodec(find_message(self.name, database, message))
        self._id = id_to(self.name, codec.message, source, destination)
        self._in_packets = codec.size > 8 and is_j1939(codec.message)
        if self._in_packets:
            self.deadline: float = max(
                self.deadline, seconds_for(codec.size, self._id) + 0.5
            )
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
        self._limited_only: Set[str] = frozenset()
        """The signals of commands, if numbers within limits are all that they have."""
        if (
            signal is None
            and not codec.message.is_multiplexed()
            and self._free <= self._within.keys()
        ):
            self._limited_only = self._free
        self._value_type: Any = dict
        if signal is not None:
            self._value_type = str if isinstance(safe, str) else float
        alone = None if signal is None else codec.signals[signal]
        self._is_plain = (
            alone is not None
            and self._value_type is float
            and self.limits is not None
            and not (alone.choices or alone.is_multiplexer)
        )
        self._check_safe()
        if slew is not None:
            self.slew: float | Mapping[str, float] = slew
        for name in self.slew if isinstance(self.slew, Mapping) else ():
            if find_signal(self.name, "slew", codec, name).multiplexer_ids:
                raise ConfigError(
                    self.name,
                    f"slew.{name}",
                    "it is multiplexed: a command without it has nothing to begin from",
                )

    @property
    def value_type(self) -> Any:
        """A dictionary of signals, or the type of the only one."""
        return self._value_type

    def check(self, command: Any) -> None:
        """Refuse a command with which there is no frame: it is encoded on trial.

        Raises:
            BadValueError: A signal is missing, unknown, no choice, or outside of what
                the file allows.
        """
        if self._limited_only:
            if command.keys() == self._limited_only and all(
                type(value) in NUMBERS for value in command.values()
            ):
                return  # as most commands: numbers, each within the limits of the file
        elif self._is_plain:
            return  # one number, within the limits of the file
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
        task, self._repeating = self._repeating, None
        await ended(task)

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
        values = self._numbered(values, self._count)
        self._count += 1
        data = self._encoded(values)
        if self._claim is not None and self._claim.address is None:
            raise DeviceLostError(self.name, "another node has its address")
        if self._in_packets:
            await send_in_packets(self.bus, self._id, data)
            return
        await self.bus.send(
            self._id,
            data,
            extended=self.codec.message.is_extended_frame,
            replaces=self.codec.topic(values),
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
            raise BadValueError(self.name, "command", str(error)) from error

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
            raise ConfigError(
                self.name, "limits", f"expected a table by signal, not {given!r:.80}"
            )
        for name, limit in free.items():
            field = "limits" if self.signal is not None else f"limits.{name}"
            signal = find_signal(self.name, field, self.codec, name)
            if self.signal is None and signal.multiplexer_ids:
                raise ConfigError(
                    self.name, field, "it is multiplexed: it has the limits of the file"
                )
            by_file[name] = narrowed(self.name, field, limit, bounds(signal))
        if self.signal is not None:
            return by_file.get(self.signal)
        return by_file or None

    def _check_safe(self) -> None:
        safe: Any = self.safe
        kind: Any = dict if self.signal is None else float | int | str
        try:
            if not isinstance(safe, kind):
                expected = "a table of signals" if self.signal is None else "a number"
                raise BadValueError(
                    self.name, "safe", f"expected {expected}, not {safe!r:.80}"
                )
            values = self._checked_signals(self._by_name(safe))
            self._encoded(values)
        except BadValueError as error:
            text = str(error).removeprefix(f"{self.name}: ").removeprefix("command: ")
            text = text.removeprefix("safe: ")
            raise ConfigError(self.name, "safe", text) from error

    def _checked_signals(self, command: Mapping[str, Any]) -> Signals:
        """Return all signals of a frame, if a command has exactly those that it may."""
        for name, value in command.items():
            if name not in self._free:
                hint = hint_for(str(name), sorted(self._free))
                raise BadValueError(
                    self.name, str(name), f"there is no such signal{hint}"
                )
            self._check(self.codec.signals[name], value)
        whole = command if self.signal is None else command[self.signal]
        try:
            values = self._numbered(self._values(whole), self._count)
            selected = self.codec.selected(values)
        except FrameError as error:
            field = self.signal or "command"
            raise BadValueError(self.name, field, str(error)) from error
        for name in command:
            if name not in selected:
                raise BadValueError(
                    self.name, name, "the multiplexer does not select this signal"
                )
        return values

    def _check(self, signal: Signal, value: Any) -> None:
        name = signal.name
        choices = choices_of(signal)
        if isinstance(value, str):
            if value not in choices.values():
                hint = hint_for(value, sorted(choices.values()))
                raise BadValueError(
                    self.name, name, f"{value!r:.80} is no choice{hint}"
                )
            return
        is_flag = isinstance(value, bool) and signal.length == 1
        if not isinstance(value, int | float) or (type(value) is bool and not is_flag):
            raise BadValueError(
                self.name, name, f"expected a number, not {value!r:.80}"
            )
        low, high = self._within.get(name) or bounds(signal)
        if not low <= value <= high and value not in choices:
            raise BadValueError(
                self.name, name, f"expected {low:g} to {high:g}, not {value!r:.80}"
            )
