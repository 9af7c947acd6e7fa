"""The writes that wait until a busy device can take them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterator
from operator import attrgetter
from typing import Any

import attrs

from esair.connections._registrations import Registration
from esair.exceptions import BusyError
from esair.loop import fail, has_come
from esair.messages import Refused, Written

WAITING_LIMIT = 256  # how many writes may wait for one actuator at a time

Sent = Written[Any] | Refused | Awaitable[Written[Any] | Refused]
"""What comes of a write: its outcome, or what to await for it."""


@attrs.define(eq=False)
class WaitingWrite:
    """A write that waits for its turn."""

    registration: Registration
    command: Any
    hold: float | None
    halts: int
    turn: asyncio.Future[Sent]

    def end(self, end: Sent | Exception) -> None:
        if isinstance(end, Exception):
            fail(self.turn, end)
        elif not self.turn.done():
            self.turn.set_result(end)


class WaitingWrites:
    """Keeps writes in order: the highest priority goes first, then the oldest."""

    __slots__ = ("_loop", "_name", "_writes", "turned_away")

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop) -> None:
        self._name = name
        self._loop = loop
        self._writes: list[WaitingWrite] = []
        self.turned_away = 0

    def __bool__(self) -> bool:
        return bool(self._writes)

    def __iter__(self) -> Iterator[WaitingWrite]:
        return iter(tuple(self._writes))

    async def turn(
        self, registration: Registration, command: Any, hold: float | None, halts: int
    ) -> Sent:
        """Wait until somebody has said what becomes of a write."""
        if len(self._writes) >= WAITING_LIMIT:
            self.turned_away += 1
            raise BusyError(self._name, "number of waiting writes", WAITING_LIMIT)
        turn: asyncio.Future[Sent] = self._loop.create_future()
        write = WaitingWrite(registration, command, hold, halts, turn)
        self._writes.append(write)
        try:
            return await turn
        except asyncio.CancelledError:
            if has_come(turn):
                sent = turn.result()  # its turn came in the same tick
                call = getattr(sent, "call", None)
                if call is not None:
                    call.cancel()
            raise
        finally:
            self.remove(write)

    def first(self) -> WaitingWrite:
        """Take out the one whose turn it is."""
        first = max(self._writes, key=attrgetter("registration.priority"))
        self._writes.remove(first)
        return first

    def remove(self, write: WaitingWrite) -> None:
        if write in self._writes:
            self._writes.remove(write)
