"""A message that a node on the bus sends."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Literal

from esair.buses import CanBus
from esair.drivers._on_can import can_bus
from esair.drivers.dbc._codec import FrameError, MessageCodec, Signals
from esair.drivers.dbc._file import find_message, find_signal, modulus_of
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
)
from esair.resources import Sensor


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
        self._modulus = modulus_of(self.name, self.codec, sequence)
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
