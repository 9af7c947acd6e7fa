"""A bus is closed with its last device: what comes next may want its port."""

from __future__ import annotations

import asyncio
from functools import partial

import pytest

import esair
from esair.buses import SerialBus
from esair.buses.serial import MemoryLine
from esair.messages import ResourceState
from esair.testing import VirtualLoop


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


@pytest.mark.virtual_clock
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


@pytest.mark.virtual_clock
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


async def added_beside(turns: int) -> tuple[ResourceState, int, bool]:
    """Remove the last device of a bus; add another one to it so many turns later."""
    bus = SerialBus(wire=wired(), name="shared")
    async with esair.Robot(resources=[scale("left", bus)]) as robot:
        await asyncio.sleep(0.05)
        removed = asyncio.ensure_future(robot.resources.remove("left"))
        for _ in range(turns):
            await asyncio.sleep(0)
        await robot.resources.add(scale("right", bus))
        await removed
        status = robot.resources.query("right")
        return status.state, status.losses, bus.is_open


@pytest.mark.promise("BUS-1", "RS-3")
@pytest.mark.parametrize("turns", range(3, 8))
def test_one_that_is_added_as_the_last_one_goes_has_an_open_bus(turns: int) -> None:
    """In every order; one in twenty was READY on a bus that was closed under it."""
    for seed in range(1, 16):
        with asyncio.Runner(loop_factory=partial(VirtualLoop, seed=seed)) as loop:
            assert loop.run(added_beside(turns)) == (ResourceState.READY, 0, True)


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-1", "ROB-2")
async def test_the_stop_closes_the_bus_of_what_came_later() -> None:
    """A bus that no device of the start was on; it is counted as the others are."""
    bus = SerialBus(wire=wired(), name="later")

    async with esair.Robot() as robot:
        await robot.resources.add(scale("scale", bus))
        await asyncio.sleep(0.1)
        assert bus.is_open
        assert "bus later" in robot.journal.counts()

    assert not bus.is_open
