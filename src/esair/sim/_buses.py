"""Buses that are on a wire of the simulation: what a configuration file names."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from esair.buses import (
    CanBus,
    Frame,
    FrameLink,
    I2CBus,
    SerialBus,
    SerialLink,
)
from esair.buses.can import MemoryCan
from esair.buses.i2c import ChipBus
from esair.buses.serial import MemoryLine
from esair.sim._simulation import Simulation


class SimSerialBus(SerialBus):
    """The serial bus, on a line of the simulation.

    Args:
        name: The name of the bus.
        line: ``front`` (range finder) or ``skirt`` (bumper).
        baudrate: Bits per second; a pseudo-terminal does not care.
    """

    def __init__(
        self, *, name: str, line: str = "front", baudrate: int = 115200
    ) -> None:
        super().__init__(name=name, baudrate=baudrate, opener=self._reach)
        self.line = line
        self._simulation: Simulation | None = None

    async def close(self) -> None:
        """Close the bus; the simulation ends with its last bus."""
        await super().close()
        if self._simulation is not None:
            await self._simulation.leave(self)

    async def _reach(self, protocol: asyncio.Protocol) -> SerialLink:
        self._simulation = await Simulation.join(self)
        line = self._simulation.line(self.line)
        line.on_plug(self.arrived)
        if isinstance(line, MemoryLine):
            return await line.open(protocol)
        self.port = str(line.path)
        return await self._open_port(protocol)


class SimCanBus(CanBus):
    """The CAN bus, with the two motor controllers of the simulation on it."""

    def __init__(self, *, name: str) -> None:
        super().__init__(name=name, interface="virtual", opener=self._reach)
        self._simulation: Simulation | None = None

    async def close(self) -> None:
        """Close the bus; the simulation ends with its last bus."""
        await super().close()
        if self._simulation is not None:
            await self._simulation.leave(self)

    async def _reach(
        self, received: Callable[[Frame], None], gone: Callable[[Exception], None]
    ) -> FrameLink:
        self._simulation = await Simulation.join(self)
        wire = self._simulation.drive
        wire.on_plug(self.arrived)
        if isinstance(wire, MemoryCan):
            return await wire.node(received, gone)
        self.channel = wire.channel
        return await wire.node(received, gone, executor=self.executor, stats=self.stats)


class SimI2CBus(I2CBus):
    """The I²C bus, with the inertial unit of the simulation on it."""

    def __init__(self, *, name: str) -> None:
        super().__init__(name=name, opener=self._reach)
        self._simulation: Simulation | None = None

    async def close(self) -> None:
        """Close the bus; the simulation ends with its last bus."""
        await super().close()
        if self._simulation is not None:
            await self._simulation.leave(self)

    def _reach(self) -> ChipBus:
        assert self._simulation is not None
        return self._simulation.body

    async def _open(self) -> None:
        simulation = self._simulation = await Simulation.join(self)
        simulation.body.on_plug(self.arrived)
        # A thread's part in the order of things is chance, which a virtual clock bars.
        self._inline = simulation.in_memory
        await super()._open()
