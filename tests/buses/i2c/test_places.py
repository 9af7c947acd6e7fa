"""Where an I²C bus is: its number, its path, its adapter's name; and what is on it."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from esair.buses import I2CBus
from esair.buses.i2c import ChipBus, _bus
from esair.buses.i2c import _kernel as kernel
from esair.buses.i2c._bus import SCANNED
from esair.exceptions import (
    BadValueError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)


@pytest.fixture
def adapters(tmp_path) -> Path:
    """Return a directory like ``/sys/class/i2c-dev``."""
    for number, name in [
        (1, "bcm2835 (i2c@7e804000)"),
        (11, "i2c-tiny-usb at bus 001 device 004"),
        (4, "CH347 I2C"),
    ]:
        place = tmp_path / f"i2c-{number}"
        place.mkdir()
        (place / "name").write_text(f"{name}\n")
    (tmp_path / "i2c-9").mkdir()  # it is just being unplugged
    return Path(tmp_path)


def test_adapters_are_listed_by_number(adapters) -> None:
    """One without a name is on its way out."""
    assert list(kernel.adapters(adapters)) == [1, 4, 11]
    assert kernel.adapters(adapters / "none") == {}


@pytest.mark.fault("D06")
@pytest.mark.promise("BUS-2")
@pytest.mark.parametrize(
    ("place", "path"),
    [(7, "/dev/i2c-7"), ("/dev/i2c-3", "/dev/i2c-3"), ("name:CH347", "/dev/i2c-4"),
     ("name:i2c-tiny-usb", "/dev/i2c-11")],
)  # fmt: skip
def test_a_bus_is_found_by_number_path_or_name(adapters, place, path) -> None:
    """A name needs no more than its beginning, for the end changes with the socket."""
    assert kernel.find(place, adapters) == path


@pytest.mark.fault("D06")
def test_the_same_adapter_is_found_under_another_number(adapters) -> None:
    """What was plugged in again is the same bus."""
    (adapters / "i2c-4").rename(adapters / "i2c-12")

    assert kernel.find("name:CH347", adapters) == "/dev/i2c-12"


def test_a_name_that_fits_none_or_several_names_those_that_are_there(adapters) -> None:
    """Nobody has to look them up."""
    with pytest.raises(FileNotFoundError, match=r"'CH347 I2C' \(i2c-4\)"):
        kernel.find("name:FT232H", adapters)
    (adapters / "i2c-12").mkdir()
    (adapters / "i2c-12/name").write_text("CH347 I2C\n")
    with pytest.raises(FileNotFoundError, match=r"several .*i2c-12"):
        kernel.find("name:CH347", adapters)


def test_presence_tells_arrivals_apart(tmp_path) -> None:
    """What is not there is None; what was made again is another one."""
    place = tmp_path / "i2c-3"
    assert kernel.presence(str(place)) is None
    place.touch()
    first = kernel.presence(str(place))
    assert first is not None
    assert kernel.presence(str(place)) == first
    other = tmp_path / "other"
    other.touch()
    other.replace(place)
    assert kernel.presence(str(place)) not in {None, first}


class Cut(ChipBus):
    """An adapter that is pulled in the middle of a transfer, as the kernel shows it."""

    def __init__(self, place: Path, code: int, stays: bool) -> None:
        super().__init__({})
        self.place, self.code, self.stays = place, code, stays

    def _exchange(self, address: int, write: bytes, read: int) -> bytes:
        if not self.stays:  # it goes a moment after the transfer has failed
            threading.Timer(0.02, self.place.unlink).start()
        raise OSError(self.code, os.strerror(self.code))


@pytest.mark.real_clock
@pytest.mark.promise("BUS-4")
@pytest.mark.parametrize("code", [errno.EIO, errno.EPROTO, errno.ETIMEDOUT])
@pytest.mark.parametrize("stays", [False, True])
async def test_an_unplug_inside_a_transfer_is_a_loss(
    tmp_path, monkeypatch, code: int, stays: bool
) -> None:
    """The transfer fails before the adapter is gone; one that stays had a fault."""
    place = tmp_path / "i2c-7"
    place.touch()
    cut = Cut(place, code, stays)
    monkeypatch.setattr(kernel, "open_bus", lambda _path, pec: cut)
    monkeypatch.setattr(kernel, "is_removable", lambda _path: True)
    monkeypatch.setattr(_bus, "GOING_TIME", 0.1 if stays else 5.0)  # a busy computer
    bus = I2CBus(name="chips", bus=str(place), timeout=8.0)
    await bus.open()

    wanted: Any = (DeviceFaultError, DriverStuckError) if stays else DeviceLostError
    with pytest.raises(wanted):
        await bus.read(0x40, 0)

    assert bus.is_open is stays
    await bus.close()


def test_an_adapter_on_usb_can_be_pulled(adapters, tmp_path) -> None:
    """By its place in /sys; one of the computer cannot."""
    usb = tmp_path / "devices/usb1/1-1/i2c-11"
    usb.mkdir(parents=True)
    (adapters / "i2c-11/device").symlink_to(usb)

    assert kernel.is_removable("/dev/i2c-11", adapters)
    assert not kernel.is_removable("/dev/i2c-1", adapters)


async def test_a_scan_is_as_careful_as_i2cdetect(fake_i2c) -> None:
    """Memories are read, others only addressed, and nothing is written to any."""
    bus = fake_i2c(chips=dict.fromkeys(SCANNED, b""))
    await bus.open()

    found = await bus.scan()

    assert found == dict.fromkeys(SCANNED, "answers")
    read = {each.address for each in bus.log if each.read}
    assert read == {*range(0x30, 0x38), *range(0x50, 0x60)}
    assert {each.written for each in bus.log} == {b""}
    await bus.close()


async def test_a_scan_without_quick_writes_reads(fake_i2c) -> None:
    """An adapter that cannot just address a chip reads a byte from it."""
    bus = fake_i2c(chips={0x20: b"", 0x68: b""})
    bus.link.funcs &= ~0x00010000
    await bus.open()

    assert await bus.scan([0x20, 0x21, 0x68]) == {0x20: "answers", 0x68: "answers"}

    assert all(each.read for each in bus.log)
    await bus.close()


async def test_a_scan_ends_with_the_adapter(fake_i2c) -> None:
    """It is not told as an empty bus."""
    bus = fake_i2c(chips={0x20: b""})
    await bus.open()
    bus.fail(errno.ENODEV, after=0)
    with pytest.raises(DeviceLostError):
        await bus.scan([0x20])
    assert bus.stats.lost == 1

    await bus.open()
    bus.fail(errno.EOPNOTSUPP, times=None)
    with pytest.raises(DeviceFaultError):
        await bus.scan([0x20])
    await bus.close()


@pytest.mark.parametrize("address", [0x00, 0x07, 0x78, -1])
async def test_a_scan_leaves_addresses_alone_that_are_none_of_a_chip(
    fake_i2c, address: int
) -> None:
    """A general call may mean a reset to everybody."""
    bus = fake_i2c(chips={})
    await bus.open()

    with pytest.raises(BadValueError, match="addresses"):
        await bus.scan([address])

    assert bus.log == []
    await bus.close()
