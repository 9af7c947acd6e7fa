"""SPI buses: what is sent, what comes back, what goes wrong."""

from __future__ import annotations

import asyncio
import errno
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from esair import discovery
from esair.buses.spi import SpiBus, SpiLink, _kernel
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)


@pytest.mark.virtual_clock
async def test_a_byte_comes_back_for_each_that_is_sent(fake_spi) -> None:
    """At the same time: an exchange is as long as what was sent."""
    bus = fake_spi(chips={0: b"\x10\x20\x30"})
    await bus.open()

    assert await bus.exchange(0, b"\x80\x00\x00") == b"\xff\x10\x20"
    assert await bus.transfer(0, b"\x81", read=2) == b"\x20\x30"

    assert [each.sent for each in bus.log] == [b"\x80\x00\x00", b"\x81\x00\x00"]
    assert (bus.stats.sent, bus.stats.received) == (2, 1)
    await bus.close()


@pytest.mark.virtual_clock
async def test_a_transfer_has_its_own_speed_and_mode(fake_spi) -> None:
    """Chips on one bus differ; what a transfer does not say the bus says."""
    bus = fake_spi(chips={0: b"", 1: b""})
    await bus.open()

    await bus.exchange(0, b"\0")
    await bus.exchange(1, b"\0", speed=8_000_000, mode=3)

    assert [(e.chip, e.speed, e.mode) for e in bus.log] == [
        (0, 1_000_000, 0),
        (1, 8_000_000, 3),
    ]
    await bus.close()


@pytest.mark.virtual_clock
async def test_what_is_no_transfer_is_refused_before_it_is_sent(fake_spi) -> None:
    """The error names the field; nothing is on the wire."""
    bus = fake_spi(chips={0: b""})
    await bus.open()

    for field, call in {
        "chip": bus.exchange(-1, b"\0"),
        "data": bus.exchange(0, b""),
        "4096": bus.transfer(0, bytes(4000), read=97),
        "speed": bus.exchange(0, b"\0", speed=0),
        "mode": bus.exchange(0, b"\0", mode=4),
        "read": bus.transfer(0, b"\0", read=-1),
    }.items():
        with pytest.raises(BadValueError, match=field):
            await call

    assert bus.log == []
    await bus.close()


@pytest.mark.parametrize(
    ("field", "value"), [("bus", -1), ("bus", "0"), ("speed", 0), ("mode", 4)]
)
def test_a_setting_that_no_bus_has_is_a_mistake(field: str, value: Any) -> None:
    """It is found before anything is opened."""
    with pytest.raises(ConfigError, match=field):
        SpiBus(name="spi", **{field: value})


@pytest.mark.virtual_clock
async def test_a_transfer_that_failed_is_not_repeated(fake_spi) -> None:
    """Nobody acknowledges on SPI, so nobody knows what the chip has seen of it."""
    bus = fake_spi(chips={0: b""})
    await bus.open()
    bus.fail(errno.EIO)

    with pytest.raises(DeviceFaultError, match="chip 0") as caught:
        await bus.exchange(0, b"\0")

    assert caught.value.errno == errno.EIO
    assert (bus.log, bus.stats.errors, bus.stats.retries) == ([], 1, 0)
    await bus.exchange(0, b"\0")
    await bus.close()


@pytest.mark.virtual_clock
async def test_fewer_bytes_than_were_sent_are_no_answer(fake_spi) -> None:
    """Nobody knows which of them are missing."""
    bus = fake_spi(chips={0: SimpleNamespace(exchange=lambda data: data[1:])})
    await bus.open()

    for call in bus.exchange(0, b"\1\2\3"), bus.transfer(0, b"\1", read=2):
        with pytest.raises(DeviceFaultError, match="2 bytes instead of 3"):
            await call

    assert bus.stats.errors == 2
    await bus.close()


@pytest.mark.virtual_clock
async def test_a_transaction_is_in_one_piece(fake_spi) -> None:
    """What others ask for waits until it is over."""
    bus = fake_spi(chips={0: b"", 1: b""})
    await bus.open()

    def twice(link: SpiLink) -> bytes:
        link.exchange(0, b"\x01\x05", 1_000_000, 0)
        return link.exchange(0, b"\x81\x00", 1_000_000, 0)

    back, _ = await asyncio.gather(
        bus.transaction(twice, chip=0), bus.exchange(1, b"\0")
    )

    assert back == b"\xff\x05"
    assert [each.chip for each in bus.log] == [0, 0, 1]
    await bus.close()


