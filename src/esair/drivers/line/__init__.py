r"""A microcontroller that speaks in lines of text: ``name=value``, on a serial line.

The protocol, for the other side (an Arduino sketch, a MicroPython script), is::

    range=1.25       board to robot: a value, whenever the board likes
    range?           robot to board: what is it now? The board answers range=1.25; of a
                     command, with what was applied last
    speed=0.3        robot to board: a command
    speed:0.3        board to robot: done, and this is what was applied
    speed!too fast   board to robot: not done, and why
    who?             robot to board: who are you? The board answers who=NAME

Every line ends with ``\n``; ``\r`` before it is allowed. Names are letters, digits and
``_``; values are decimal numbers. Lines with other names are other devices' business.

Source: this page; it is what most hobby firmware does.
"""

from __future__ import annotations

import math
import re
from collections.abc import AsyncIterator
from typing import Any, ClassVar, TypedDict, Unpack

from esair.buses import Inbox, SerialBus
from esair.drivers._on_bus import check_bus, check_sense, heard
from esair.exceptions import ConfigError, DeviceFaultError
from esair.framing import Raw
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)
from esair.values import check_seconds, digits_of
from esair.watchdog import SafeFrames

__all__ = ["LineActuator", "LineSensor"]

_KEY = re.compile(r"[A-Za-z]\w{0,31}\Z", re.ASCII)
_LINE = re.compile(rb"([A-Za-z]\w{0,31})[=:](.*)", re.DOTALL)
_NUMBER = re.compile(rb"[+-]?(\d++(\.\d*+)?|\.\d++)([eE][+-]?\d++)?\Z")
WAITING = 8
"""How many values that a board pushes are kept until they are taken."""

_DIGITS = 64
"""The most characters that a number has; no computer needs more for a float."""


class LineError(ValueError):
    """A line that is none of the protocol."""


def encode_value(key: str, value: float) -> bytes:
    """Return the line that gives a name a value, without its end.

    Raises:
        LineError: The value is not finite.
    """
    if not math.isfinite(value):
        raise LineError(f"expected a finite number for {key}, not {value!r}")
    return f"{key}={digits_of(value)}".encode("ascii")


def decode_value(line: bytes) -> tuple[str, float]:
    """Return the name and the value of a line ``name=value`` or ``name:value``.

    Raises:
        LineError: It is no such line, or the value is no finite number.
    """
    found = _LINE.match(line)
    if found is None:
        raise LineError(f"expected name=value, not {line[:80]!r:.80}")
    value = _number(found[2])
    if value is None:
        raise LineError(f"expected a number in {line[:80]!r:.80}")
    return found[1].decode("ascii"), value


