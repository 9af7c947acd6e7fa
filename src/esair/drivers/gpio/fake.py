"""A GPIO chip whose lines are moved by a test."""

from __future__ import annotations

import asyncio
import collections
import errno
import os
import threading

from esair.drivers._on_descriptor import FakeDescriptor
from esair.drivers.gpio import Edge, LineRequest
from esair.exceptions import DeviceFaultError, DeviceLostError


class FakeGpioChip:
    """A chip with some lines. Levels are those of the wire: True is a high voltage.

    Args:
        lines: How many lines it has.

    Attributes:
        levels: What each line that was driven by an output has been, oldest first.
        edge_limit: How many edges a line keeps until they are taken; then the newest win.

    Example:
        >>> chip = FakeGpioChip()
        >>> button = DigitalInput(chip="fake", line=3, opener=chip.request)
        >>> chip.drive(3, True)
    """

    edge_limit = 16

    def __init__(self, lines: int = 8) -> None:
        self.levels: dict[int, list[bool]] = collections.defaultdict(list)
        self._outside = [False] * lines
        self._requested: dict[int, _FakeLine] = {}
        self._taken: dict[int, str] = {}
        self._plugged = True
        self._lock = threading.Lock()  # drivers request on threads of theirs

    def request(self, request: LineRequest) -> _FakeLine:
        """Request a line; the ``opener`` of a device."""
        with self._lock:
            if not self._plugged:
                raise DeviceLostError(request.device, "the chip is not there")
            number = request.line
            if not isinstance(number, int) or number >= len(self._outside):
                told = f"{request.chip} has the lines 0 to {len(self._outside) - 1}"
                raise DeviceFaultError(request.device, told)
            if number in self._requested or number in self._taken:
                consumer = self._taken.get(number, "esair")
                told = f"line {number} of {request.chip} is in use by {consumer!r}"
                raise DeviceFaultError(request.device, told)
            line = self._requested[number] = _FakeLine(self, number, request)
            return line

    def drive(self, line: int, level: bool) -> None:
        """Move a line from outside."""
        changed = self._outside[line] is not level
        self._outside[line] = level
        if changed and line in self._requested:
            self._requested[line].changed(level)

    def level(self, line: int) -> bool:
        """Return the level of a line: that of its output, or else from outside."""
        requested = self._requested.get(line)
        if requested is not None and requested.request.output is not None:
            return self.levels[line][-1]
        return self._outside[line]

    def take(self, line: int, consumer: str) -> None:
        """Let somebody else have a line."""
        self._taken[line] = consumer

    def unplug(self) -> None:
        """Take the chip away."""
        self._plugged = False
        for line in self._requested.values():
            line.wake()

    def plug(self) -> None:
        """Bring the chip back."""
        self._plugged = True

    def power_cycle(self) -> None:
        """Be gone for a moment: what was requested before is worth nothing."""
        self.unplug()
        for line in self._requested.values():
            line.is_stale = True
        self._requested.clear()
        self.plug()

    def check(self) -> None:
        """Raise what the kernel says of a chip that is gone."""
        if not self._plugged:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    def release(self, line: int) -> None:
        """Let a line go."""
        with self._lock:
            self._requested.pop(line, None)


class _FakeLine(FakeDescriptor):
    def __init__(self, chip: FakeGpioChip, number: int, request: LineRequest) -> None:
        super().__init__()
        self.request = request
        self._chip = chip
        self._number = number
        self._steady_for = request.debounce
        self._edges: collections.deque[Edge] = collections.deque(maxlen=chip.edge_limit)
        self._count = 0
        self._steady = chip.level(number) if request.output is None else None
        """What an input was last, for longer than it may bounce."""
        self._pending: asyncio.TimerHandle | None = None
        self.is_stale = False
        """Whether the chip was away since it was requested."""
        if request.output is not None:
            self.set(request.output)

    def _check(self) -> None:
        if self.is_stale:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        self._chip.check()

    def get(self) -> bool:
        self._check()
        return self._chip.level(self._number) is not self.request.active_low

    def set(self, value: bool) -> None:
        self._check()
        self._chip.levels[self._number].append(value is not self.request.active_low)

    def edges(self) -> list[Edge]:
        self._check()
        os.eventfd_read(self._event)
        edges = list(self._edges)
        self._edges.clear()
        return edges

    def debounce(self, seconds: float) -> None:
        self._check()
        self._steady_for = seconds

    def close(self) -> None:
        super().close()
        if not self.is_stale:
            self._chip.release(self._number)

    def changed(self, level: bool) -> None:
        if self._pending is not None:
            self._pending.cancel()
        if not self._steady_for:
            self._edge(level)
            return
        loop = asyncio.get_running_loop()
        self._pending = loop.call_later(self._steady_for, self._edge, level)

    def _edge(self, level: bool) -> None:
        if level is self._steady:
            return  # it bounced back
        self._steady = level
        self._count += 1
        self._edges.append(Edge(level is not self.request.active_low, self._count))
        self.wake()
