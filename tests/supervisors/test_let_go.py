"""A bus is closed with its last device: what comes next may want its port."""

from __future__ import annotations

import asyncio

import pytest

import esair
from esair.buses import SerialBus
from esair.buses.serial import MemoryLine
from esair.messages import ResourceState


class Scale(esair.Sensor[float]):
    """Asks a scale on a serial line."""

    rate = 20.0

    async def read(self) -> float:
        return float(await self.bus.ask(b"?"))


def scale(name: str, bus: SerialBus) -> Scale:
    made = Scale(name=name)
    made.bus = bus
    return made


def wired() -> MemoryLine:
    """Return a line with a scale at its far end."""
    line = MemoryLine("scale")
    line.heard = lambda data: line.write(b"1.5\n" * data.count(b"?"))
    line.plug()
    return line


@pytest.mark.promise("BUS-1", "RS-3")
async def test_another_bus_gets_the_port_of_the_one_that_was_replaced() -> None:
    """The port has one owner at a time, and is free when that one goes."""
    line = wired()
    old, new = (SerialBus(wire=line, name=name) for name in ("old", "new"))

    async with esair.Robot(resources=[scale("scale", old)]) as robot:
        await asyncio.sleep(0.1)
        await robot.resources.replace("scale", scale("scale", new))
        await asyncio.sleep(0.1)

        status = robot.resources.query("scale")
        assert status.state is ResourceState.READY
        assert (old.is_open, new.is_open) == (False, True)


@pytest.mark.promise("BUS-1")
async def test_a_bus_is_open_as_long_as_one_of_its_devices_is_there() -> None:
    """The last one that is removed closes it, and the next one opens it again."""
    bus = SerialBus(wire=wired(), name="shared")
    resources = [scale("left", bus), scale("right", bus)]

    async with esair.Robot(resources=resources) as robot:
        await asyncio.sleep(0.1)
        seen = [bus.is_open]
        for name in ("left", "right"):
            await robot.resources.remove(name)
            seen.append(bus.is_open)
        await robot.resources.add(scale("left", bus))
        await asyncio.sleep(0.1)

        assert seen == [True, True, False]
        assert bus.is_open
        assert robot.resources.query("left").state is ResourceState.READY
