"""CircuitPython drivers of SPI parts from the package index, unchanged, on our bus."""

from __future__ import annotations

import importlib
import struct
from collections.abc import Callable
from typing import Any

import pytest

from esair.buses.i2c import Registers
from esair.buses.spi import SpiRegisters
from esair.drivers.adafruit import AdafruitActuator, AdafruitSensor, AdafruitSpi
from esair.drivers.bme280.fake import FakeBme280
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


class AsOnI2c:
    """A chip of Bosch: the first bit of a transfer says read, not which register."""

    def __init__(self, chip: Any, *, high: int = 0x80, dummy: int = 0) -> None:
        self.chip = chip
        self.high = high
        self.dummy = dummy

    def exchange(self, data: bytes) -> bytes:
        """Read registers, or write pairs of a register and its value."""
        if data[0] & 0x80:
            register, begin = data[0] & 0x7F | self.high, 1 + self.dummy
            return bytes(begin) + bytes(self.chip.read(register, len(data) - begin))
        for register, value in zip(data[::2], data[1::2], strict=True):
            self.chip.write(register | self.high, bytes((value,)))
        return bytes(len(data))


def _bmp280() -> AsOnI2c:
    chip = FakeBme280()
    chip.content[0xD0] = 0x58
    return AsOnI2c(chip)


def _bmp388() -> AsOnI2c:
    calibration = struct.pack("<HHb", 0, 1 << 15, 0)
    content: dict[int, int | bytes] = {
        0x00: 0x50,
        0x03: 0x60,
        0x07: b"\0\x80\x0c",
        0x31: calibration,
    }
    return AsOnI2c(Registers(content), high=0, dummy=1)


class Pin:
    """A pin that nothing is at."""

    value = False
    direction: Any = None

    def switch_to_output(self, value: bool = False) -> None:
        """Be one."""


def radio(spi: Any, select: Any) -> Any:
    """A radio of 433 to 915 MHz, by LoRa."""
    module = importlib.import_module("adafruit_rfm9x")
    return module.RFM9x(spi, select, Pin(), 868.0)


def packets(spi: Any, select: Any) -> Any:
    """A radio of 433 to 915 MHz, by packets."""
    module = importlib.import_module("adafruit_rfm69")
    return module.RFM69(spi, select, Pin(), 868.0)


class Paged(AsOnI2c):
    """Two pages of registers, of which a bit of one in both says which."""

    def exchange(self, data: bytes) -> bytes:
        """Choose the page first."""
        if data[0] == 0x73:
            self.high = 0 if data[1] & 0x10 else 0x80
        return super().exchange(data)


def _bme680() -> Paged:
    content: dict[int, int | bytes] = {
        0xD0: 0x61,
        0x1D: b"\x80\0\0\0\0\x7d\0\0",
        0x8A: b"\0\x10\0",
    }
    return Paged(Registers(content))


def display(spi: Any, select: Any) -> Any:
    """An OLED display."""
    module = importlib.import_module("adafruit_ssd1306")
    return module.SSD1306_SPI(128, 32, spi, Pin(), None, select)


def _fram(data: bytes) -> bytes:
    return {0x9F: b"\0\x04\x7f\x48\x03", 0x03: b"\0\0\0\0\x2a"}.get(data[0], b"")


def channel(spi: Any, select: Any) -> Any:
    """The first input of an MCP3008, by its two classes."""
    chip = importlib.import_module("adafruit_mcp3xxx.mcp3008").MCP3008(spi, select)
    module = importlib.import_module("adafruit_mcp3xxx.analog_in")
    return module.AnalogIn(chip, 0)


def _input(name: str) -> Callable[[Any, Any], Any]:
    def made(spi: Any, select: Any) -> Any:
        module = importlib.import_module(f"adafruit_mcp3xxx.{name.lower()}")
        analog = importlib.import_module("adafruit_mcp3xxx.analog_in")
        return analog.AnalogIn(getattr(module, name)(spi, select), 0)

    return made


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
    "adafruit_bme280.basic:Adafruit_BME280_SPI": (
        lambda: AsOnI2c(FakeBme280()),
        "temperature",
        21.0,
    ),
    "adafruit_bmp280:Adafruit_BMP280_SPI": (_bmp280, "temperature", 21.0),
    "adafruit_bmp3xx:BMP3XX_SPI": (_bmp388, "temperature", 25.0),
    radio: (lambda: WritesAreMarked({0x42: 18}), "frequency_mhz", 868.0),
    packets: (
        lambda: WritesAreMarked({0x10: 0x24, 0x27: 0x80}),
        "frequency_mhz",
        868.0,
    ),
    "adafruit_bme680:Adafruit_BME680_SPI": (_bme680, "temperature", 25.0),
    _input("MCP3002"): (lambda: Answers(lambda _: b"\x02\0\0"), "value", 0x8000),
    _input("MCP3004"): (lambda: Answers(lambda _: b"\0\x02\0"), "value", 0x8000),
    channel: (lambda: Answers(lambda _: b"\0\x02\0"), "value", 0x8000),
    cell: (lambda: Answers(_fram), "value", bytearray(b"\x2a")),
    "adafruit_stmpe610:Adafruit_STMPE610_SPI": (
        lambda: SpiRegisters({0x00: 0x08, 0x01: 0x11, 0x4C: 3}),
        "buffer_size",
        3,
    ),
}


