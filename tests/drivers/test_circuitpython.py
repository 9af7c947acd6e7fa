"""CircuitPython drivers from the package index, unchanged, each with its part's bytes."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import importlib
import re
import struct
from collections.abc import Callable
from typing import Any

import pytest
from adafruit_bus_device.i2c_device import (  # type: ignore[import-untyped]
    I2CDevice as AdafruitI2CDevice,
)

import esair
from esair.buses.i2c import Registers
from esair.drivers.adafruit import AdafruitActuator, AdafruitSensor
from esair.testing import FakeI2c

pytestmark = pytest.mark.real_clock


class Waits(Registers):
    """Registers with bits that are as the part sets them, whatever is written.

    Args:
        content: The registers.
        always: Their values that stay so, by register and the bits that do.
    """

    def __init__(
        self,
        content: dict[int, int | bytes],
        always: dict[int, tuple[int, int]] | None = None,
    ) -> None:
        super().__init__(content)
        self.always = always or {}

    def write(self, register: int, data: bytes) -> None:
        super().write(register, data)
        for place, (bits, value) in self.always.items():
            self.content[place] = self.content[place] & ~bits | value


class Sht31:
    """Takes commands of 16 bits; each word of its answer has a checksum."""

    def __init__(self) -> None:
        self.commands: list[bytes] = []

    def write(self, register: int, data: bytes) -> None:
        self.commands.append(bytes([register]) + data)

    def read(self, register: int, length: int) -> bytes:
        words = (0, 0) if length == 3 else (0x6666, 0x8000)
        told = (struct.pack(">H", word) for word in words)
        return b"".join(word + bytes([_crc(word)]) for word in told)[:length]


def _crc(data: bytes) -> int:
    value = 0xFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value << 1 ^ 0x31 if value & 0x80 else value << 1) & 0xFF
    return value


def _lsm6dsox() -> Waits:
    felt = struct.pack("<hhh", 16384, 0, -16384)
    return Waits({0x0F: 0x6C, 0x12: 0x04, 0x28: felt}, {0x12: (0x01, 0)})


def _vl53l0x() -> Waits:
    return Waits(
        {0xC0: b"\xee\xaa\x10", 0x1E: struct.pack(">H", 321)},
        {0x00: (0x01, 0), 0x13: (0xFF, 7), 0x83: (0xFF, 1)},
    )


class Ina219:
    """Registers of 16 bits: 12 V at the bus, 10 mV at the shunt."""

    def __init__(self) -> None:
        self.words = {0x01: 1000, 0x02: 3000 << 3, 0x00: 0x399F}

    def read(self, register: int, length: int) -> bytes:
        return struct.pack(">H", self.words.get(register, 0))

    def write(self, register: int, data: bytes) -> None:
        self.words[register] = int.from_bytes(data)


class Words:
    """Registers of 16 bits."""

    def __init__(self, words: dict[int, int], order: str = ">H") -> None:
        self.words = dict(words)
        self.order = order

    def read(self, register: int, length: int) -> bytes:
        told = struct.pack(self.order, self.words.get(register, 0))
        return told.ljust(length, b"\0")[:length]

    def write(self, register: int, data: bytes) -> None:
        if len(data) == 2:
            (self.words[register],) = struct.unpack(self.order, data)


class Told:
    """Answers the same whatever it was told."""

    def __init__(self, answer: bytes) -> None:
        self.answer = answer

    def read(self, register: int, length: int) -> bytes:
        return self.answer.ljust(length, b"\0")[:length]

    def write(self, register: int, data: bytes) -> None:
        """Take it."""


# What makes the part, its address, what is read and what that is.
SENSORS: dict[str, tuple[Callable[[], Any], int, str, Any]] = {
    "adafruit_sht31d:SHT31D": (Sht31, 0x44, "temperature", 25.0),
    "adafruit_lsm6ds.lsm6dsox:LSM6DSOX": (
        _lsm6dsox,
        0x6A,
        "acceleration",
        (19.6, 0.0, -19.6),
    ),
    "adafruit_vl53l0x:VL53L0X": (_vl53l0x, 0x29, "range", 321),
    "adafruit_ina219:INA219": (Ina219, 0x40, "bus_voltage", 12.0),
    "adafruit_ds3231:DS3231": (
        lambda: Registers({0x0E: b"\x1c\0\0\x19\x40"}),
        0x68,
        "temperature",
        25.25,
    ),
    "adafruit_lis3dh:LIS3DH_I2C": (
        lambda: Registers({0x0F: 0x33, 0xA8: struct.pack("<hhh", 16384, 0, 0)}),
        0x18,
        "acceleration",
        (9.806, 0.0, 0.0),
    ),
    "adafruit_tcs34725:TCS34725": (
        lambda: Registers({0x92: 0x44, 0x93: 1, 0x94: struct.pack("<4H", 4, 3, 2, 1)}),
        0x29,
        "color_raw",
        (3, 2, 1, 4),
    ),
    "adafruit_apds9960.apds9960:APDS9960": (
        lambda: Registers({0x92: 0xAB, 0x9C: 77}),
        0x39,
        "proximity",
        77,
    ),
    "adafruit_mcp9808:MCP9808": (
        lambda: Words({0x06: 0x0054, 0x07: 0x0400, 0x05: 25 << 4}),
        0x18,
        "temperature",
        25.0,
    ),
    "adafruit_pct2075:PCT2075": (
        lambda: Words({0x00: 25 << 8}),
        0x37,
        "temperature",
        25.0,
    ),
    "adafruit_bh1750:BH1750": (
        lambda: Told(struct.pack(">H", 1200)),
        0x23,
        "lux",
        500.0,
    ),
    "adafruit_ina260:INA260": (
        lambda: Words({0xFE: 0x5449, 0xFF: 0x2270, 0x02: 9600}),
        0x40,
        "voltage",
        12.0,
    ),
    "adafruit_veml7700:VEML7700": (
        lambda: Words({0x04: 4321}, "<H"),
        0x10,
        "light",
        4321,
    ),
    "adafruit_mcp230xx.mcp23008:MCP23008": (
        lambda: Registers({0x09: 0xA5}),
        0x20,
        "gpio",
        0xA5,
    ),
    "adafruit_as5600:AS5600": (
        lambda: Registers({0x0B: 0x20, 0x0C: b"\x04\x00"}),
        0x36,
        "raw_angle",
        1024,
    ),
    "adafruit_tmp117:TMP117": (
        lambda: Words({0x0F: 0x0117, 0x01: 0x2000, 0x00: 3200}),
        0x48,
        "temperature",
        25.0,
    ),
    "adafruit_adt7410:ADT7410": (
        lambda: Registers({0x0B: 0xCB, 0x02: 0, 0x00: struct.pack(">h", 25 * 128)}),
        0x48,
        "temperature",
        25.0,
    ),
    "adafruit_mcp4725:MCP4725": (
        lambda: Told(bytes((0xC0, 0x80, 0x00))),
        0x62,
        "raw_value",
        2048,
    ),
    "adafruit_ads7830.ads7830:ADS7830": (
        lambda: Told(b"\x80"),
        0x48,
        "read(0)",
        0x8000,
    ),
    "adafruit_bno055:BNO055_I2C": (
        lambda: Waits({0x00: 0xA0, 0x1A: struct.pack("<hhh", 16 * 90, 0, 0)}),
        0x28,
        "euler",
        (90.0, 0.0, 0.0),
    ),
}


def needs(library: str) -> None:
    module = library.partition(":")[0]
    package = module.partition(".")[0].removeprefix("adafruit_")
    gc.collect()  # errors of other tests keep views of the buffer that drivers share
    pytest.importorskip(
        module, reason=f"adafruit-circuitpython-{package} is not installed"
    )


async def called(device: Any, *calls: tuple[Any, ...]) -> Any:
    """Open a device on the thread of its bus, call its methods there, and close it."""
    await device.bus.open()
    result = None
    for name, *arguments in (("open",), *calls, ("close",)):
        method = getattr(device, name)
        result, before = (
            await device.bus.executor.call(method, *arguments, timeout=20.0),
            result,
        )
    await device.bus.close()
    return before


SLEEPY = {"adafruit_tmp117:TMP117", "adafruit_bno055:BNO055_I2C"}
"""Those whose drivers wait for a second at the start."""


@pytest.mark.parametrize(
    "library",
    [
        pytest.param(each, marks=[pytest.mark.long] if each in SLEEPY else [])
        for each in SENSORS
    ],
)
async def test_a_sensor_gives_what_its_part_measures(library: str) -> None:
    """Buffers, structures, paged registers, commands, checksums: by our bus."""
    needs(library)
    make, address, value, wanted = SENSORS[library]
    device = AdafruitSensor(
        library=library,
        value=value,
        bus=FakeI2c(chips={address: make()}),
    )
    assert await called(device, ("read",)) == pytest.approx(wanted, rel=1e-2)


def test_twenty_packages_are_tried_unchanged() -> None:
    """Each by its name: several chips of one package count once."""
    assert len({re.split("[.:]", each)[0] for each in SENSORS}) >= 20


def servo(i2c: Any, address: int) -> Any:
    """A servo at an output of a PCA9685, by two drivers."""
    board = importlib.import_module("adafruit_pca9685").PCA9685(i2c, address=address)
    board.frequency = 50
    return importlib.import_module("adafruit_motor.servo").Servo(board.channels[0])


@pytest.mark.parametrize(
    ("library", "attribute", "command", "written"),
    [
        ("adafruit_pca9685:PCA9685", "channels[0].duty_cycle", 0x8000, "00000008"),
        (servo, "angle", 45, "0000e600"),
    ],
)
async def test_an_actuator_tells_its_part(
    library: Any, attribute: str, command: int, written: str
) -> None:
    """The registers of an output: when it goes on, and off."""
    needs("adafruit_pca9685:PCA9685")
    needs("adafruit_motor.servo:Servo")
    bus = FakeI2c(chips={0x40: b""})
    device = AdafruitActuator(
        library=library, address=0x40, attribute=attribute, safe=0, bus=bus
    )
    await called(device, ("write", command))
    assert bus.chips[0x40].read(0x06, 4).hex() == written


@pytest.mark.long
@pytest.mark.promise("RES-4")
async def test_a_part_that_has_restarted_is_set_up_again() -> None:
    """Its rate is that of the data sheet then: it measures nothing."""
    library = "adafruit_lsm6ds.lsm6dsox:LSM6DSOX"
    needs(library)
    chip = _lsm6dsox()
    device = AdafruitSensor(
        name="imu",
        library=library,
        address=0x6A,
        value="acceleration",
        set_up={"accelerometer_data_rate": 4},
        bus=FakeI2c(chips={0x6A: chip}),
    )
    async with esair.Robot(resources=[device]) as robot, asyncio.timeout(20):
        set_up = chip.content[0x10]
        chip.power_cycle()
        assert chip.content[0x10] != set_up
        while not robot.resources.query("imu").losses:  # noqa: ASYNC110 - there is no event
            await asyncio.sleep(0.01)
        while robot.resources.query("imu").state is not esair.ResourceState.READY:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        assert chip.content[0x10] == set_up


class Waiting:
    """A driver that waits for its part without end, as many of them do."""

    def __init__(self, i2c: Any, address: int) -> None:
        self.device = AdafruitI2CDevice(i2c, address)

    @property
    def value(self) -> int:
        """The value, once it is there."""
        data = bytearray(1)
        while not data[0]:
            with self.device as device:
                device.write_then_readinto(b"\0", data)
        return data[0]


@pytest.mark.fault("D21")
@pytest.mark.promise("BUS-1")
async def test_a_driver_that_waits_without_end_keeps_no_other_one() -> None:
    """Nor its bus: its next transfer after the deadline ends it."""
    stuck, other = (
        AdafruitSensor(
            name=name,
            library=Waiting,
            address=0x10,
            value="value",
            bus=FakeI2c(name, chips={0x10: chip}),
        )
        for name, chip in (("stuck", b""), ("other", b"\7"))
    )
    stuck.deadline = 0.2
    async with esair.Robot(resources=[stuck, other]) as robot, asyncio.timeout(20):
        rights = [
            await robot.resources.register("me", each.name, esair.Access.READ)
            for each in (stuck, other)
        ]
        with pytest.raises((esair.DriverStuckError, esair.DeviceFaultError)):
            await robot.sensors.read(rights[0], fresh=True)
        await asyncio.sleep(0.5)
        assert (await robot.sensors.read(rights[1], fresh=True)).value == 7
        stuck.bus.chips[0x10].write(0, b"\5")
        while True:
            with contextlib.suppress(esair.EsairError):
                reading = await robot.sensors.read(rights[0], fresh=True)
                break
        assert reading.value == 5
