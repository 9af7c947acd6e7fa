"""I²C of a real kernel: i2c-stub, which has SMBus only, and an emulated USB adapter."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.buses import I2CBus, RegisterLink
from esair.buses.i2c import _kernel as kernel
from esair.drivers.adafruit import AdafruitSensor
from esair.drivers.mpu6050 import GRAVITY, IDENTITY, WHO_AM_I, Motion, Mpu6050
from esair.drivers.mpu6050.fake import FakeMpu6050
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
)
from esair.testing import BusContract

pytestmark = pytest.mark.real_clock
with_usb = pytest.mark.kernel("built")

PATIENCE = 30.0
"""The guest has one slow processor."""

TIMEOUT = 2.0

TINY = "name:i2c-tiny-usb"


async def until(condition: Callable[[], Any]) -> Any:
    """Wait until something is so."""
    async with asyncio.timeout(PATIENCE):
        while not (found := condition()):  # noqa: ASYNC110 - the kernel does not tell
            await asyncio.sleep(0.02)
        return found


def stub() -> str:
    """Return the path of the stub's bus."""
    names = kernel.adapters().items()
    return next(f"/dev/i2c-{number}" for number, name in names if "stub" in name)


class TestStub(BusContract):
    """An adapter of the kernel that has the calls of SMBus, and no plain I²C."""

    longest_stall = 3.0  # one slow processor has the kernel and all processes

    def make(self) -> I2CBus:
        return I2CBus(name="stub", bus=stub(), timeout=TIMEOUT)

    async def use(self, bus: Any) -> None:
        await bus.write(0x48, 0x20, b"\x12")
        assert await bus.read(0x48, 0x20) == b"\x12"
        await bus.write(0x50, 0x10, b"abcd")
        assert await bus.transfer(0x50, b"\x10", read=4) == b"abcd"

    async def ask(self, bus: Any, number: int) -> int:
        await bus.write(0x50, number, bytes([number]))
        return int((await bus.read(0x50, number))[0])

    async def delay(self, bus: Any, seconds: float) -> None:
        assert await self.ask(bus, 1) == 1, "nothing can be late in the kernel itself"


@pytest.fixture
async def stub_bus() -> Any:
    """An open bus of the stub."""
    bus = I2CBus(name="stub", bus=stub(), timeout=TIMEOUT)
    await bus.open()
    yield bus
    await bus.close()


async def test_a_chip_that_is_not_there_is_no_loss_of_the_bus(stub_bus) -> None:
    """The stub says ENODEV of it, as others do when the adapter is gone."""
    with pytest.raises(DeviceFaultError, match="chip 0x33 does not answer") as caught:
        await stub_bus.read(0x33, 0)

    assert caught.value.errno == errno.ENODEV
    assert stub_bus.is_open
    await stub_bus.write(0x48, 0, b"\x01")


async def test_transfers_without_plain_i2c(stub_bus) -> None:
    """What SMBus can do is done; the rest says what is missing."""
    await stub_bus.transfer(0x50, bytes([0x40, *range(32)]))
    assert await stub_bus.read(0x50, 0x40, 32) == bytes(range(32))
    await stub_bus.transfer(0x50, b"\x42")
    assert await stub_bus.transfer(0x50, read=1) == b"\x02"

    with pytest.raises(DeviceFaultError, match="SMBus only"):
        await stub_bus.transfer(0x50, read=2)


async def test_a_scan_finds_the_chips(stub_bus) -> None:
    """Those of i2c-stub, and no other."""
    assert await stub_bus.scan() == dict.fromkeys((0x20, 0x48, 0x50), "answers")


async def test_a_checksum_that_the_adapter_does_not_know_is_told() -> None:
    """i2c-stub has none; the bus does not open without it."""
    bus = I2CBus(name="stub", bus=stub(), timeout=TIMEOUT, pec=True)
    with pytest.raises(DeviceLostError, match="PEC"):
        await bus.open()
    await bus.close()


@pytest.mark.fault("I06")
async def test_a_chip_of_a_driver_of_the_kernel_is_left_alone(stub_bus) -> None:
    """Registers, transfers and scans are refused until the driver lets it go."""
    number = stub().removeprefix("/dev/i2c-")
    adapter = Path(f"/sys/bus/i2c/devices/i2c-{number}")
    with contextlib.ExitStack() as ends:
        # Any address may be given to a driver; without one the chip is reserved only.
        (adapter / "new_device").write_text("dummy 0x48\n")
        ends.callback((adapter / "delete_device").write_text, "0x48\n")
        device = Path(f"/sys/bus/i2c/devices/{number}-0048")
        if not (device / "driver").exists():
            pytest.skip("this kernel has no driver 'dummy' for I²C")

        for use in (
            lambda: stub_bus.read(0x48, 0),
            lambda: stub_bus.write(0x48, 0, b"\x01"),
            lambda: stub_bus.transfer(0x48, b"\x00", read=1),
        ):
            with pytest.raises(DeviceFaultError, match="unbind") as caught:
                await use()
            assert caught.value.errno == errno.EBUSY
        assert (await stub_bus.scan([0x48, 0x50])) == {0x48: "busy", 0x50: "answers"}
        assert stub_bus.stats.retries == 0
        await stub_bus.write(0x50, 0, b"\x01")

    await stub_bus.write(0x48, 0, b"\x02")


