"""A bus that can say what is there is opened again as soon as it is there."""

from __future__ import annotations

import asyncio
import os
import pty
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.patience import within

import esair
from esair.buses import Bus, I2CBus, SerialBus
from esair.buses.i2c import ChipBus, _kernel
from esair.drivers.servo import ServoBus
from esair.exceptions import DeviceLostError
from esair.messages import ResourceState
from esair.supervisors import _resource_life
from esair.testing import Leaks

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("BUS-2")]

PATIENCE = 60.0


async def until(condition: Callable[[], object]) -> None:
    """Wait for something that another thread does."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        await asyncio.sleep(0.005)


def is_watched() -> bool:
    """Whether anybody waits for anything."""
    return any(each.name == "esair-hotplug" for each in threading.enumerate())


class PluggedBus(Bus):
    """A bus that is there if a test says so, and may be taken by somebody else."""

    def __init__(self) -> None:
        super().__init__(name="arm")
        self.there: object = None
        self.taken = False
        self.tries = 0
        self._presence = lambda: self.there

    async def _open(self) -> None:
        self.tries += 1
        if self.there is None or self.taken:
            raise DeviceLostError(self.name, "not there")

    async def _close(self) -> None: ...

    def pull(self) -> None:
        """Take the wire away."""
        self.there = None
        self.lost(DeviceLostError(self.name, "pulled"))


@pytest.fixture
def bus() -> PluggedBus:
    return PluggedBus()


async def test_an_arrival_is_told_to_who_waits(bus) -> None:
    """Once, after a failed opening; and then nobody looks any more."""
    told = []
    bus.on_arrival(lambda: told.append(1))
    with pytest.raises(DeviceLostError):
        await bus.open()
    assert is_watched()

    bus.there = 1
    await until(lambda: told)
    await bus.open()
    await until(lambda: not is_watched())

    assert told == [1]
    await bus.close()


async def test_who_does_not_wait_costs_no_thread(bus) -> None:
    """Neither an open bus, nor a lost one that nobody listens to, nor a closed one."""
    with pytest.raises(DeviceLostError):
        await bus.open()
    assert not is_watched()

    forget = bus.on_arrival(lambda: None)
    assert is_watched()
    forget()
    await until(lambda: not is_watched())

    bus.on_arrival(lambda: None)
    await until(is_watched)
    await bus.close()
    await until(lambda: not is_watched())


@pytest.mark.promise("BUS-4")
@pytest.mark.fault("D03")
@pytest.mark.longer
async def test_a_wire_that_leaves_unused_is_lost(bus) -> None:
    """Within a second, told once; then its arrival is waited for, and the next leave."""
    told: list[object] = []
    bus._still_there = lambda: bus.there is not None
    bus.on_lost(told.append)
    bus.on_arrival(lambda: told.append("arrived"))
    for _ in range(2):
        bus.there = object()
        await bus.open()
        await asyncio.sleep(0.4)
        assert told == []
        bus.there = None
        begin = time.monotonic()
        await until(lambda: told)
        assert within(3.0, time.monotonic() - begin)
        assert "unplugged" in str(told)
        assert not bus.is_open
        bus.there = object()
        await until(lambda: told[-1] == "arrived")
        assert len(told) == 2
        told.clear()
    bus.on_arrival(lambda: None)
    await bus.close()
    await until(lambda: not is_watched())


@pytest.mark.promise("BUS-4")
async def test_a_chip_bus_that_is_pulled_is_noticed_without_a_transfer(
    tmp_path, monkeypatch
) -> None:
    """An I²C adapter by its device file; a changed permission is no departure."""
    place = tmp_path / "i2c-7"
    place.touch()
    monkeypatch.setattr(_kernel, "open_bus", lambda _path, pec: ChipBus({}))
    bus = I2CBus(name="chips", bus=str(place))
    lost: list[BaseException] = []
    bus.on_lost(lost.append)
    await bus.open()
    place.chmod(0o600)
    await asyncio.sleep(0.6)
    assert lost == []
    place.unlink()
    await until(lambda: lost)
    assert bus.stats.lost == 1
    assert not bus.is_open
    await bus.close()


async def test_a_wire_that_was_never_away_is_no_arrival(bus) -> None:
    """It was lost for another reason; trying again at once would be a hot loop."""
    told = []
    bus.on_arrival(lambda: told.append(1))
    bus.there = "port 1"
    await bus.open()

    bus.lost(DeviceLostError("arm", "hung up"))
    await asyncio.sleep(0.6)
    assert told == []

    bus.there = "port 2"
    await until(lambda: told)
    await bus.close()


async def test_what_arrives_while_it_is_opened_is_an_arrival(bus) -> None:
    """The place was looked at before the opening, which failed too early."""
    told = []
    bus.on_arrival(lambda: told.append(1))
    open_wire = bus._open

    async def late() -> None:
        try:
            await open_wire()
        finally:
            bus.there = 1

    bus._open = late
    with pytest.raises(DeviceLostError):
        await bus.open()
    await until(lambda: told)
    await bus.close()


@pytest.fixture
def long_pauses(monkeypatch) -> None:
    """Between two tries lies the longest pause, from the first one on."""
    monkeypatch.setattr(_resource_life, "FIRST_DELAY", _resource_life.MAX_DELAY)


class Heard(esair.Sensor[int]):
    """Something on the bus."""

    async def read(self) -> int:
        return 1


async def settle(robot: esair.Robot, name: str, state: ResourceState) -> None:
    await until(lambda: robot.resources.query(name).state is state)


@pytest.mark.fault("D03", "D04")
@pytest.mark.longer
async def test_a_device_is_back_at_once(long_pauses) -> None:
    """Not at the end of a pause that has grown to seconds."""
    leaks = Leaks()
    bus = PluggedBus()
    bus.there = 1
    async with esair.Robot(resources=[Heard(name="ear", bus=bus)]) as robot:
        await settle(robot, "ear", ResourceState.READY)
        for round_ in range(2, 5):
            bus.pull()
            await settle(robot, "ear", ResourceState.LOST)
            await asyncio.sleep(0.1)
            begin = time.monotonic()
            bus.there = round_
            await settle(robot, "ear", ResourceState.READY)
            assert within(3.0, time.monotonic() - begin)
        bus.pull()
    assert await leaks.check(PATIENCE) == []


@pytest.mark.fault("D07", "O17")
@pytest.mark.longer
async def test_a_wire_that_is_taken_is_not_tried_in_a_hot_loop() -> None:
    """It is there all the time; that its permissions change is a reason to try."""
    bus = PluggedBus()
    bus.there, bus.taken = ("port", 1), True
    async with esair.Robot(resources=[Heard(name="ear", bus=bus)]) as robot:
        await until(lambda: bus.tries >= 4)  # after 0.1, 0.2 and 0.4 s
        tries = bus.tries
        await asyncio.sleep(0.5)
        assert bus.tries <= tries + 1

        bus.taken, bus.there = False, ("port", 2)  # another ctime
        begin = time.monotonic()
        await settle(robot, "ear", ResourceState.READY)
        assert within(3.0, time.monotonic() - begin)


class Pulled:
    """A serial device behind a link, that can be pulled and put in again."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.master = self.slave = -1

    def plug(self) -> None:
        """Put it in: another terminal under the same name."""
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.link.symlink_to(os.ttyname(self.slave))

    def pull(self) -> None:
        """Take it and its name away."""
        if self.master < 0:
            return
        self.link.unlink()
        os.close(self.master)
        os.close(self.slave)
        self.master = self.slave = -1

    def read(self) -> bytes:
        """Take what the robot has sent."""
        try:
            return os.read(self.master, 4096)
        except BlockingIOError:
            return b""


