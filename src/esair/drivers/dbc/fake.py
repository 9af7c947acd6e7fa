"""A node that sends and obeys the messages of a DBC file."""

from __future__ import annotations

import asyncio
import collections
from pathlib import Path
from typing import Any, NamedTuple

import cantools.database
from cantools.database.can import Database

from esair.buses import Frame
from esair.buses.can import FakeCan
from esair.drivers.dbc import FrameError, MessageCodec


class Heard(NamedTuple):
    """A message that the node was sent.

    Attributes:
        message: Its name.
        signals: Its signals; choices are numbers.
    """

    message: str
    signals: dict[str, Any]


class FakeDbcNode:
    """A node on a CAN bus that knows all messages of a file.

    Args:
        can: The bus that it is on.
        database: The DBC file.

    Attributes:
        heard: What it was sent, the oldest first; the last 10 000 are kept.
        bad_frames: How many frames it could not decode.
    """

    def __init__(self, can: FakeCan, database: Path | str) -> None:
        found = cantools.database.load_file(database)
        assert isinstance(found, Database)
        self.database = found
        self.heard: collections.deque[Heard] = collections.deque(maxlen=10_000)
        self.bad_frames: int = 0
        self._can = can
        self._starts = 0.0
        can.on_send(self.receive)
        self._beats: list[asyncio.TimerHandle] = []

    def power_cycle(self, seconds: float = 0.1) -> None:
        """Lose the power: it hears nothing and sends nothing until it has started."""
        self._starts = asyncio.get_running_loop().time() + seconds

    @property
    def is_starting(self) -> bool:
        """Whether its power has just come."""
        return asyncio.get_running_loop().time() < self._starts

    def receive(self, frame: Frame) -> None:
        """Take a frame from the bus; ids that are not in the file are left alone."""
        if self.is_starting:
            return
        for message in self.database.messages:
            kind = message.frame_id, message.is_extended_frame
            if kind == (frame.id, frame.extended):
                try:
                    signals = MessageCodec(message).decode(frame.data)
                except FrameError:
                    self.bad_frames += 1
                else:
                    self.heard.append(Heard(message.name, signals))

    def send(self, message: str, **signals: Any) -> None:
        """Send a message once."""
        found = self.database.get_message_by_name(message)
        data = found.encode(signals)
        self._can.feed(found.frame_id, data, extended=found.is_extended_frame)

    def send_every(self, seconds: float, message: str, **signals: Any) -> None:
        """Send a message again and again, until `stop`."""
        loop = asyncio.get_running_loop()
        place = len(self._beats)

        def beat() -> None:
            if not self.is_starting:
                self.send(message, **signals)
            self._beats[place] = loop.call_later(seconds, beat)

        self._beats.append(loop.call_later(0.0, beat))

    def stop(self) -> None:
        """Send nothing any more."""
        for timer in self._beats:
            timer.cancel()
