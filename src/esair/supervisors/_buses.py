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

    async def open_bus(bus: Bus) -> None:
        try:
            async with asyncio.timeout(BUS_TIMEOUT):
                await outside((bus.name, "open the bus"), bus.open)
        except Exception as error:
            _log.debug("bus %s: %s", bus.name, describe(error))

    await _all(open_bus(bus) for bus in buses)


async def close_buses(
    buses: Iterable[Bus],
    within: float = BUS_TIMEOUT,
    unless: Callable[[Bus], bool] = lambda _bus: False,
) -> None:
    """Close buses, whatever state they are in; each has so many seconds.

    Whether one is to be left open is asked in the very step in which it is closed.
    """

    async def close_now(bus: Bus) -> None:
        if not unless(bus):
            await bus.close()

    async def close_bus(bus: Bus) -> None:
        try:
            async with asyncio.timeout(within):
                await outside((bus.name, "close the bus"), partial(close_now, bus))
        except Exception as error:
            _log.warning("bus %s: close: %s", bus.name, describe(error))

    await _all(close_bus(bus) for bus in sorted(buses, key=lambda bus: bus.name))


async def _all(work: Iterable[Coroutine[Any, Any, None]]) -> None:
    """Do several things at a time, whatever factory of tasks the loop has."""
    loop = asyncio.get_running_loop()
    tasks = (spawn(loop, each, name="esair bus") for each in work)
    await asyncio.gather(*tasks, return_exceptions=True)