@pytest.fixture
def pulled(tmp_path) -> Iterator[Pulled]:
    device = Pulled(tmp_path / "ttyARM")
    yield device
    device.pull()


class Motor(esair.Actuator[int]):
    """One byte is one command."""

    safe = 0

    async def write(self, command: int) -> None:
        await self.bus.send(bytes([command]))


@pytest.mark.promise("BUS-4")
async def test_a_servo_line_that_is_pulled_is_noticed_without_a_request(pulled) -> None:
    """It is a serial line like any other."""
    pulled.plug()
    bus = ServoBus(name="arm", port=str(pulled.link))
    lost: list[BaseException] = []
    bus.on_lost(lost.append)
    await bus.open()
    await asyncio.sleep(0.6)
    assert lost == []
    pulled.pull()
    await until(lambda: lost)
    await bus.close()


@pytest.mark.fault("D03", "D04", "D06", "D19")
@pytest.mark.longer
async def test_a_serial_line_is_back_as_soon_as_its_name_is(
    pulled, long_pauses
) -> None:
    """Pulled while idle, renumbered, back: the first it hears is its safe command."""
    leaks = Leaks()
    pulled.plug()
    bus = SerialBus(name="line", port=str(pulled.link), framing="raw")
    motor = Motor(name="motor", bus=bus)
    async with esair.Robot(resources=[motor]) as robot:
        await settle(robot, "motor", ResourceState.READY)
        for _ in range(5):
            pulled.pull()
            await settle(robot, "motor", ResourceState.LOST)
            await asyncio.sleep(0.1)
            pulled.plug()
            begin = time.monotonic()
            await settle(robot, "motor", ResourceState.READY)
            assert within(3.0, time.monotonic() - begin)
            heard = b""
            while not heard:
                heard = pulled.read()
                await asyncio.sleep(0.01)
            assert set(heard) == {0}
    assert bus.stats.lost == 5
    pulled.pull()
    assert await leaks.check(PATIENCE) == []
