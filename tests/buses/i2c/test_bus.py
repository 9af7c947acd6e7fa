"""The I²C bus: registers, transfers, transactions, and what of them is wrong."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Sequence
from typing import Any

import pytest
from smbus2 import i2c_msg

from esair.buses import I2CBus, RegisterLink, Wire
from esair.buses.i2c import Registers
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
)
from esair.testing import FakeI2c


class RegistersOnly(Wire):
    """A link with the calls for registers, and no other."""

    def __init__(self) -> None:
        super().__init__()
        self.chip = Registers(bytes(range(256)))

    def open(self) -> RegistersOnly:
        return self

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        return self.chip.read(register, 1)[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        self.chip.write(register, bytes([value]))

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        return list(self.chip.read(register, length))

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        self.chip.write(register, bytes(data))

    def close(self) -> None:
        """Nothing is open."""


class Short(RegistersOnly):
    """A link that loses the last byte of a block."""

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        return super().read_i2c_block_data(i2c_addr, register, length)[:-1]


async def test_registers_are_read_and_written(fake_i2c) -> None:
    """One register and several, each in one transfer that starts at the register."""
    bus = fake_i2c(chips={0x40: b""})
    await bus.open()

    await bus.write(0x40, 0x10, b"\x01")
    await bus.write(0x40, 0x11, b"\x02\x03")

    assert await bus.read(0x40, 0x10, 3) == b"\x01\x02\x03"
    assert await bus.read(0x40, 0x12) == b"\x03"
    assert [(each.written, each.read) for each in bus.log] == [
        (b"\x10\x01", b""),
        (b"\x11\x02\x03", b""),
        (b"\x10", b"\x01\x02\x03"),
        (b"\x12", b"\x03"),
    ]
    assert (bus.stats.sent, bus.stats.received, bus.stats.errors) == (2, 2, 0)
    await bus.close()


async def test_a_transfer_writes_then_reads(fake_i2c) -> None:
    """More than SMBus can do, in one piece; the chip's pointer goes on."""
    content = bytes(range(256))
    bus = fake_i2c(chips={0x50: content})
    await bus.open()

    assert await bus.transfer(0x50, b"\x20", read=40) == content[0x20:0x48]
    assert await bus.transfer(0x50, read=2) == content[0x48:0x4A]
    assert await bus.transfer(0x50, b"\x05" + bytes(40)) == b""
    assert await bus.read(0x50, 0x2C, 2) == b"\x00\x2d"
    assert await bus.transfer(0x50) == b""

    assert (bus.stats.sent, bus.stats.received) == (3, 3)
    await bus.close()


@pytest.mark.parametrize(
    ("write", "read", "answer"),
    [
        (b"", 0, b""), (b"", 1, b"\x07"), (b"\x10", 0, b""), (b"\x10\x55", 0, b""),
        (b"\x10\x55\x66", 0, b""), (b"\x10", 1, b"\x10"), (b"\x10", 32, bytes(range(16, 48))),
        (bytes(33), 0, b""),
    ],
)  # fmt: skip
async def test_an_adapter_with_smbus_only_gets_the_call_that_means_the_same(
    fake_i2c, write: bytes, read: int, answer: bytes
) -> None:
    """What is on the wire is what plain I²C would have put there."""
    logs = []
    for funcs in (0x0EFF0001, 0x0EFF0000):
        bus = fake_i2c(chips={0x50: bytes(range(256))})
        bus.link.funcs = funcs
        await bus.open()
        await bus.transfer(0x50, b"\x07")
        assert await bus.transfer(0x50, write, read) == answer
        logs.append(bus.log)
        await bus.close()

    assert logs[0] == logs[1]


