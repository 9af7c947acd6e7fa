"""All buses of a robot are opened and closed at the same time, each in its time."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

from esair.exceptions import describe
from esair.loop import outside, spawn

if TYPE_CHECKING:
    from esair.buses import Bus

BUS_TIMEOUT = 2.0  # how long a bus may take to open or to close, in seconds

_log = logging.getLogger("esair")


async def open_buses(buses: Iterable[Bus]) -> None:
    """Open buses; one that is not there is tried again by the devices on it."""
    await _each(buses, "open", lambda bus: bus.open(), BUS_TIMEOUT, logging.DEBUG)


async def close_buses(
    buses: Iterable[Bus],
    within: float = BUS_TIMEOUT,
    unless: Callable[[Bus], bool] = lambda _bus: False,
) -> None:
    """Close buses, whatever state they are in; each has so many seconds.

    Whether one is to be left open is asked in the very step in which it is closed.
    """

    async def close(bus: Bus) -> None:
        if not unless(bus):
            await bus.close()

    in_order = sorted(buses, key=lambda bus: bus.name)
    await _each(in_order, "close", close, within, logging.WARNING)


async def _each(
    buses: Iterable[Bus],
    verb: str,
    work: Callable[[Bus], Coroutine[Any, Any, None]],
    within: float,
    level: int,
) -> None:
    async def one(bus: Bus) -> None:
        try:
            async with asyncio.timeout(within):
                await outside((bus.name, f"{verb} the bus"), partial(work, bus))
        except Exception as error:
            _log.log(level, "bus %s: %s: %s", bus.name, verb, describe(error))

    # Whatever factory of tasks the loop has.
    loop = asyncio.get_running_loop()
    tasks = (spawn(loop, one(bus), name="esair bus") for bus in buses)
    await asyncio.gather(*tasks, return_exceptions=True)
