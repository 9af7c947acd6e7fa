"""Frames that one listener has not taken yet."""

from __future__ import annotations

from collections.abc import Callable

from esair.buses._bus import BusStats
from esair.buses._inbox import Inbox
from esair.buses.can._frame import Frame


class FrameInbox(Inbox[Frame]):
    """Frames in the order in which they came; the newest win."""

    def __init__(
        self,
        limit: int,
        forget: Callable[[Inbox[Frame]], None],
        *,
        stats: BusStats,
        length: int | None = None,
    ) -> None:
        super().__init__(limit, forget)
        self.bad_frames = 0
        self._stats = stats
        self._length = length

    def offer(self, item: Frame) -> None:
        """Add the newest frame if it has the right length."""
        if self._length is not None and len(item.data) != self._length:
            self._refuse()
            return
        items = self._items
        if len(items) == items.maxlen:
            self.dropped += 1
            self._stats.dropped += 1
        items.append(item)
        self._wake()

    def _refuse(self) -> None:
        self.bad_frames += 1
        self._stats.bad_frames += 1


class NewestInbox(FrameInbox):
    """The newest frame of each id; an id keeps its place in the line.

    So a fast id never pushes out a slow one, and what is taken is never old.
    """

    def __init__(
        self,
        ids: int,
        forget: Callable[[Inbox[Frame]], None],
        *,
        stats: BusStats,
        length: int | None = None,
    ) -> None:
        super().__init__(ids, forget, stats=stats, length=length)
        self._newest: dict[tuple[int, bool], Frame] = {}

    def offer(self, item: Frame) -> None:
        """Put a frame in the place of an older one with its id, or at the end."""
        if self._length is not None and len(item.data) != self._length:
            self._refuse()
            return
        key, items = _key(item), self._items
        is_known = key in self._newest
        if is_known or len(items) == items.maxlen:
            self.dropped += 1
            self._stats.dropped += 1
        if not is_known:
            if len(items) == items.maxlen:
                del self._newest[_key(items[0])]
            items.append(item)
        self._newest[key] = item
        self._wake()

    def fail(self, error: BaseException) -> None:
        """Let every further wait raise an error."""
        self._newest.clear()
        super().fail(error)

    async def take(self, *, timeout: float | None = None) -> Frame:
        """Wait for the next frame and take it; errors as those of `Inbox.take`."""
        return self._newest.pop(_key(await super().take(timeout=timeout)))


def _key(frame: Frame) -> tuple[int, bool]:
    return frame.id, frame.extended