class Chip:
    """A chip of the emulated adapter, from one with registers."""

    def __init__(self, chip: Any) -> None:
        self._chip = chip
        self._pointer = 0

    def write(self, data: bytes) -> None:
        if data:
            self._pointer = data[0]
            if data[1:]:
                self._chip.write(data[0], data[1:])

    def read(self, count: int) -> bytes:
        return bytes(self._chip.read(self._pointer, count))


@pytest.fixture
def adapter() -> Iterator[Any]:
    """A USB adapter with two chips, plugged in."""
    sys.path.insert(0, str(Path(__file__).parent / "hw"))
    from usb_parts import (  # type: ignore[import-not-found]
        I2cAdapter,
        RegisterChip,
    )

    felt = Motion((1.0, -2.0, GRAVITY), (0.5, -1.0, 2.0), 30.0)
    chips = {0x68: Chip(FakeMpu6050(felt)), 0x50: RegisterChip(bytes(range(256)))}
    with I2cAdapter(chips) as adapter:
        wait_for_tiny(there=True)
        yield adapter
    adapter._pipe.close()


def tiny() -> bool:
    """Tell whether the adapter is there, with its place in ``/dev``."""
    with contextlib.suppress(OSError):
        return Path(kernel.find(TINY)).exists()
    return False


def wait_for_tiny(*, there: bool) -> None:
    end = time.monotonic() + PATIENCE
    while tiny() != there:
        assert time.monotonic() < end, "the adapter does not come or go"
        time.sleep(0.02)


def tiny_bus(**options: Any) -> I2CBus:
    return I2CBus(name="tiny", bus=TINY, **{"timeout": TIMEOUT, **options})


@with_usb
class TestUsbAdapter(BusContract):
    """An adapter with plain I²C that is pulled out, found again by its name."""

    longest_stall = 3.0  # one slow processor has the kernel and all processes

    @pytest.fixture(autouse=True)
    def _plugged(self, adapter) -> None:
        self.adapter = adapter

    def make(self) -> I2CBus:
        return tiny_bus(timeout=0.5)

    async def use(self, bus: Any) -> None:
        await bus.write(0x50, 0x80, b"\x12\x34")
        assert await bus.transfer(0x50, b"\x80", read=2) == b"\x12\x34"

    async def unplug(self, bus: Any) -> None:
        await asyncio.to_thread(self.adapter.unplug)

    async def plug(self, bus: Any) -> None:
        await asyncio.to_thread(self._plug)

    def _plug(self) -> None:
        wait_for_tiny(there=False)
        self.adapter.plug()
        wait_for_tiny(there=True)

    async def stall(self, bus: Any) -> None:
        await asyncio.to_thread(self.adapter.tell, "slow", 1.0)

    async def resume(self, bus: Any) -> None:
        await asyncio.to_thread(self.adapter.tell, "slow", 0.0)

    async def ask(self, bus: Any, number: int) -> int:
        return int((await bus.transfer(0x50, bytes([number]), read=1))[0])

    async def delay(self, bus: Any, seconds: float) -> None:
        await asyncio.to_thread(self.adapter.tell, "slow", seconds)


@with_usb
async def test_long_transfers(adapter) -> None:
    """More than SMBus can carry, with a repeated start."""
    bus = tiny_bus()
    await bus.open()

    assert await bus.transfer(0x50, b"\x20", read=40) == bytes(range(0x20, 0x48))
    await bus.transfer(0x50, bytes([0x90, *range(40)]))
    assert await bus.read(0x50, 0x98, 32) == bytes(range(8, 40))
    await bus.close()


@with_usb
@pytest.mark.fault("I01")
async def test_a_chip_that_does_not_acknowledge(adapter) -> None:
    """What is idempotent is repeated, what is not is told; it is no loss of the bus."""
    bus = tiny_bus()
    await bus.open()
    await asyncio.to_thread(adapter.tell, "silent", 0x50)

    with pytest.raises(DeviceFaultError, match="chip 0x50 does not answer") as caught:
        await bus.write(0x50, 0, b"\x01")
    assert caught.value.errno == errno.ENXIO
    assert bus.stats.retries == 0
    with pytest.raises(DeviceFaultError):
        await bus.read(0x50, 0)
    assert bus.stats.retries == 3
    assert await bus.read(0x68, WHO_AM_I) == bytes([IDENTITY])

    await asyncio.to_thread(adapter.tell, "answer", 0x50)
    assert await bus.read(0x50, 7) == b"\x07"
    assert await bus.scan() == {0x50: "answers", 0x68: "answers"}
    await bus.close()