@pytest.mark.parametrize(
    ("write", "read"), [(b"", 2), (b"\x01\x02", 1), (bytes(34), 0)]
)
async def test_what_smbus_cannot_do_is_not_done(fake_i2c, write, read) -> None:
    """It is a fault that says so, and nothing is on the wire."""
    bus = fake_i2c(chips={0x50: b""})
    bus.link.funcs = 0x0EFF0000
    await bus.open()

    with pytest.raises(DeviceFaultError, match="SMBus only"):
        await bus.transfer(0x50, write, read)

    assert bus.log == []
    await bus.close()


@pytest.mark.virtual_clock
async def test_a_link_with_registers_only_has_no_transfers() -> None:
    """Registers work; anything else names what is missing."""
    bus = I2CBus(name="body", wire=RegistersOnly())
    await bus.open()

    assert await bus.read(0x50, 7) == b"\x07"
    with pytest.raises(DeviceFaultError, match="registers only"):
        await bus.transfer(0x50, b"\x07", read=1)
    with pytest.raises(DeviceFaultError, match="registers only"):
        await bus.scan()

    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("D26")
async def test_a_reading_that_is_too_short_is_a_fault() -> None:
    """It says how many bytes came."""
    bus = I2CBus(name="body", wire=Short())
    await bus.open()

    with pytest.raises(DeviceFaultError, match="3 bytes instead of 4"):
        await bus.read(0x50, 0, 4)

    assert bus.stats.errors == 1
    await bus.close()


async def test_a_transaction_may_use_messages_of_smbus2(fake_i2c) -> None:
    """The link is what smbus2's documentation says; two reads, one transaction."""
    bus = fake_i2c(chips={0x50: bytes(range(256))})
    await bus.open()

    def both(link) -> bytes:
        first, second = i2c_msg.read(0x50, 2), i2c_msg.read(0x50, 1)
        link.i2c_rdwr(
            i2c_msg.write(0x50, [0x30]), first, i2c_msg.write(0x50, [0x60]), second
        )
        return bytes(first) + bytes(second)

    assert await bus.transaction(both) == b"\x30\x31\x60"
    await bus.close()


@pytest.mark.parametrize(
    ("address", "register", "length", "field"),
    [(0x02, 0, 1, "address"), (0x78, 0, 1, "address"), (0x68, 256, 1, "register"),
     (0x68, -1, 1, "register"), (0x68, 0, 0, "length"), (0x68, 0, 33, "length")],
)  # fmt: skip
async def test_what_is_no_transfer_is_not_made(
    fake_i2c, address: int, register: int, length: int, field: str
) -> None:
    """The error names the part that is wrong."""
    bus = fake_i2c(chips={address: b""})
    await bus.open()

    with pytest.raises(BadValueError) as caught:
        await bus.read(address, register, length)
    assert caught.value.field == field
    with pytest.raises(BadValueError):
        await bus.write(address, register, bytes(length))

    assert bus.log == []
    await bus.close()


@pytest.mark.parametrize(
    ("address", "write", "read", "field"),
    [(0x02, b"", 1, "address"), (0x50, bytes(8193), 0, "write"), (0x50, b"", -1, "read"),
     (0x50, b"", 8193, "read")],
)  # fmt: skip
async def test_a_transfer_has_an_address_and_a_length(
    fake_i2c, address, write, read, field
) -> None:
    """The error names the part that is wrong."""
    bus = fake_i2c(chips={address: b""})
    await bus.open()

    with pytest.raises(BadValueError) as caught:
        await bus.transfer(address, write, read)

    assert caught.value.field == field
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("D21")
async def test_what_waits_is_bounded() -> None:
    """One transfer more than the executor takes is refused at once, and counted."""
    bus = FakeI2c(chips={0x40: b""}, timeout=5.0)
    await bus.open()
    bus.stall()
    waiting = [asyncio.ensure_future(bus.read(0x40, 0)) for _ in range(300)]
    await asyncio.sleep(0)

    refused = [each for each in waiting if each.done()]
    assert bus.waiting <= bus.executor.limit
    bus.resume()
    done = await asyncio.gather(*waiting, return_exceptions=True)

    busy = [each for each in done if isinstance(each, BusyError)]
    assert len(refused) == len(busy) == bus.stats.refused > 0
    assert done.count(b"\x00") + len(busy) == 300
    assert bus.waiting == 0
    await bus.close()


