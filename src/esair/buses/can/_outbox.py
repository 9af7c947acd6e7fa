"""Frames on their way to the controller."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Hashable

from esair.buses._inbox import within
from esair.buses._stats import BusStats
from esair.buses.can._frame import Frame, FrameLink
from esair.exceptions import BusyError, DeviceLostError

RETRY_PERIOD = 0.001
"""The first pause before a frame is offered again to a full queue, in seconds."""

LONGEST_RETRY_PERIOD = 0.02
"""The longest pause before a frame is offered again, in seconds."""

WAITING_LIMIT = 256
"""How many frames may wait for room."""


class Outbox:
    """Frames on their way to the controller; those with one id keep their order."""

    def __init__(self, name: str, stats: BusStats) -> None:
        self.link: FrameLink | None = None
        """The node that takes them; what waits for room for another one is lost."""
        self._name = name
        self._stats = stats
        self._lines: dict[int, list[_Waiting]] = {}

    @property
    def waiting(self) -> int:
        """How many are on their way."""
        return sum(map(len, self._lines.values()))

    async def send(
        self, key: int, frame: Frame, seconds: float, replaces: Hashable | None
    ) -> bool:
        """Offer a frame until there is room; tells whether there was in time."""
        link = self.link
        assert link is not None
        mine = _Waiting(replaces)
        line = self._lines.setdefault(key, [])
        if replaces is not None:
            for older in line:
                older.give_way_to(mine)
        line.append(mine)
        try:
            if line[0] is mine and await link.send(frame, seconds):
                return True
            return await self._again(link, frame, seconds, mine, line)
        finally:
            line.remove(mine)
            if line:
                line[0].wake()
            else:
                del self._lines[key]

    async def _again(
        self,
        link: FrameLink,
        frame: Frame,
        seconds: float,
        mine: _Waiting,
        line: list[_Waiting],
    ) -> bool:
        if self.waiting > WAITING_LIMIT:
            raise BusyError(
                f"bus {self._name}", "number of waiting frames", WAITING_LIMIT
            )
        loop = asyncio.get_running_loop()
        give_up = loop.time() + seconds
        pause = RETRY_PERIOD
        while (left := give_up - loop.time()) > 0:
            if mine.is_obsolete:
                raise BusyError(
                    f"bus {self._name}", f"frames waiting with id {frame.id:#x}", 1
                )
            is_first = line[0] is mine
            await mine.pause(min(pause, left) if is_first else left)
            if self.link is not link:
                raise DeviceLostError(
                    self._name, "the bus was lost while a frame waited"
                )
            left = give_up - loop.time()
            if mine.is_obsolete or line[0] is not mine or left <= 0:
                continue
            pause = min(2 * pause, LONGEST_RETRY_PERIOD)
            self._stats.retries += 1
            if await link.send(frame, max(RETRY_PERIOD, left)):
                return True
        return False


class _Waiting:
    """A frame on its way, until it is sent or a newer one makes it obsolete."""

    __slots__ = ("_woken", "is_obsolete", "replaces")

    def __init__(self, replaces: Hashable | None) -> None:
        self.replaces = replaces
        self.is_obsolete = False
        self._woken: asyncio.Future[None] | None = None

    def give_way_to(self, newer: _Waiting) -> None:
        if self.replaces == newer.replaces:
            self.is_obsolete = True
            self.wake()

    def wake(self) -> None:
        if self._woken is not None and not self._woken.done():
            self._woken.set_result(None)

    async def pause(self, seconds: float) -> None:
        self._woken = asyncio.get_running_loop().create_future()
        with contextlib.suppress(TimeoutError):
            await within(self._woken, seconds)
        self._woken = None