@pytest.mark.virtual_clock
async def test_a_transfer_that_does_not_return_is_stuck_for_all(fake_spi) -> None:
    """Each gets the error in time, and what waited is not made late."""
    bus = fake_spi(chips={0: b""})
    await bus.open()
    bus.stall()

    with pytest.raises(DriverStuckError):
        await bus.exchange(0, b"\x01\x07")
    with pytest.raises(DriverStuckError, match="held up"):
        await bus.exchange(0, b"\x02\x07")
    bus.resume()

    assert [each.sent for each in bus.log] == [b"\x01\x07"]
    await bus.close()


class Device:
    """A ``spidev.SpiDev`` that answers with what it got, and keeps its settings."""

    made: ClassVar[list[Device]] = []

    bits_per_word = 16

    def __init__(self) -> None:
        self.told: list[tuple[str, int]] = []
        self.closed = False
        self.path = ""
        self.error: OSError | None = None
        Device.made.append(self)

    mode = property(
        lambda self: dict(self.told).get("mode", 0),
        lambda self, value: self.told.append(("mode", value)),
    )
    max_speed_hz = property(
        lambda self: dict(self.told).get("speed", 500_000),
        lambda self, value: self.told.append(("speed", value)),
    )

    def open_path(self, path: str) -> None:
        self.path = path

    def xfer2(self, data: list[int]) -> list[int]:
        if self.error is not None:
            raise self.error
        return [0xFF - each for each in data]

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Device files of two chip selects, and a package behind them."""
    files = {n: tmp_path / f"spidev0.{n}" for n in (0, 1)}
    for file in files.values():
        file.touch()
    monkeypatch.setattr(
        _kernel,
        "selects",
        lambda bus: {n: str(f) for n, f in files.items() if f.exists() and bus == 0},
    )
    monkeypatch.setitem(sys.modules, "spidev", SimpleNamespace(SpiDev=Device))
    Device.made.clear()
    return tmp_path


@pytest.mark.real_clock
async def test_the_kernels_bus_has_all_its_chip_selects(kernel: Path) -> None:
    """Settings go to the kernel only where they change; the close lets all go.

    How many bits a word has is what another program has left, which swaps bytes.
    """
    bus = SpiBus(name="spi", speed=2_000_000)
    await bus.open()

    assert await bus.exchange(1, b"\x00\x0f") == b"\xff\xf0"
    await bus.exchange(1, b"\0")
    with pytest.raises(DeviceFaultError, match="chip selects 0, 1"):
        await bus.exchange(2, b"\0")
    await bus.close()

    assert [device.told for device in Device.made] == [[], [("speed", 2_000_000)]]
    assert [device.bits_per_word for device in Device.made] == [8, 8]
    assert all(device.closed for device in Device.made)


@pytest.mark.real_clock
async def test_a_bus_whose_files_are_gone_is_lost(kernel: Path) -> None:
    """An error with the files there is the chip's, without them it is the bus's."""
    bus = SpiBus(name="spi")
    await bus.open()
    Device.made[0].error = OSError(errno.ESHUTDOWN, "shut down")

    with pytest.raises(DeviceFaultError):
        await bus.exchange(0, b"\0")
    shutil.rmtree(kernel)
    with pytest.raises(DeviceLostError):
        await bus.exchange(0, b"\0")

    assert not bus.is_open
    with pytest.raises(DeviceLostError, match="SPI switched on"):
        await bus.open()
    await bus.close()


@pytest.mark.real_clock
async def test_the_package_is_named_if_it_is_missing(
    kernel: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the command that installs it."""
    monkeypatch.setitem(sys.modules, "spidev", None)
    bus = SpiBus(name="spi")

    with pytest.raises(ConfigError, match=r"esair\[spi\]"):
        await bus.open()
    await bus.close()


def test_spi_buses_are_listed_with_their_lines_of_toml(tmp_path: Path) -> None:
    """Once for each bus, with its chip selects."""
    for name in ("spidev0.0", "spidev0.1", "spidev10.0"):
        (tmp_path / "sys/class/spidev" / name).mkdir(parents=True)
        (tmp_path / "dev").mkdir(exist_ok=True)
        (tmp_path / "dev" / name).touch()

    found = [each for each in discovery.devices(tmp_path) if each.kind == "spi"]

    assert [(each.path, each.address, each.description) for each in found] == [
        ("/dev/spidev0.0", "0", "chip selects 0, 1"),
        ("/dev/spidev10.0", "10", "chip selects 0"),
    ]
    assert '[bus.spi10]\ntype = "spi"\nbus = 10\n' in discovery.toml(found[1])