@with_usb
@pytest.mark.fault("I04", "D20")
async def test_a_slow_chip_costs_its_user_and_not_the_loop(adapter) -> None:
    """The bus is stuck for as long as the kernel waits, and good afterwards."""
    bus = tiny_bus(timeout=0.3)
    await bus.open()
    await asyncio.to_thread(adapter.tell, "slow", 1.8)
    loop = asyncio.get_running_loop()
    begin, turns = loop.time(), 0

    reading = asyncio.ensure_future(bus.read(0x50, 0))
    while not reading.done():
        await asyncio.sleep(0.01)
        turns += 1
    with pytest.raises(DriverStuckError):
        reading.result()
    assert loop.time() - begin < 1.75
    assert turns > 5
    with pytest.raises(DriverStuckError, match="an earlier transfer"):
        await bus.read(0x68, WHO_AM_I)

    await asyncio.to_thread(adapter.tell, "slow", 0.0)
    await until(lambda: bus.stuck_since is None)
    assert await bus.read(0x50, 9, timeout=TIMEOUT) == b"\x09"
    await bus.close()


@with_usb
@pytest.mark.promise("BUS-4")
async def test_an_unplug_inside_a_transfer_is_a_loss(adapter) -> None:
    """Whatever number the kernel gives for a transfer that was cut."""
    bus = tiny_bus()
    lost: list[BaseException] = []
    bus.on_lost(lost.append)
    await bus.open()
    await asyncio.to_thread(adapter.tell, "slow", 0.5)
    reading = asyncio.ensure_future(bus.read(0x50, 0))
    await asyncio.sleep(0.2)

    await asyncio.to_thread(adapter.unplug)

    with pytest.raises(DeviceLostError):
        await reading
    assert len(lost) == 1
    await bus.close()


@with_usb
@pytest.mark.promise("BUS-4")
async def test_an_adapter_that_leaves_unused_is_lost(adapter) -> None:
    """Nobody reads or writes; its arrival is waited for then."""
    bus = tiny_bus()
    lost: list[BaseException] = []
    bus.on_lost(lost.append)
    await bus.open()
    await asyncio.sleep(0.6)
    assert lost == []

    await asyncio.to_thread(adapter.unplug)

    await until(lambda: lost)
    assert not bus.is_open
    await bus.close()


@with_usb
@pytest.mark.fault("I07")
async def test_transactions_are_whole(adapter) -> None:
    """Many tasks count in two registers of a chip, and none is lost."""
    bus = tiny_bus(timeout=PATIENCE)
    await bus.open()
    await bus.write(0x50, 0, b"\x00\x00")

    def count(link: RegisterLink) -> None:
        high, low = (link.read_byte_data(0x50, register) for register in (0, 1))
        value = (high << 8 | low) + 1
        link.write_i2c_block_data(0x50, 0, list(value.to_bytes(2, "big")))

    async def work() -> None:
        for _ in range(10):
            await bus.transaction(count, address=0x50)

    await asyncio.gather(*(work() for _ in range(4)))

    assert await bus.read(0x50, 0, 2) == (40).to_bytes(2, "big")
    await bus.close()


@with_usb
@pytest.mark.fault("D01", "D04", "D06")
async def test_a_robot_finds_its_adapter_again_by_name(adapter) -> None:
    """The sensor is lost, and back as soon as the adapter is, whatever its number is."""
    bus = tiny_bus()
    imu = Mpu6050(name="imu", bus=bus, rate=10.0)
    imu.deadline = PATIENCE
    user = esair.Behavior(
        name="user", reads={"imu": esair.reads(Motion, max_age=5.0)}, writes={}
    )

    async with esair.Robot(resources=[imu], behaviors=[user]) as robot:

        def is_ready() -> bool:
            return robot.resources.query("imu").state is esair.ResourceState.READY

        await until(is_ready)
        for _ in range(2):
            motion = await user.imu.read(fresh=True, timeout=PATIENCE)
            assert motion.acceleration == pytest.approx((1.0, -2.0, GRAVITY), abs=0.01)
            await asyncio.to_thread(adapter.unplug)
            async with asyncio.timeout(PATIENCE):
                while is_ready():
                    with contextlib.suppress(EsairError):
                        await user.imu.read(fresh=True, timeout=1.0)
            await asyncio.to_thread(wait_for_tiny, there=False)
            await asyncio.to_thread(adapter.plug)
            await until(is_ready)
        assert (await user.imu.read(fresh=True, timeout=PATIENCE)).temperature > 29.0


@with_usb
async def test_an_adafruit_driver_on_a_real_kernel(adapter) -> None:
    """adafruit_mpu6050 resets, wakes and reads the chip through the adapter."""
    bus = tiny_bus(timeout=PATIENCE)
    await bus.open()
    sensor = AdafruitSensor(
        library="adafruit_mpu6050:MPU6050",
        value=["acceleration", "temperature"],
        bus=bus,
    )

    await bus.executor.call(sensor.open, timeout=PATIENCE)
    values = await bus.executor.call(sensor.read, timeout=PATIENCE)

    assert values["acceleration"] == pytest.approx((1.0, -2.0, GRAVITY), abs=0.01)
    assert values["temperature"] == pytest.approx(30.0, abs=0.01)
    await bus.close()
