"""SYNC: one producer on each bus, in the event loop, so that it ends when that hangs."""

from __future__ import annotations

import asyncio

from esair.buses import CanBus
from esair.drivers._on_bus import SharedTask, shared
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.resources import Resource

SYNC = 0x80


class Sync(SharedTask):
    """The producer of SYNC on a bus, while at least one device wants it."""

    def __init__(self, bus: CanBus, period: float) -> None:
        super().__init__(bus)
        self.period = period

    def join(self, device: Resource) -> None:
        """Produce for a device, too."""
        self.begin(device, self._send)

    async def leave(self, device: Resource) -> None:
        """Produce for a device no more; after the last one any period will do."""
        bus = self._bus()
        if bus is not None and self._users.keys() <= {device}:
            shared(bus, Sync).pop(SYNC, None)
        await super().leave(device)

    async def _send(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while (bus := self._bus()) is not None:
            assert isinstance(bus, CanBus)
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