@pytest.mark.real_clock
async def test_direct_transfers_are_for_the_buss_own_thread(fake_i2c) -> None:
    """A plain method of a driver is there; nobody else may go past the queue."""
    bus = fake_i2c(chips={0x40: {7: 42}})
    await bus.open()

    def plain() -> Any:
        return bus.direct(lambda link: link.read_byte_data(0x40, 7))

    assert await bus.executor.call(plain, timeout=5.0) == 42
    with pytest.raises(RuntimeError, match="thread of the bus"):
        plain()
    with pytest.raises(RuntimeError, match="thread of the bus"):
        await asyncio.to_thread(plain)

    await bus.close()
    with pytest.raises(DeviceLostError):
        await bus.executor.call(plain, timeout=5.0)
    await bus.close()
    bus.executor.close()


@pytest.mark.real_clock
async def test_a_direct_transfer_that_finds_the_adapter_gone_tells_all(
    fake_i2c,
) -> None:
    """The loss is told in the event loop, whichever thread has found it."""
    bus = fake_i2c(chips={0x40: {7: 42}})
    told = asyncio.Event()
    threads = []

    def hear(_error: BaseException) -> None:
        threads.append(threading.current_thread())
        told.set()

    bus.on_lost(hear)
    await bus.open()
    bus.unplug(noticed=False)

    def plain() -> Any:
        return bus.direct(lambda link: link.read_byte_data(0x40, 7), address=0x40)

    with pytest.raises(DeviceLostError):
        await bus.executor.call(plain, timeout=5.0)
    async with asyncio.timeout(5.0):
        await told.wait()

    assert threads == [threading.main_thread()]
    assert not bus.is_open
    assert bus.stats.lost == 1
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("D03")
async def test_a_bus_that_is_not_there_is_lost() -> None:
    """The kernel's bus is opened in the thread; its error names the bus."""
    bus = I2CBus(name="body", bus=250)
    with pytest.raises(DeviceLostError, match="'body'"):
        await bus.open()
    await bus.close()


@pytest.mark.parametrize("place", [-1, "i2c-1", "name:", 1.0, True, None])
def test_a_bus_has_a_place(place) -> None:
    """Nothing is opened to find out."""
    with pytest.raises(ConfigError, match="dev/i2c"):
        I2CBus(name="body", bus=place)


@pytest.mark.parametrize("timeout", [0, -1.0, float("inf"), float("nan")])
def test_a_bus_has_a_deadline(timeout: float) -> None:
    """Without one, a stuck wire would be waited for."""
    with pytest.raises(ConfigError, match="timeout"):
        I2CBus(name="body", timeout=timeout)


@pytest.mark.real_clock
@pytest.mark.fault("I07")
async def test_a_transaction_is_not_interrupted() -> None:
    """A counter of two registers is never torn, however many advance it."""
    bus = FakeI2c(chips={0x40: b""}, timeout=5.0)
    await bus.open()

    def advance(link: RegisterLink) -> int:
        high, low = (link.read_byte_data(0x40, register) for register in (0, 1))
        time.sleep(0)
        value = (high << 8 | low) + 1
        link.write_byte_data(0x40, 0, value >> 8)
        link.write_byte_data(0x40, 1, value & 0xFF)
        return value

    async def work() -> list[int]:
        return [await bus.transaction(advance, address=0x40) for _ in range(60)]

    found = await asyncio.gather(*(work() for _ in range(5)))

    assert sorted(value for values in found for value in values) == list(range(1, 301))
    assert await bus.read(0x40, 0, 2) == (300).to_bytes(2, "big")
    await bus.close()
