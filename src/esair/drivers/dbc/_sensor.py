"""A message that a node on the bus sends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, ClassVar, Literal, Unpack

from esair.buses import CanBus, Frame, Inbox
from esair.buses.can import Mask
from esair.drivers._on_bus import heard
from esair.drivers.dbc._codec import (
    FrameError,
    MessageCodec,
    Signals,
    find_message,
    find_signal,
    modulus_of,
)
from esair.drivers.dbc._j1939 import SOURCE, TRANSPORT, Reassembly, Source, ids_from
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.resources import Sensor, SensorSettings
from esair.values import check_choice, check_seconds, check_whole


class DbcSensor(Sensor[Any]):
    """A message of a DBC file that a node on the bus sends.

    Each frame is a reading. A frame of the wrong length, or one that cannot be decoded,
    is counted and left out; ten of them in a row are a fault of the device. When no
    frames come the newest reading grows old, and ``max_age`` tells.

    A message of J1939 with more than 8 bytes is put together of its packets (the transport
    protocol), announced to all or sent to another node; this one asks for none.

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
        silent_after: After how many seconds without a frame the node is lost; it may be
            silent for ever if None.
        buffer: How many frames are kept until they are taken; then the newest win.

    Attributes:
        sources: How many frames came from each address, of a message of J1939.
        bad_frames: How many frames could not be decoded.
        repeated: How many frames had the number of the one before.
        missed: How many frames never came, by their numbers.
    """

    missed: int
    repeated: int
    bad_frames: int

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
        self.source = source
        self._ids = ids_from(self.name, self.codec.message, source)
        self._transport: Reassembly | None = None
        if isinstance(self._ids, Mask) and self.codec.message.length > 8:
            self._transport = Reassembly(self.codec.message.frame_id)
            sender = self._ids.mask & SOURCE
            self._ids = Mask(
                TRANSPORT.id | self._ids.id & sender, TRANSPORT.mask | sender
            )
        self.sources: dict[int, int] = {}
        self.buffer: int = check_whole(self.name, "buffer", buffer, 1)
        self.bad_frames = self.repeated = self.missed = 0
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

    async def _heard(self, inbox: Inbox[Frame]) -> AsyncIterator[Frame]:
        """Yield each message: a frame, or what several are together."""
        transport, limit = self._transport, self.silent_after
        last = asyncio.get_running_loop().time()
        async for frame in heard(self, inbox, limit):
            whole = frame if transport is None else transport.feed(frame)
            if whole is not None:
                last = frame.time
                yield whole
            elif limit is not None and frame.time - last > limit:
                raise DeviceLostError(self.name, f"nothing came for {limit:g} s")

    def _frames(self) -> Inbox[Frame]:
        return self.bus.frames(
            self._ids, extended=self.codec.message.is_extended_frame, limit=self.buffer
        )

    async def stream(self) -> AsyncIterator[Any]:
        """Yield the signals of each frame."""
        signal = self.signal
        as_text = self.value_type is str
        bad_in_row = 0
        self._numbers.clear()
        self._inbox = self._frames()
        with self._inbox:
            async for frame in self._heard(self._inbox):
                try:
                    values = self._decoded(frame)
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

    def _decoded(self, frame: Frame) -> Signals:
        """Return the signals of a frame that is none of before once more."""
        try:
            values = self.codec.decode(frame.data)
        except FrameError:
            self.bad_frames += 1
            raise
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
