"""The simulation's CAN bus can be pulled out and put back, in memory and in real time."""

from __future__ import annotations

import asyncio

import pytest

import esair
from esair.buses import CanBus, Frame, Inbox
from esair.drivers.wheel_motor import LEFT, feedback_id
from esair.exceptions import DeviceLostError
from esair.sim import SimCanBus, Simulation
from esair.testing import FakeCan


async def take_all(inbox: Inbox[Frame]) -> None:
    """Take frames until the bus is lost."""
    async for _ in inbox:
        pass


async def check_the_adapter() -> None:
    async with Simulation(seed=1) as simulation:
        bus = SimCanBus(name="drive")
        told: list[BaseException] = []
        arrivals: list[bool] = []
        bus.on_lost(told.append)
        bus.on_arrival(lambda: arrivals.append(bus.is_open))
        for n in range(1, 4):
            await bus.open()
            inbox = bus.frames(feedback_id(LEFT))
            await inbox.take(timeout=5)
            simulation.drive.unplug()
            simulation.drive.unplug()
            with pytest.raises(DeviceLostError, match="unplugged"):
                await take_all(inbox)
            with pytest.raises(DeviceLostError, match="unplugged"):
                await bus.open()
            simulation.drive.plug()
            simulation.drive.plug()
            assert (len(told), arrivals) == (n, [False] * n)
        await bus.open()
        await bus.frames(feedback_id(LEFT)).take(timeout=5)
        await bus.close()


@pytest.mark.virtual_clock
async def test_the_adapter_of_the_simulation_in_memory() -> None:
    """A loss each, an arrival each, and frames again."""
    await check_the_adapter()


@pytest.mark.real_clock
async def test_the_adapter_of_the_simulation_on_python_can() -> None:
    """The same with a thread that reads."""
    await check_the_adapter()


class Wheel(esair.Actuator[int]):
    """A wheel that takes its speed in a frame."""

    bus: CanBus
    safe = 0

    async def write(self, command: int) -> None:
        await self.bus.send(0x101, bytes((command,)))


class Meter(esair.Sensor[int]):
    """A meter that answers a frame."""

    bus: CanBus

    async def open(self) -> None:
        self._inbox = self.bus.frames(0x181, length=1)

    async def read(self) -> int:
        await self.bus.send(0x102, b"")
        return (await self._inbox.take(timeout=0.5)).data[0]


class Follow(esair.Behavior):
    """Drives as long as it can."""

    wheel = esair.writes(int)
    meter = esair.reads(int)

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            try:
                await self.wheel.write(await self.meter.read(fresh=True))
            except (DeviceLostError, TimeoutError):
                continue


@pytest.mark.virtual_clock
@pytest.mark.fault("C01")
async def test_a_hundred_times_pulled_and_restored() -> None:
    """Nothing is left behind, and each time the first frame is the safe command."""
    bus = FakeCan("drive")
    bus.answer(0x102, Frame(0x181, b"\x07"))
    robot = esair.Robot(
        resources=[Wheel(bus=bus), Meter(bus=bus)], behaviors=[Follow()]
    )
    async with robot:
        for n in range(100):
            await bus.until(lambda frame: frame.data == b"\x07", timeout=60)
            bus.unplug()
            await asyncio.sleep(0.1)
            bus.sent.clear()
            bus._newest.clear()
            bus.plug()
            await bus.until(0x101, timeout=60)
            assert next(f.data for f in bus.sent if f.id == 0x101) == b"\0"
            assert bus.stats.lost == n + 1
        await bus.until(lambda frame: frame.data == b"\x07", timeout=60)
        assert len(bus._far._robots) == 1
        assert len(bus._routes._filters) == 1
    assert bus.sent[-1].data == b"\0"
