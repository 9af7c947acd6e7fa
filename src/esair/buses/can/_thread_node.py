"""A node of any other interface: one thread reads, the executor sends."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import errno
import threading
from collections.abc import Callable, Collection
from typing import Any

from esair.buses.can._errors import CanState
from esair.buses.can._frame import Frame, FrameKind
from esair.buses.can._ids import EXTENDED, Filter
from esair.buses.can._socket_node import Owner, shut_bus
from esair.exceptions import (
    BusyError,
    DriverStuckError,
    describe,
)
from esair.loop import CallRefused, clock_beside

POLL_PERIOD = 0.1
"""How often a reading thread looks whether it should end, in seconds."""

HEARTBEAT = 1.0
"""How often the reading thread must show that it is alive, in seconds."""

MISSED_BEATS = 3
"""After how many heartbeats without a sign of it the reading thread is given up."""


class ThreadNode:
    """A node of an interface without a socket: one thread reads, the executor sends."""

    inbox_limit = 1024
    state = CanState.ACTIVE

    def __init__(
        self,
        bus: Any,
        owner: Owner,
        *,
        echoes: bool,
        decodes_errors: bool,
    ) -> None:
        import can

        self._can = can
        self._bus = bus
        # can.BusABC.recv measures its time-out by the wall clock: set back by an hour,
        # it waits for an hour. What it calls does not.
        own_recv = type(bus).recv is not can.BusABC.recv
        self._recv = bus.recv if own_recv else bus._recv_internal  # noqa: SLF001
        self._own_recv = own_recv
        self._executor = owner.executor
        self._stats = owner.stats
        self._received = owner.received
        self._gone = owner.gone
        self._fd = owner.fd
        self._bitrate_switch = owner.bitrate_switch
        self._echoes = echoes
        self._decodes_errors = decodes_errors
        self._loop = asyncio.get_running_loop()
        self._time = clock_beside(self._loop)
        self._closed = False
        self._wanted: frozenset[int] = frozenset()
        self._masks: tuple[Filter, ...] = ()
        self._incoming: collections.deque[Frame] = collections.deque(
            maxlen=self.inbox_limit
        )
        self._announced = False
        self._counted = threading.Lock()
        self._unheard = self._dropped = self._bad = 0
        self._beats = 0
        self._missed_beats = 0
        self._reader = threading.Thread(
            target=self._read, name=f"esair-{owner.executor.name}-reader", daemon=True
        )
        self._reader.start()
        self._watch = self._loop.call_later(HEARTBEAT, self._check, self._beats)

    def listen(self, filters: Collection[Filter] | None) -> None:
        wanted = (Filter(0, 0),) if filters is None else filters
        self._wanted = frozenset(each.key for each in wanted if each.is_exact)
        self._masks = tuple(each for each in wanted if not each.is_exact)

    async def send(self, frame: Frame, timeout: float) -> bool:
        if self._closed:
            raise ConnectionError("the node is closed")
        try:
            # With a guard, a frame whose time is over does not leave late.
            return await self._executor.call(
                self._send, frame, timeout=timeout, guard=lambda: not self._closed
            )
        except CallRefused:
            raise ConnectionError("the node is closed") from None

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._watch.cancel()
        self._count()
        with contextlib.suppress(DriverStuckError, BusyError):
            await self._executor.call(self._end, timeout=1.0)

    def _send(self, frame: Frame) -> bool:
        message = self._can.Message(
            arbitration_id=frame.id,
            data=frame.data,
            is_extended_id=frame.extended,
            is_fd=len(frame.data) > 8,
            bitrate_switch=self._bitrate_switch and len(frame.data) > 8,
        )
        try:
            self._bus.send(message, timeout=0)
        except self._can.CanError as error:
            # ENOBUFS has a number; "Transmit buffer full" and a full queue have none.
            if error.error_code in {None, errno.EAGAIN, errno.ENOBUFS}:
                return False
            raise ConnectionError(describe(error)) from error
        return True

    def _read(self) -> None:
        while not self._closed:
            self._beats += 1
            try:
                message = self._recv(timeout=POLL_PERIOD)
                if not self._own_recv:
                    message, _ = message
                if message is None:
                    continue
                frame = self._frame(message)
            except BaseException as error:  # a driver may raise anything
                if not isinstance(error, Exception):
                    error = ConnectionError(f"its reader died: {describe(error)}")
                self._call(self._end_of_reading, error)
                return
            if frame is not None:
                self._put(frame)

    def _frame(self, message: Any) -> Frame | None:
        kind = FrameKind.DATA
        if message.is_error_frame:
            kind = FrameKind.ERROR
            if not self._decodes_errors:
                return Frame(0, b"", False, self._time(), kind)
        elif not (message.is_rx or self._echoes):
            return None  # what was sent from here, which nobody asked for
        else:
            number = message.arbitration_id
            if message.is_extended_id:
                number |= EXTENDED
            if number not in self._wanted and not any(
                number & mask == key for key, mask in self._masks
            ):
                with self._counted:
                    self._unheard += 1
                return None
            if message.is_remote_frame:
                kind = FrameKind.REMOTE
            elif message.is_fd and not self._fd:
                with self._counted:
                    self._bad += 1
                return None
        return Frame(
            message.arbitration_id,
            b"" if kind is FrameKind.REMOTE else bytes(message.data),
            message.is_extended_id and kind is not FrameKind.ERROR,
            self._time(),
            kind,
        )

    def _put(self, frame: Frame) -> None:
        if len(self._incoming) == self.inbox_limit:
            with self._counted:
                self._dropped += 1
        self._incoming.append(frame)
        if not self._announced:
            self._announced = True
            self._call(self._take)

    def _take(self) -> None:
        self._announced = False
        self._count()
        for _ in range(self.inbox_limit):  # what comes meanwhile is announced again
            if self._closed or not self._incoming:
                return
            self._received(self._incoming.popleft())

    def _count(self) -> None:
        """Add what the thread has counted, which only the event loop may do."""
        with self._counted:
            unheard, dropped, bad = self._unheard, self._dropped, self._bad
            self._unheard = self._dropped = self._bad = 0
        stats = self._stats
        stats.received += unheard + dropped + bad
        stats.unheard += unheard
        stats.dropped += dropped
        stats.bad_frames += bad

    def _check(self, beats: int) -> None:
        self._count()
        self._missed_beats = self._missed_beats + 1 if self._beats == beats else 0
        if self._missed_beats >= MISSED_BEATS:
            self._end_of_reading(ConnectionError("its reader does not come back"))
            return
        self._watch = self._loop.call_later(HEARTBEAT, self._check, self._beats)

    def _end_of_reading(self, error: Exception) -> None:
        if not self._closed:
            self._gone(error)

    def _call(self, function: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *args)

    def _end(self) -> None:
        self._reader.join(2 * POLL_PERIOD)
        shut_bus(self._bus)
