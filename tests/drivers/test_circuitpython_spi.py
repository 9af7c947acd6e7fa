"""CircuitPython drivers of SPI parts from the package index, unchanged, on our bus."""

from __future__ import annotations

import importlib
import struct
from collections.abc import Callable
from typing import Any

import pytest

from esair.buses.spi import SpiRegisters
from esair.drivers.adafruit import AdafruitActuator, AdafruitSensor, AdafruitSpi
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.testing import FakeI2c, FakeSpi

pytestmark = pytest.mark.real_clock


class Answers:
    """Answers each transfer with what a function makes of it."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self.answer = answer

    def exchange(self, data: bytes) -> bytes:
        """Answer, as long as what was sent."""
        return self.answer(data).ljust(len(data), b"\0")[: len(data)]


class WritesAreMarked(SpiRegisters):
    """Registers of Maxim: the first bit of a transfer says write."""

    def exchange(self, data: bytes) -> bytes:
        """Read or write registers; a conversion that was begun has ended."""
        back = super().exchange(bytes([data[0] ^ 0x80]) + data[1:])
        self.content[0x00] = self.content[0x00] & ~0x40 & 0xFF
        return back


def _fram(data: bytes) -> bytes:
    return {0x9F: b"\0\x04\x7f\x48\x03", 0x03: b"\0\0\0\0\x2a"}.get(data[0], b"")


def channel(spi: Any, select: Any) -> Any:
    """The first input of an MCP3008, by its two classes."""
    chip = importlib.import_module("adafruit_mcp3xxx.mcp3008").MCP3008(spi, select)
    module = importlib.import_module("adafruit_mcp3xxx.analog_in")
    return module.AnalogIn(chip, 0)


class First:
    """The first of what an object of a package has by index."""

    def __init__(self, made: Any) -> None:
        self._made = made

    @property
    def value(self) -> Any:
        """What it is."""
        return self._made[0]

    @value.setter
    def value(self, value: Any) -> None:
        self._made[0] = value


def cell(spi: Any, select: Any) -> First:
    """The first cell of a memory."""
    return First(importlib.import_module("adafruit_fram").FRAM_SPI(spi, select))


def lamp(spi: Any, select: Any) -> First:
    """The first output of a driver of LEDs."""
    return First(importlib.import_module("adafruit_tlc5947").TLC5947(spi, select))


# What makes the part, what is read, and what that is.
SENSORS: dict[Any, tuple[Callable[[], Any], str, Any]] = {
    "adafruit_max31855:MAX31855": (
        lambda: Answers(lambda _: struct.pack(">hh", 400 << 2, 0x1900)),
        "temperature",
        100.0,
    ),
    "adafruit_max31856:MAX31856": (
        lambda: WritesAreMarked({0x0C: b"\x06\x40\0"}),
        "temperature",
        100.0,
    ),
    "adafruit_max31865:MAX31865": (
        lambda: WritesAreMarked({0x01: struct.pack(">H", 0x2000 << 1)}),
        "resistance",
        107.5,
    ),
    "adafruit_lis3dh:LIS3DH_SPI": (
        lambda: SpiRegisters({0x0F: 0x33, 0x68: struct.pack("<hhh", 16384, 0, 0)}),
        "acceleration",
        (9.806, 0.0, 0.0),
    ),
    "adafruit_l3gd20:L3GD20_SPI": (
        lambda: SpiRegisters({0x0F: 0xD4, 0x68: struct.pack("<hhh", 1000, 0, 0)}),
        "gyro",
        (0.002665, 0.0, 0.0),
    ),
    channel: (lambda: Answers(lambda _: b"\0\x02\0"), "value", 0x8000),
    cell: (lambda: Answers(_fram), "value", bytearray(b"\x2a")),
}


def package(library: Any) -> str:
    named = {channel: "adafruit_mcp3xxx.mcp3008", cell: "adafruit_fram"}
    module: str = named.get(library) or library.partition(":")[0]
    return module


async def called(device: Any, *calls: tuple[Any, ...]) -> Any:
    """Open a device on the thread of its bus, call its methods there, and close it."""
    await device.bus.open()
    results = []
    try:
        for name, *arguments in (("open",), *calls, ("close",)):
            method = getattr(device, name)
            results.append(
                await device.bus.executor.call(method, *arguments, timeout=20.0)
            )
    finally:
        await device.bus.close()
    return results[-2]


@pytest.mark.parametrize("library", SENSORS, ids=package)
async def test_a_sensor_gives_what_its_part_measures(library: Any) -> None:
    """Registers, commands and words, written and read under one chip select."""
    pytest.importorskip(package(library), reason=f"{package(library)} is not there")
    make, value, wanted = SENSORS[library]
    bus = FakeSpi(chips={1: make()})
    device = AdafruitSensor(library=library, chip=1, value=value, bus=bus)

    assert await called(device, ("read",)) == pytest.approx(wanted, rel=1e-2)


async def test_an_actuator_tells_its_part() -> None:
    """What is written while it is selected leaves in one transfer, when it is left."""
    pytest.importorskip("adafruit_tlc5947", reason="adafruit_tlc5947 is not there")
    bus = FakeSpi(chips={0: Answers(lambda _: b"")})
    device = AdafruitActuator(library=lamp, chip=0, attribute="value", safe=0, bus=bus)

    await called(device, ("write", 0xABC))

    assert bus.log[-1].sent[-2:] == b"\x0a\xbc"
    assert len(bus.log[-1].sent) == 36


@pytest.mark.fault("D14")
async def test_a_part_that_is_not_there_is_silent() -> None:
    """A wire without a chip reads as ones: that is no wrong answer, and is waited for."""
    library = "adafruit_lis3dh:LIS3DH_SPI"
    pytest.importorskip("adafruit_lis3dh", reason="adafruit_lis3dh is not there")
    bus = FakeSpi(chips={})
    device = AdafruitSensor(library=library, chip=0, value="acceleration", bus=bus)
    with pytest.raises(DeviceLostError):
        await called(device, ("read",))

    bus = FakeSpi(chips={0: SpiRegisters({0x0F: 0x12})})
    device = AdafruitSensor(library=library, chip=0, value="acceleration", bus=bus)
    with pytest.raises(RuntimeError, match="Failed to find"):
        await called(device, ("read",))


async def test_two_reads_under_one_chip_select_are_refused() -> None:
    """The kernel holds it for one transfer: the second would begin anew, elsewhere."""
    bus = FakeSpi(chips={0: SpiRegisters(b"")})
    await bus.open()
    spi = AdafruitSpi(bus, 0)

    def twice() -> None:
        spi.value = False
        spi.write(b"\x81")
        spi.readinto(bytearray(1))
        spi.readinto(bytearray(1))

    with pytest.raises(DeviceFaultError, match="reads twice"):
        await bus.executor.call(twice, timeout=5.0)
    assert [each.sent for each in bus.log] == [b"\x81\0"]
    await bus.close()


def test_a_chip_select_is_needed_on_spi_and_only_there() -> None:
    """The error says which keyword belongs to which bus."""
    spi, i2c = FakeSpi(chips={}), FakeI2c(chips={})
    wrong: list[tuple[Any, dict[str, Any]]] = [
        (spi, {}),
        (spi, {"chip": 0, "address": 1}),
        (i2c, {"chip": 0}),
    ]
    for bus, given in wrong:
        with pytest.raises(ConfigError, match="chip"):
            AdafruitSensor(library=cell, value="value", bus=bus, **given)
