"""SYNC: one producer on each bus, in the event loop, so that it ends when that hangs."""

from __future__ import annotations

import asyncio
import weakref

from esair.buses import CanBus
from esair.drivers._on_bus import ended, shared
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.resources import Resource

SYNC = 0x80


class Sync:
    """The producer of SYNC on a bus, while at least one device wants it."""

    def __init__(self, bus: CanBus, period: float) -> None:
        self.period = period
        self._bus = weakref.ref(bus)
        self._users: set[Resource] = set()
        self._sending: asyncio.Task[None] | None = None

    def join(self, device: Resource) -> None:
        """Produce for a device, too."""
        self._users.add(device)
        if self._sending is None or self._sending.done():
            self._sending = asyncio.get_running_loop().create_task(
                self._send(), name=f"{device.name} sync"
            )

    async def leave(self, device: Resource) -> None:
        """Produce for a device no more; after the last one not at all."""
        self._users.discard(device)
        if self._users:
            return
        task, self._sending = self._sending, None
        bus = self._bus()
        if bus is not None and shared(bus, Sync).get(SYNC) is self:
            del shared(bus, Sync)[SYNC]
        await ended(task)

    async def _send(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while (bus := self._bus()) is not None:
            try:
                await bus.send(SYNC, b"", replaces=True, timeout=self.period)
            except DeviceLostError:
                return
            except (BusyError, DeviceFaultError, DriverStuckError):
                pass  # the next one comes soon; the bus counts
            del bus
            due = max(due + self.period, loop.time())
            await asyncio.sleep(due - loop.time())


def sync_of(device: Resource, bus: CanBus, period: float) -> Sync:
    """Return the producer of a bus; a `ConfigError` if it has another period."""
    found = shared(bus, Sync).setdefault(SYNC, Sync(bus, period))
    if found.period != period:
        raise ConfigError(
            device.name, "sync", f"the bus has a SYNC every {found.period:g} s already"
        )
    return found
