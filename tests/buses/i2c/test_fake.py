"""The fake I²C bus does what its test tells it, as a real one would."""

from __future__ import annotations

import asyncio
import errno
import threading
from typing import Any

import pytest

from esair.buses._fakes import LOG_LIMIT
from esair.buses.i2c import Registers
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    NoTurnError,
)
from esair.testing import FakeI2c


async def test_chips_are_objects_or_plain_registers(fake_i2c) -> None:
    """Bytes from register 0 on, or what is in some; they can be changed at any time."""
    chip = Registers()
    bus = fake_i2c(chips={0x10: b"\x01\x02", 0x11: {4: 7, 8: b"\x08\x09"}, 0x12: chip})
    await bus.open()

    assert await bus.read(0x10, 0, 3) == b"\x01\x02\x00"
    assert await bus.read(0x11, 8, 2) == b"\x08\x09"
    await bus.write(0x12, 255, b"\x0a\x0b")
    assert (chip.content[255], chip.content[0]) == (0x0A, 0x0B)
    del bus.chips[0x10]
    with pytest.raises(DeviceFaultError):
        await bus.read(0x10, 0)
    await bus.close()


async def test_failures_are_counted_by_chip(fake_i2c) -> None:
    """After so many good ones, so many times, with one chip or with any."""
    bus = fake_i2c(chips={0x10: b"", 0x11: b""})
    await bus.open()
    bus.fail(errno.EIO, after=1, times=2, address=0x10)
    bus.fail(OSError(errno.EPROTO, "odd"), after=6)
    seen: list[int | None] = []

    for _ in range(4):
        for address in (0x10, 0x11):
            try:
                await bus.read(address, 0)
                seen.append(0)
            except DeviceFaultError as error:
                seen.append(error.errno)

    # The second one counts only what gets as far as that.
    assert seen == [0, 0, errno.EIO, 0, errno.EIO, 0, 0, 0]
    with pytest.raises(DeviceFaultError, match="odd"):
        await bus.read(0x11, 0)
    await bus.close()


async def test_the_log_is_bounded(fake_i2c) -> None:
    """The newest transfers are kept."""
    bus = fake_i2c(chips={0x10: b""})
    await bus.open()

    for number in range(LOG_LIMIT + 10):
        await bus.write(0x10, number % 256, b"\x01")

    assert len(bus.log) == LOG_LIMIT
    assert bus.log[-1].written == bytes([(LOG_LIMIT + 9) % 256, 1])
    await bus.close()


@pytest.mark.fault("I05")
def test_used_past_its_bus_it_reaches_the_wrong_chip() -> None:
    """Two threads on one link, as with bare smbus2: what a fake must not hide."""
    bus = FakeI2c(chips={0x10: b"\x10", 0x20: b"\x20"})
    both = threading.Barrier(2)
    wrong = 0

    def work(address: int) -> None:
        nonlocal wrong
        both.wait(5.0)
        for _ in range(3000):
            wrong += bus.link.read_byte_data(address, 0) != address

    threads = [threading.Thread(target=work, args=(each,)) for each in (0x10, 0x20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert wrong > 0


@pytest.mark.virtual_clock
async def test_a_stall_does_not_stop_a_virtual_clock_in_a_drivers_thread() -> None:
    """Time does not pass there: the adapter gives up at once, as it would in time."""
    bus = FakeI2c(chips={0x10: b""})
    await bus.open()
    bus.stall()

    def plain() -> Any:
        return bus.direct(lambda link: link.read_byte_data(0x10, 0))

    with pytest.raises(DriverStuckError):
        await bus.executor.call(plain, timeout=1.0)

    bus.resume()
    assert await bus.executor.call(plain, timeout=1.0) == 0
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("D22")
async def test_what_had_begun_is_done_late_and_what_waited_is_not() -> None:
    """On the virtual clock as on the real one."""
    bus = FakeI2c(chips={0x10: b""}, timeout=0.1)
    await bus.open()
    bus.stall()
    writes = [bus.write(0x10, register, b"\x01") for register in range(3)]
    results = await asyncio.gather(*writes, return_exceptions=True)
    assert [type(each) for each in results] == [
        DriverStuckError,
        NoTurnError,
        NoTurnError,
    ]

    bus.resume()

    assert [each.written for each in bus.log] == [b"\x00\x01"]
    await bus.write(0x10, 9, b"\x01")
    assert len(bus.log) == 2
    await bus.close()


@pytest.mark.parametrize("noticed", [True, False])
async def test_an_unplugged_adapter_cannot_be_opened(fake_i2c, noticed: bool) -> None:
    """Told at once, or found by the next transfer; plugging it in is told too."""
    bus = fake_i2c(chips={0x10: b""})
    lost: list[BaseException] = []
    arrivals: list[None] = []
    bus.on_lost(lost.append)
    bus.on_arrival(lambda: arrivals.append(None))
    await bus.open()

    bus.unplug(noticed=noticed)
    assert len(lost) == noticed
    with pytest.raises(DeviceLostError):
        await bus.read(0x10, 0)
    assert len(lost) == 1
    with pytest.raises(DeviceLostError, match="cannot be opened"):
        await bus.open()
    bus.plug()
    assert len(arrivals) == 1
    await bus.open()
    assert await bus.read(0x10, 0) == b"\x00"
    await bus.close()


def test_an_address_that_is_a_text_is_a_mistake() -> None:
    """As from a file: nobody would ever answer there."""
    with pytest.raises(ConfigError, match=r"chips: expected 0 or more, not '0x76'"):
        FakeI2c(chips={"0x76": b"abc"})  # type: ignore[dict-item]
