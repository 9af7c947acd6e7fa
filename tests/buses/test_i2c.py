"""The I²C bus on fake masters."""

from __future__ import annotations

import asyncio
import errno
import os
import threading
import time
from collections.abc import Callable, Sequence

import pytest

from esair.buses import I2CBus, RegisterLink
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)


class Master:
    """A master that selects the chip and transfers in two steps, as the kernel does."""

    def __init__(self) -> None:
        self.address = 0
        self.wrong = 0
        self.calls = 0
        self.failures: list[int] = []
        self.blocks: threading.Event | None = None
        self.threads: set[str] = set()
        self.closed = False

    def _transfer(self, address: int, register: int) -> int:
        self.calls += 1
        self.threads.add(threading.current_thread().name)
        if self.failures:
            code = self.failures.pop(0)
            raise OSError(code, os.strerror(code))
        if self.blocks is not None:
            self.blocks.wait(5)
        self.address = address
        time.sleep(0)  # here another thread may select another chip
        self.wrong += self.address != address
        return (address + register) % 256

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        return self._transfer(i2c_addr, register)

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        self._transfer(i2c_addr, register)

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        return [self._transfer(i2c_addr, register) for _ in range(length)]

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        self._transfer(i2c_addr, register)

    def close(self) -> None:
        self.closed = True


def bus_of(master: Master, **options: object) -> I2CBus:
    """Make a bus whose link is a fake."""
    opener: Callable[[], RegisterLink] = lambda: master  # noqa: E731 - typed
    return I2CBus(name="body", opener=opener, **options)  # type: ignore[arg-type]


@pytest.mark.real_clock
@pytest.mark.fault("I05")
async def test_no_transfer_reaches_another_chip() -> None:
    """Address and transfer are never torn apart, however many ask at once."""
    master = Master()
    bus = bus_of(master)
    await bus.open()

    async def ask(address: int) -> None:
        for register in range(250):
            assert await bus.read(address, register) == bytes(
                [(address + register) % 256]
            )

    await asyncio.gather(*(ask(address) for address in (0x10, 0x20, 0x30, 0x40)))

    assert master.wrong == 0
    assert master.calls == 1000
    assert len(master.threads) == 1
    await bus.close()
    assert master.closed


@pytest.mark.real_clock
@pytest.mark.fault("I07")
async def test_a_transaction_is_not_interrupted() -> None:
    """Transfers that belong together have nothing of anybody else in between."""
    order: list[str] = []

    class Noting(Master):
        def read_byte_data(self, i2c_addr: int, register: int) -> int:
            order.append(f"{i2c_addr:#x}")
            time.sleep(0.001)
            return 0

    bus = bus_of(Noting())
    await bus.open()

    def thrice(link: RegisterLink, address: int) -> None:
        for _ in range(3):
            link.read_byte_data(address, 0)

    await asyncio.gather(
        bus.transaction(lambda link: thrice(link, 0x10)),
        bus.transaction(lambda link: thrice(link, 0x20)),
    )

    assert order == ["0x10"] * 3 + ["0x20"] * 3
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("code", "text"),
    [
        pytest.param(errno.ENXIO, "does not answer", marks=pytest.mark.fault("I01")),
        pytest.param(
            errno.EREMOTEIO, "does not answer", marks=pytest.mark.fault("I01")
        ),
        pytest.param(errno.EIO, "failed", marks=pytest.mark.fault("I02")),
        pytest.param(errno.EBADMSG, "failed", marks=pytest.mark.fault("I02")),
        pytest.param(errno.ETIMEDOUT, "failed", marks=pytest.mark.fault("I04")),
        pytest.param(
            errno.EBUSY, "driver of the kernel", marks=pytest.mark.fault("I06")
        ),
    ],
)
async def test_a_failed_transfer_is_a_fault_of_the_device(code: int, text: str) -> None:
    """It names the chip; it is not repeated, and the bus stays open."""
    master = Master()
    bus = bus_of(master, inline=True)
    await bus.open()
    master.failures = [code]

    with pytest.raises(DeviceFaultError, match=text):
        await bus.read(0x68, 0x75)

    assert master.calls == 1
    assert bus.is_open
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("I03")
async def test_a_lost_arbitration_is_repeated_a_few_times() -> None:
    """Another master's transfer costs a pause, not the reading."""
    master = Master()
    bus = bus_of(master, inline=True)
    await bus.open()

    master.failures = [errno.EAGAIN] * 3
    assert await bus.read(0x68, 0x75) == bytes([0xDD])
    assert bus.arbitrations == 3
    master.failures = [errno.EAGAIN] * 9
    with pytest.raises(DeviceFaultError):
        await bus.read(0x68, 0x75)

    assert len(master.failures) == 5
    await bus.close()


@pytest.mark.virtual_clock
async def test_an_adapter_that_is_gone_is_a_loss_of_the_bus() -> None:
    """Everybody on the bus learns of it, not only who asked."""
    master = Master()
    bus = bus_of(master, inline=True)
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    master.failures = [errno.ENODEV]

    with pytest.raises(DeviceLostError):
        await bus.read(0x68, 0x75)

    assert len(told) == 1
    with pytest.raises(DeviceLostError, match="not open"):
        await bus.read(0x68, 0x75)
    await bus.open()
    assert await bus.read(0x68, 0x75) == bytes([0xDD])
    await bus.close()


@pytest.mark.real_clock
async def test_a_transfer_that_hangs_costs_its_deadline() -> None:
    """The event loop goes on; who asked gets an error in time."""
    master = Master()
    bus = bus_of(master, timeout=0.05)
    await bus.open()
    master.blocks = threading.Event()
    loop = asyncio.get_running_loop()
    begin = loop.time()

    with pytest.raises(DriverStuckError):
        await bus.read(0x68, 0x75)

    assert loop.time() - begin < 0.5
    master.blocks.set()
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("address", "register", "length", "field"),
    [(0x02, 0, 1, "address"), (0x78, 0, 1, "address"), (0x68, 256, 1, "register"),
     (0x68, 0, 0, "length"), (0x68, 0, 33, "length")],
)  # fmt: skip
async def test_what_is_no_transfer_is_not_made(
    address: int, register: int, length: int, field: str
) -> None:
    """The error names the part that is wrong."""
    master = Master()
    bus = bus_of(master, inline=True)
    await bus.open()

    with pytest.raises(BadValueError) as caught:
        await bus.read(address, register, length)

    assert caught.value.field == field
    assert master.calls == 0
    await bus.close()


@pytest.mark.real_clock
async def test_a_bus_that_is_not_there_is_lost() -> None:
    """The kernel's bus is opened in the thread; its error names the bus."""
    bus = I2CBus(name="body", bus=250)
    with pytest.raises(DeviceLostError, match="'body'"):
        await bus.open()
    await bus.close()


def test_a_bus_has_a_number() -> None:
    """Nothing is opened to find out."""
    with pytest.raises(ConfigError, match="dev/i2c"):
        I2CBus(name="body", bus=-1)
