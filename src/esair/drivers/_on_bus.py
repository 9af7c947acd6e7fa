"""What drivers ask of the bus that their parts are on.

Which kind of bus that is says the annotation ``bus:`` of a class, and the rulebook reads it.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, TypeVar

from esair.buses import Bus, Inbox
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.framing import FRAMINGS, Framing
from esair.loop import spawn
from esair.resources import Resource

T = TypeVar("T")


def shared(bus: Bus, kind: type[T]) -> dict[Any, T]:
    """Return what devices on a bus share, of one kind, by a key of theirs."""
    return bus.shared.setdefault(kind, {})


class SharedTask:
    """A task on a bus, which runs while at least one device needs it."""

    def __init__(self, bus: Bus) -> None:
        self._bus: Any = bus
        self._users: dict[Any, None] = {}
        self._task: asyncio.Task[None] | None = None

    def begin(self, user: Any, run: Callable[[], Coroutine[Any, Any, None]]) -> bool:
        """Have a user more, and the task if it does not run; tells whether it began."""
        self._users[user] = None
        if self._task is not None and not self._task.done():
            return False
        name = f"{self._bus.name} {type(self).__name__.lstrip('_').lower()}"
        self._task = spawn(asyncio.get_running_loop(), run(), name=name)
        # Its error is the bus's, which tells everybody on it.
        self._task.add_done_callback(lambda done: done.cancelled() or done.exception())
        return True

    async def leave(self, user: Any) -> None:
        """Have a user less; the last one ends the task."""
        self._users.pop(user, None)
        if not self._users:
            task, self._task = self._task, None
            await ended(task)


def room_comes() -> contextlib.AbstractContextManager[None]:
    """Let what repeats by itself go on after it found no room: the next one comes soon."""
    return contextlib.suppress(BusyError, DeviceFaultError, DriverStuckError)


async def ended(task: asyncio.Task[Any] | None) -> None:
    """End a task that a device has while it is open, if it has one."""
    if task is not None and not task.done():
        task.cancel()
        await asyncio.wait({task})


def check_bus(device: Resource, kind: type[Bus], *framings: type[Framing]) -> None:
    """Refuse, as soon as a device is made, a bus of another kind or framed otherwise."""
    bus: object = device.bus
    framing = getattr(bus, "framing", None)
    if isinstance(bus, kind) and (not framings or isinstance(framing, framings)):
        return
    names = [repr(name) for name, each in FRAMINGS.items() if each in framings]
    framed = f" with framing={' or '.join(names)}" if names else ""
    advice = ": give it one by bus=" if bus is None else ""
    raise ConfigError(
        device.name, "bus", f"expected a {kind.__name__}{framed}, not {bus!r}{advice}"
    )


def in_units(
    command: float, unit: float, limits: tuple[float, float] | None, offset: float = 0.0
) -> int:
    """Return a command in whole units: the nearest, unless that is beyond a limit."""
    units = round((command - offset) / unit)
    sent = applied(command, units * unit + offset)
    if limits is None or sent is None or limits[0] <= sent <= limits[1]:
        return units
    if applied(limits[sent > command], sent) is None:
        return units  # 3 * 0.1 is above 0.3
    return units + (1 if (sent < command) is (unit > 0) else -1)


def applied(command: float, sent: float) -> float | None:
    """Return what was sent instead of a command, if that had to be rounded to it."""
    return None if math.isclose(sent, command, rel_tol=1e-6, abs_tol=1e-12) else sent


def check_sense(device: Any, in_row: int, wrong: str, last: Any) -> None:
    """Refuse nothing but nonsense: who may be silent for ever would keep its last value.

    Raises:
        DeviceFaultError: So many messages in a row are wrong in this way, the last is this.
    """
    if device.silent_after is None and in_row >= device.fault_limit:
        told = f"{in_row} messages in a row {wrong}: {last!r:.80}"
        raise DeviceFaultError(device.name, told)


def heard(
    device: Resource,
    inbox: Inbox[T],
    silent_after: float | None,
    made: Callable[[T], Any] | None = None,
    what: str = "nothing came",
) -> AsyncIterator[Any]:
    """Yield what is made of what comes; who is silent for so long is a `DeviceLostError`.

    Args:
        device: Who says it, for the error.
        inbox: Where it comes.
        silent_after: After how many seconds without anything; never if None.
        made: What is made of it; None is left out, and no sign of life. Itself if None.
        what: What has not come, in words.
    """
    if silent_after is None and made is None:
        return inbox  # hot
    return _heard(device, inbox, silent_after, made or (lambda item: item), what)


async def _heard(
    device: Resource,
    inbox: Inbox[T],
    silent_after: float | None,
    made: Callable[[T], Any],
    what: str,
) -> AsyncIterator[Any]:
    loop = asyncio.get_running_loop()
    seconds = math.inf if silent_after is None else silent_after
    due = loop.time() + seconds
    while True:
        left = None if silent_after is None else max(0.0, due - loop.time())
        try:
            found = made(await inbox.take(timeout=left))
        except StopAsyncIteration:
            return
        except TimeoutError:
            found = None
        if found is not None:
            yield found
            due = loop.time() + seconds
        elif loop.time() >= due and not inbox:  # it may wait behind this
            raise DeviceLostError(device.name, f"{what} for {seconds:g} s")


def watching(
    device: Resource,
    inbox: Inbox[T],
    watch: Callable[[Inbox[T]], Coroutine[Any, Any, None]],
) -> asyncio.Task[None]:
    """Return a task that watches what comes, and reports what is wrong with a device."""

    async def run() -> None:
        with inbox, contextlib.suppress(StopAsyncIteration):
            try:
                await watch(inbox)
            except OSError as error:
                device.report_lost(error)

    return spawn(asyncio.get_running_loop(), run(), name=f"watch {device.name}")


def loop_of(fake: object) -> asyncio.AbstractEventLoop:
    """Return the event loop by whose clock a fake part lives from its start.

    Raises:
        RuntimeError: There is none: it is made too early.
    """
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        told = (
            f"{type(fake).__name__}: it lives by the clock of the event loop from its "
            "start: make it in the test, or in an `async def` fixture"
        )
        raise RuntimeError(told) from None
