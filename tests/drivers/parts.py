"""The far end of a driver in its contract suite: how its part loses its power."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest


class Powered:
    """A part, ``far``, that says nothing while it is ``silent``."""

    far: Any

    async def silence(self, _device: Any) -> None:
        self.far.silent = True

    async def speak(self, _device: Any) -> None:
        self.far.silent = False

    async def power_cycle(self, _device: Any) -> None:
        self.far.power_cycle()


class Plugged(Powered):
    """One that is not there while it has no power."""

    async def unplug(self, _device: Any) -> None:
        self.far.unplug()

    silence = unplug

    async def speak(self, _device: Any) -> None:
        self.far.plug()


class OnCan(Powered):
    """A node on a bus, ``wire``, that is made with the device."""

    wire: Any

    @pytest.fixture(autouse=True)
    def _wire(self, fake_can: Callable[..., Any]) -> None:
        self.wire = fake_can("drive")

    async def unplug(self, _device: Any) -> None:
        self.wire.unplug()


class OnChip:
    """A chip on a fake I2C bus."""

    async def silence(self, device: Any) -> None:
        device.bus.silent(device.address)

    async def speak(self, device: Any) -> None:
        device.bus.silent(device.address, silent=False)

    async def power_cycle(self, device: Any) -> None:
        device.bus.chips[device.address].power_cycle()


class OnServos:
    """Servos on one line."""

    fakes: Any

    async def unplug(self, _device: Any) -> None:
        self.fakes.unplug()

    async def plug(self, _device: Any) -> None:
        self.fakes.plug()

    async def silence(self, _device: Any) -> None:
        self.fakes.stall()

    async def speak(self, _device: Any) -> None:
        self.fakes.resume()

    stall, resume = silence, speak

    async def power_cycle(self, _device: Any) -> None:
        self.fakes.power_cycle()


@asynccontextmanager
async def opened(*devices: Any) -> AsyncIterator[Any]:
    """Open devices and their bus, and close all of them; gives the first."""
    bus = devices[0].bus
    await bus.open()
    try:
        for device in devices:
            await device.open()
        yield devices[0]
    finally:
        for device in devices:
            await device.close()
        await bus.close()
