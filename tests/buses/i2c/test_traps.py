"""The traps of bare smbus2, shown, and shown to be absent through esair.

A fake of the kernel's two calls stands below the real smbus2: one selects the chip,
the other transfers with whatever chip is selected by then. Between them another thread
may run, as it may in the kernel.
"""

from __future__ import annotations

import asyncio
import functools
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
import smbus2
import smbus2.smbus2 as inside

from esair.buses import I2CBus, RegisterLink, Wire

pytestmark = pytest.mark.real_clock

ADDRESSES = (0x10, 0x20, 0x30, 0x40)


class Kernel:
    """Counts the transfers that reached another chip than the one that was meant."""

    def __init__(self) -> None:
        self.selected = 0
        self.transfers = 0
        self.wrong = 0
        self.between: Callable[[], object] = functools.partial(time.sleep, 0)
        """What the thread does that has selected a chip."""

    def ioctl(self, _descriptor: int, request: int, argument: Any) -> int:
        if request == inside.I2C_FUNCS:
            argument.value = 0x0EFF0000
        elif request == inside.I2C_SLAVE:
            self.selected = argument
            self.between()
        elif request == inside.I2C_SMBUS:
            # The register that is read is the address that was meant.
            self.transfers += 1
            self.wrong += self.selected != argument.command
            if argument.size == inside.I2C_SMBUS_BYTE_DATA:
                argument.data.contents.byte = self.selected
            else:
                argument.data.contents.block[1] = self.selected
        return 0


@pytest.fixture
def kernel(monkeypatch) -> Kernel:
    """Put the fake below smbus2."""
    found = Kernel()
    monkeypatch.setattr(inside, "ioctl", found.ioctl)
    return found


def test_bare_smbus2_in_two_threads_reaches_the_wrong_chip(kernel) -> None:
    """It remembers which chip it selected, but not that another thread selected one."""
    both = threading.Barrier(2)
    done = threading.Event()
    first, second = ADDRESSES[:2]

    def between() -> None:
        if threading.current_thread() is late:
            both.wait(60.0)  # it has selected its chip: now the other one may
            done.wait(60.0)

    with smbus2.SMBus("/dev/null") as shared:
        late = threading.Thread(target=shared.read_byte_data, args=(first, first))
        kernel.between = between
        late.start()
        both.wait(60.0)
        shared.read_byte_data(second, second)
        done.set()
        late.join()

    assert kernel.transfers == 2
    assert kernel.wrong == 1


class OnNull(Wire):
    """A bus of smbus2 on a file that takes its calls."""

    def open(self) -> smbus2.SMBus:
        return smbus2.SMBus("/dev/null")


@pytest.mark.fault("I05")
@pytest.mark.promise("BUS-1")
@pytest.mark.long
async def test_no_transfer_of_100_000_reaches_another_chip(kernel) -> None:
    """Behaviors and blocking drivers share a bus; address and transfer stay together."""
    bus = I2CBus(name="body", wire=OnNull(), timeout=30.0)
    await bus.open()

    async def ask(address: int) -> None:
        for _ in range(1_000):
            assert await bus.read(address, address) == bytes([address])

    def many(link: RegisterLink, address: int) -> int:
        return sum(link.read_byte_data(address, address) for _ in range(500))

    async def ask_often(address: int) -> None:
        for _ in range(24):
            assert (
                await bus.transaction(lambda link: many(link, address)) == 500 * address
            )

    def plain() -> None:
        for address in (*ADDRESSES, *reversed(ADDRESSES)):
            assert bus.direct(functools.partial(many, address=address)) == 500 * address

    async def drive() -> None:
        for _ in range(12):
            await bus.executor.call(plain, timeout=30.0)

    await asyncio.gather(
        drive(), *(work(each) for each in ADDRESSES for work in (ask, ask_often))
    )

    assert kernel.transfers == 4 * 1_000 + 4 * 24 * 500 + 12 * 8 * 500 == 100_000
    assert kernel.wrong == 0
    assert bus.stats.errors == 0
    await bus.close()


def test_bare_smbus2_goes_past_a_driver_of_the_kernel(monkeypatch) -> None:
    """The kernel asks who owns a chip when it is selected; a message selects none."""
    from esair.buses.i2c import _kernel as _i2c_kernel

    requests: list[int] = []

    def ioctl(_descriptor: int, request: int, argument: Any) -> int:
        requests.append(request)
        if request == inside.I2C_FUNCS:
            argument.value = 1
        if request == inside.I2C_SLAVE:
            raise OSError(16, "Device or resource busy")
        return 0

    monkeypatch.setattr(inside, "ioctl", ioctl)
    message = smbus2.i2c_msg.write(0x48, [0])

    with smbus2.SMBus("/dev/null") as bare:
        bare.i2c_rdwr(message)
    assert inside.I2C_RDWR in requests

    requests.clear()
    link = _i2c_kernel.open_bus("/dev/null", pec=False)
    with pytest.raises(OSError, match="busy"):
        link.i2c_rdwr(message)
    link.close()
    assert inside.I2C_RDWR not in requests
    assert inside.I2C_SLAVE_FORCE not in requests


def test_bare_smbus2_leaves_a_descriptor_when_it_cannot_open(monkeypatch) -> None:
    """It opens the file, then asks what the adapter can do; esair closes the file."""
    from esair.buses.i2c import _kernel as _i2c_kernel

    def ioctl(_descriptor: int, _request: int, _argument: object) -> int:
        raise OSError(25, "Inappropriate ioctl for device")

    monkeypatch.setattr(inside, "ioctl", ioctl)
    bare = smbus2.SMBus()
    with pytest.raises(OSError, match="Inappropriate"):
        bare.open("/dev/null")
    assert bare.fd is not None
    bare.close()

    closed = []
    close = smbus2.SMBus.close

    def noting(bus: smbus2.SMBus) -> None:
        closed.append(bus.fd)
        close(bus)

    monkeypatch.setattr(smbus2.SMBus, "close", noting)
    with pytest.raises(OSError, match="Inappropriate"):
        _i2c_kernel.open_bus("/dev/null", pec=False)
    assert len(closed) == 1
    assert closed[0] is not None


@pytest.mark.fault("I02")
async def test_the_checksum_of_smbus_is_switched_on_at_each_opening(
    monkeypatch,
) -> None:
    """An adapter that has none says so, and nothing stays open."""
    asked: list[int] = []
    refuses = [False]

    def ioctl(_descriptor: int, request: int, argument: Any) -> int:
        if request == inside.I2C_FUNCS:
            argument.value = 0x8
        if request == inside.I2C_PEC:
            asked.append(argument)
            if refuses[0]:
                raise OSError(22, "Invalid argument")
        return 0

    monkeypatch.setattr(inside, "ioctl", ioctl)
    bus = I2CBus(name="body", bus="/dev/null", pec=True)
    await bus.open()
    await bus.close()
    await bus.open()
    await bus.close()
    assert asked == [1, 1]

    refuses[0] = True
    with pytest.raises(ConnectionError, match="Invalid argument"):
        await bus.open()
    await bus.close()