def package(library: Any) -> str:
    named = {cell: "adafruit_fram", radio: "adafruit_rfm9x", packets: "adafruit_rfm69"}
    if callable(library):
        return named.get(library, "adafruit_mcp3xxx.mcp3008")
    module: str = library.partition(":")[0]
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


def shifted(spi: Any, select: Any) -> First:
    """The eight pins of a shift register."""
    made = importlib.import_module("adafruit_74hc595").ShiftRegister74HC595(spi, select)
    return Pins(made)


class Pins(First):
    """A shift register: all of its pins as one byte."""

    @property
    def value(self) -> Any:
        """What they are."""
        return self._made.gpio[0]

    @value.setter
    def value(self, value: Any) -> None:
        self._made.gpio = bytearray([value])


def segments(spi: Any, select: Any) -> Any:
    """Digits of an LED display."""
    digits = importlib.import_module("adafruit_max7219.bcddigits")
    return digits.BCDDigits(spi, select, nDigits=8)


class Channel:
    """The last of twelve PWM outputs, which have no chip select."""

    def __init__(self, made: Any) -> None:
        self._made = made

    def tell(self, value: int) -> None:
        """Tell all of them."""
        self._made.set_channel(0, value)
        self._made.show()


def pixels(spi: Any, _select: Any) -> Channel:
    """A driver of LEDs."""
    made = importlib.import_module("adafruit_tlc59711").TLC59711(spi, pixel_count=4)
    return Channel(made)


def screen(spi: Any, select: Any) -> Any:
    """A display of an old telephone."""
    return importlib.import_module("adafruit_pcd8544").PCD8544(spi, Pin(), select)


# What makes the part, what is told how, and what leaves then.
ACTUATORS: dict[str, tuple[Callable[[Any, Any], Any], str, int, str]] = {
    "adafruit_74hc595": (shifted, "value", 0xA5, "a5"),
    "adafruit_max7219": (segments, "brightness()", 7, "0a07"),
    "adafruit_ssd1306": (display, "contrast()", 0x42, "42"),
    "adafruit_tlc59711": (pixels, "tell()", 0x8001, "8001" + 18 * "00"),
    "adafruit_pcd8544": (screen, "write_cmd()", 0x0D, "0d"),
    "adafruit_tlc5947": (lamp, "value", 0xABC, 34 * "00" + "0abc"),
}


@pytest.mark.parametrize("module", ACTUATORS)
async def test_what_is_told_leaves_as_the_part_wants_it(module: str) -> None:
    """A register with its latch, commands of two bytes, all outputs in one transfer."""
    pytest.importorskip(module, reason=f"{module} is not there")
    make, attribute, command, sent = ACTUATORS[module]
    bus = FakeSpi(chips={0: Answers(lambda _: b"")})
    device = AdafruitActuator(
        library=make, chip=0, attribute=attribute, safe=0, bus=bus
    )

    await called(device, ("write", command))

    assert bus.log[-1].sent.hex().endswith(sent)


def test_twenty_packages_are_tried_unchanged() -> None:
    """Each by its name: several chips of one package count once."""
    packages = {package(each).partition(".")[0] for each in SENSORS}

    assert len(packages | ACTUATORS.keys()) >= 20


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


async def test_what_a_call_did_not_send_does_not_leave_with_the_next_one() -> None:
    """Its time was over: the chip would take it for the begin of another transfer."""
    bus = FakeSpi(chips={0: SpiRegisters({0x02: 0x22})})
    await bus.open()
    spi = AdafruitSpi(bus, 0)
    back = bytearray(1)

    def read(register: int) -> None:
        spi.value = False
        try:
            spi.write(bytes([0x80 | register]))
            spi.readinto(back)
        finally:
            spi.value = True

    spi.allow(-1.0)
    with pytest.raises(TimeoutError):
        await bus.executor.call(read, 0x01, timeout=5.0)
    spi.allow(5.0)
    await bus.executor.call(read, 0x02, timeout=5.0)

    assert back == b"\x22"
    assert [each.sent for each in bus.log] == [b"\x82\0"]
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