def _number(text: bytes) -> float | None:
    text = text.strip()
    if len(text) > _DIGITS or not _NUMBER.match(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


class _OnLine(Resource):
    """What sensors and actuators on such a board have in common."""

    bus: SerialBus
    bad_lines: int = 0
    counted: ClassVar[tuple[str, ...]] = ("bad_lines",)

    def __init__(self, *, key: str | None = None, **settings: Any) -> None:
        super().__init__(**settings)
        check_bus(self, SerialBus)
        if isinstance(self.bus.framing, Raw):
            raise ConfigError(
                self.name, "bus", "expected a SerialBus with framing='lines', not 'raw'"
            )
        self.key: str = self.name if key is None else key
        if not _KEY.match(self.key):
            told = f"expected letters, digits and _, at most 32, not {key!r:.80}"
            raise ConfigError(self.name, "key", told)

    async def identify(self) -> str | None:
        """Ask the board who it is, if ``identity`` says who it has to be."""
        if self.identity is None:
            return None
        answer = await self.bus.ask(b"who?", prefix=b"who=")
        return answer.partition(b"=")[2].strip().decode("ascii", "replace")

    async def _look(self) -> float:
        """Ask for the number that the board has now."""
        key = self.key.encode("ascii")
        return self._number_in(await self.bus.ask(key + b"?", prefix=key + b"="))

    def _number_in(self, answer: bytes) -> float:
        try:
            return decode_value(answer)[1]
        except LineError as error:
            self.bad_lines += 1
            raise DeviceFaultError(self.name, str(error)) from error


class _LineSettings(TypedDict, total=False):
    key: str | None


class _SensorSettings(_LineSettings, SensorSettings): ...


class _ActuatorSettings(_LineSettings, ActuatorSettings): ...


class LineSensor(_OnLine, Sensor[float]):
    """One number that a board tells.

    Args:
        key: Its name on the wire; the sensor's own name unless given.
        ask: Ask the board for each value, at the sensor's ``rate``, instead of waiting
            for those that it pushes.
        silent_after: After how many seconds without a value a board that pushes is
            lost; it may be silent for ever if None.

    Attributes:
        bad_lines: How many values were no number; without a ``silent_after`` three in a
            row are a fault.
    """

    _bad_in_row = 0

    def __init__(
        self,
        *,
        ask: bool = False,
        silent_after: float | None = None,
        **settings: Unpack[_SensorSettings],
    ) -> None:
        super().__init__(**settings)
        self.ask = ask
        self.silent_after = silent_after
        if silent_after is not None:
            check_seconds(self.name, "silent_after", silent_after)
            self.period = self.period or silent_after

    @property
    def can_be_asked(self) -> bool:
        """Whether the board is asked for each value."""
        return self.ask

    @property
    def pushes(self) -> bool:
        """Whether the board pushes values."""
        return not self.ask

    async def open(self) -> None:
        """Make sure that the board says something, if it has to."""
        if self.ask:
            await self.read()
        elif self.silent_after is not None:
            with self._lines() as lines:
                async for _ in heard(self, lines, self.silent_after):
                    return

    async def read(self) -> float:
        """Ask for the value.

        Raises:
            DeviceFaultError: The answer is no number.
            DriverStuckError: There is no answer.
        """
        return await self._look()

    async def stream(self) -> AsyncIterator[float]:
        """Yield each value that comes; what is no number is counted and left out.

        Raises:
            DeviceFaultError: No number comes any more, but ``nan``, say, and the last
                one would stay current for ever.
        """
        begin = len(self.key) + 1
        with self._lines() as lines:
            async for line in heard(self, lines, self.silent_after):
                value = _number(line[begin:])
                if value is not None:
                    self._bad_in_row = 0
                    yield value
                    continue
                self.bad_lines += 1
                self._bad_in_row += 1
                check_sense(self, self._bad_in_row, "are no number", line)

    def _lines(self) -> Inbox[bytes]:
        return self.bus.frames(f"{self.key}=".encode("ascii"), limit=WAITING)


class LineActuator(_OnLine, Actuator[float]):
    """One number that a board is told.

    Args:
        safe: The number that makes it safe.
        key: Its name on the wire; the actuator's own name unless given.
        ack: Whether the board confirms each command, with what it has applied. Nothing
            tells one confirmation from another: what comes later than the ``late_limit``
            of the bus after its time is taken for that of the next command.
        limits: Least and greatest number.
        own_timeout: After how many seconds without a command the board itself stops.
        reads_back: Whether what the board has confirmed is read back each second, as
            ``speed?``. A board that is silent is lost then though nobody tells it
            anything, and one that has another number, as after a restart, is opened
            again and made safe: for what the board itself does not change. It needs
            an ``ack``.

    Attributes:
        bad_lines: How many answers had no number.
    """

    def __init__(
        self,
        *,
        safe: float,
        ack: bool = False,
        limits: tuple[float, float] | None = None,
        own_timeout: float | None = None,
        reads_back: bool = False,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        if reads_back and not ack:
            told = "expected ack = true beside it: what was confirmed is read back"
            raise ConfigError(self.name, "reads_back", told)
        self.reads_back: bool = reads_back
        self._told: float | None = None
        """What was confirmed last; None while another command is under way."""
        self.claim: str = f"the value {self.key!r}"
        self.safe = safe
        self.ack = ack
        self.limits: tuple[float, float] | None = limits
        self.own_timeout = own_timeout

    def safe_frames(self) -> SafeFrames:
        """The safe number, after what ends a line that was cut in half."""
        line = self.bus.framing.encode(encode_value(self.key, self.safe))
        resync = self.bus.resync
        return SafeFrames([line], resync=resync, repeat=1 if resync else 3)

    @property
    def can_tell_set_up(self) -> bool:
        """Whether what it has confirmed is read back."""
        return self.reads_back

    async def is_set_up(self) -> bool:
        """Tell whether the board still has what it has confirmed last."""
        told, has = self._told, await self._look()
        return told is None or told != self._told or has == told

    async def open(self) -> None:
        """Make sure that the board answers, if it is to be read back."""
        self._told = None
        if self.reads_back:
            await self._look()

    async def write(self, command: float) -> float | None:
        """Tell the number.

        Raises:
            DeviceFaultError: The board refused it, or answered nonsense.
            DriverStuckError: It did not confirm it in time.
        """
        line = encode_value(self.key, command)
        if not self.ack:
            await self.bus.send(line)
            return None
        self._told = None
        done, refused = f"{self.key}:".encode("ascii"), f"{self.key}!".encode("ascii")
        answer = await self.bus.ask(line, prefix=(done, refused))
        if answer.startswith(refused):
            why = answer[len(refused) :].strip().decode("ascii", "replace")
            raise DeviceFaultError(self.name, f"the board refused {line!r}: {why:.80}")
        self._told = self._number_in(answer)
        return self._told
