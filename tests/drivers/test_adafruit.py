"""CircuitPython drivers on an esair bus: three from the package index, unchanged."""

from __future__ import annotations

import asyncio
import errno
import subprocess
import sys
import time
from typing import Any

import adafruit_mpu6050  # type: ignore[import-untyped]
import pytest
from adafruit_ads1x15 import ADS1115, AnalogIn
from adafruit_bus_device.i2c_device import I2CDevice  # type: ignore[import-untyped]
from tests.patience import within

import esair
from esair.drivers.adafruit import AdafruitActuator, AdafruitBus, AdafruitSensor
from esair.drivers.ads1115.fake import FakeAds1115
from esair.drivers.bme280 import Bme280, Climate
from esair.drivers.bme280.fake import FakeBme280
from esair.drivers.mpu6050 import GRAVITY, Motion
from esair.drivers.mpu6050.fake import FakeMpu6050
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.testing import ActuatorContract, FakeI2c, SensorContract

BME280 = "adafruit_bme280.basic:Adafruit_BME280_I2C"
MPU6050 = "adafruit_mpu6050:MPU6050"

FELT = Motion((1.0, -2.0, GRAVITY), (0.5, -1.0, 2.0), 30.0)


def voltage_of(channel: int) -> Any:
    """Return what makes an analog input of Adafruit's on a bus."""
    return lambda i2c, **options: AnalogIn(ADS1115(i2c, **options), channel)


def chips() -> dict[int, Any]:
    return {
        0x76: FakeBme280(Climate(23.5, 0.4, 99_000.0)),
        0x68: FakeMpu6050(FELT),
        0x48: FakeAds1115(0.0, 1.25),
    }


class Unplugged:
    """How the devices of this file are unplugged."""

    silent_for = 1.0

    async def unplug(self, device: Any) -> None:
        device.bus.unplug(noticed=False)

    async def silence(self, device: Any) -> None:
        for address in device.bus.chips:
            device.bus.silent(address)

    async def speak(self, device: Any) -> None:
        for address in device.bus.chips:
            device.bus.silent(address, silent=False)

    async def power_cycle(self, device: Any) -> None:
        for chip in device.bus.chips.values():
            getattr(chip, "power_cycle", lambda: None)()

    keeps_nothing = "each call of the driver says all that the part needs"


@pytest.mark.virtual_clock
class TestBme280(Unplugged, SensorContract):
    """adafruit_bme280 as a sensor: two transfers for each read, by buffers."""

    def make(self) -> AdafruitSensor:
        return AdafruitSensor(
            library=BME280,
            address=0x76,
            value="temperature",
            bus=FakeI2c(chips=chips()),
        )


@pytest.mark.virtual_clock
class TestAds1115(Unplugged, SensorContract):
    """adafruit_ads1x15: polls until a conversion is done, with no pause."""

    def make(self) -> AdafruitSensor:
        return AdafruitSensor(
            library=voltage_of(1), value="voltage", bus=FakeI2c(chips=chips())
        )


@pytest.mark.virtual_clock
class TestMpu6050(Unplugged, SensorContract):
    """adafruit_mpu6050: after a restart it sleeps, and gives the last values for ever."""

    def make(self) -> AdafruitSensor:
        return AdafruitSensor(
            library=MPU6050,
            value="acceleration",
            set_up={"gyro_range": 2, "sleep": False},
            bus=FakeI2c(chips=chips()),
        )


@pytest.mark.virtual_clock
@pytest.mark.promise("RES-4")
async def test_all_that_is_on_a_part_notices_that_it_has_restarted() -> None:
    """The first one to notice sets it up again, which is what the others look at."""
    chip = FakeMpu6050(FELT)
    bus = FakeI2c(chips={0x68: chip})
    parts = [
        AdafruitSensor(
            name=value,
            library=MPU6050,
            value=value,
            set_up={"gyro_range": 2, "sleep": False},
            bus=bus,
        )
        for value in ("acceleration", "gyro")
    ]
    async with esair.Robot(resources=parts[:1]) as robot:
        await asyncio.sleep(0.5)
        await robot.resources.add(parts[1])
        await asyncio.sleep(3.2)
        chip.power_cycle()
        await asyncio.sleep(3.0)
        losses = [robot.resources.query(part.name).losses for part in parts]
        assert losses == [1, 1]


@pytest.mark.virtual_clock
@pytest.mark.parametrize("address", [None, 0x68])
async def test_a_part_has_one_set_up(address: int | None) -> None:
    """Each opening would undo the other's for ever; the second one says so."""
    bus = FakeI2c(chips={0x68: FakeMpu6050(FELT)})

    def part(value: str, wanted: int, address: int | None = None) -> AdafruitSensor:
        told = {"gyro_range": wanted, "sleep": False}
        return AdafruitSensor(
            name=value,
            library=MPU6050,
            address=address,
            value=value,
            set_up=told,
            bus=bus,
        )

    parts = [part("acceleration", 1), part("gyro", 2, address)]
    async with esair.Robot(resources=parts) as robot:
        await asyncio.sleep(10.0)
        first, second = (robot.resources.query(part.name) for part in parts)
        assert (first.state, first.losses) == (esair.ResourceState.READY, 0)
        assert "expected that of 'acceleration'" in str(second.error)


@pytest.mark.virtual_clock
async def test_a_driver_that_resets_its_part_hides_that_from_nobody() -> None:
    """Who has set it up sets it up anew, before its next value is taken."""
    bus = FakeI2c(chips={0x68: FakeMpu6050(FELT)})
    plain = AdafruitSensor(name="heat", library=MPU6050, value="temperature", bus=bus)
    gyro = AdafruitSensor(
        name="gyro", library=MPU6050, value="gyro", set_up={"gyro_range": 2}, bus=bus
    )
    async with esair.Robot(resources=[gyro]) as robot:
        await asyncio.sleep(3.1)
        await robot.resources.add(plain)
        assert robot.resources.query("gyro").losses == 1


@pytest.mark.real_clock
@pytest.mark.parametrize(
    ("library", "path", "told"),
    [
        (BME280, "sea_level_pressure", r"set_up\.sea_level_pressure: .* remembers"),
        (MPU6050, "registers[0]", r"set_up\.registers\[0\]: expected an attribute"),
        (MPU6050, "reset()", "expected an attribute"),
    ],
)
async def test_a_set_up_that_would_not_show_a_restart_is_refused(
    library: str, path: str, told: str
) -> None:
    """What the driver has in its own memory is there after a restart of the part."""
    bus = FakeI2c(chips=chips())

    async def opened() -> None:
        part = AdafruitSensor(
            library=library,
            address=0x76 if library == BME280 else 0x68,
            value="temperature",
            set_up={path: 1000.0},
            bus=bus,
        )
        await session(part, "open")

    with pytest.raises(ConfigError, match=told):
        await opened()
    await bus.close()


class Dac:
    """A driver in the style of CircuitPython's, of a part with one register."""

    def __init__(self, i2c: Any, address: int = 0x60) -> None:
        self._device = I2CDevice(i2c, address)
        self.outputs = [self]

    def _write(self, value: int) -> None:
        with self._device as device:
            device.write(bytes([0x00, value, 0xEE]), end=2)

    value = property(fset=_write)

    def set_output(self, value: int) -> None:
        """Set the output, as a method."""
        self._write(value)


@pytest.mark.virtual_clock
class TestActuator(Unplugged, ActuatorContract):
    """An attribute of a driver as an actuator."""

    def make(self) -> AdafruitActuator:
        return AdafruitActuator(
            library=Dac,
            attribute="outputs[0].value",
            safe=0,
            limits=(0, 255),
            bus=FakeI2c(chips={0x60: b""}),
        )

    def commands(self) -> list[int]:
        return [1, 255]


class Patient:
    """A driver that asks its part until it is ready, however long that takes."""

    def __init__(self, i2c: Any) -> None:
        self.i2c = i2c

    @property
    def value(self) -> int:
        """The value, once it is there."""
        data = bytearray(1)
        while not data[0]:
            self.i2c.writeto_then_readfrom(0x10, b"\0", data)
        return data[0]


@pytest.mark.virtual_clock
@pytest.mark.fault("D21")
async def test_waiting_without_end_ends_on_the_virtual_clock_too() -> None:
    """Transfers of a fake take no time there, but only so many fit into a deadline."""
    bus = FakeI2c(chips={0x10: b""})
    sensor = AdafruitSensor(library=Patient, name="slow", value="value", bus=bus)
    sensor.deadline = 0.05
    async with esair.Robot(resources=[sensor]) as robot:
        right = await robot.resources.register("me", "slow", esair.Access.READ)
        with pytest.raises((esair.DeviceFaultError, esair.DriverStuckError)):
            await robot.sensors.read(right, fresh=True)
        bus.chips[0x10].write(0, b"\5")
        assert (await robot.sensors.read(right, fresh=True)).value == 5


@pytest.mark.real_clock
async def test_an_error_that_is_kept_keeps_no_buffer() -> None:
    """The next driver that is imported may make the buffer that all share longer."""
    bus, buffer = FakeI2c(chips={}), bytearray(4)
    await bus.open()

    def read() -> None:
        AdafruitBus(bus).readfrom_into(0x10, buffer)

    with pytest.raises(esair.DeviceFaultError) as kept:
        await bus.executor.call(read, timeout=5.0)
    buffer.extend(b"1")
    assert kept.value.__traceback__ is not None
    await bus.close()


async def session(sensor: AdafruitSensor | AdafruitActuator, *calls: str) -> Any:
    """Open the device on the thread of its bus, and call its methods there."""
    await sensor.bus.open()
    result = None
    for call in calls:
        result = await sensor.bus.executor.call(getattr(sensor, call), timeout=10.0)
    return result


@pytest.mark.real_clock
async def test_bme280_reads_what_esairs_own_driver_reads() -> None:
    """Two implementations of the compensation, one chip."""
    bus = FakeI2c(chips=chips())
    sensor = AdafruitSensor(
        library=BME280,
        address=0x76,
        value=["temperature", "relative_humidity", "pressure"],
        bus=bus,
    )

    theirs = await session(sensor, "open", "read")
    own = Bme280(bus=bus)
    await own.open()
    ours = await own.read()

    assert ours.temperature == pytest.approx(theirs["temperature"], abs=0.01)
    assert ours.humidity == pytest.approx(theirs["relative_humidity"] / 100, abs=0.001)
    assert ours.pressure == pytest.approx(theirs["pressure"] * 100, abs=2.0)
    await bus.close()


@pytest.mark.real_clock
async def test_mpu6050_reads_what_the_chip_feels() -> None:
    """It resets the chip, wakes it, and reads arrays of registers."""
    bus = FakeI2c(chips=chips())
    sensor = AdafruitSensor(
        library=MPU6050, value=("acceleration", "gyro", "temperature"), bus=bus
    )

    motion = await session(sensor, "open", "read")

    assert motion["acceleration"] == pytest.approx(FELT.acceleration, abs=0.003)
    assert motion["gyro"] == pytest.approx(FELT.turn_rate, abs=0.002)
    assert motion["temperature"] == pytest.approx(30.0, abs=0.01)
    await bus.close()


@pytest.mark.real_clock
async def test_ads1115_reads_the_voltage_at_its_input() -> None:
    """Made by a function, for its object needs another one; with keywords of its own."""
    bus = FakeI2c(chips=chips())
    sensor = AdafruitSensor(
        library=voltage_of(1), value="voltage", arguments={"gain": 2}, bus=bus
    )

    assert await session(sensor, "open", "read") == pytest.approx(1.25, abs=1e-4)
    assert bus.chips[0x48].conversions[-1] == "1"
    await bus.close()


@pytest.mark.virtual_clock
async def test_it_lives_in_a_robot_beside_esairs_own_drivers() -> None:
    """On a virtual clock too: the driver's thread is waited for."""
    bus = FakeI2c(chips=chips())
    theirs = AdafruitSensor(
        name="theirs",
        library=BME280,
        address=0x76,
        value="temperature",
        bus=bus,
        rate=5.0,
    )
    ours = Bme280(name="ours", bus=bus)
    needs: dict[str, Any] = {
        "theirs": esair.reads(float),
        "ours": esair.reads(Climate),
    }
    user = esair.Behavior(name="user", reads=needs, writes={})

    async with esair.Robot(resources=[theirs, ours], behaviors=[user]):
        assert await user.theirs.read() == pytest.approx(23.5, abs=0.02)
        assert (await user.ours.read()).temperature == pytest.approx(23.5, abs=0.02)

        bus.unplug()
        await asyncio.sleep(1.0)
        with pytest.raises(DeviceLostError):
            await user.theirs.read()
        bus.plug()
        await asyncio.sleep(5.0)
        assert await user.theirs.read() == pytest.approx(23.5, abs=0.02)


@pytest.mark.real_clock
@pytest.mark.fault("I05")
async def test_no_transfer_of_another_comes_into_a_call_of_the_driver() -> None:
    """The bus is busy with it from its first transfer to its last."""
    bus = FakeI2c(chips=chips(), timeout=10.0)
    sensor = AdafruitSensor(library=BME280, address=0x76, value="temperature", bus=bus)
    await session(sensor, "open")
    bus.link.log.clear()

    await asyncio.gather(
        *(bus.executor.call(sensor.read, timeout=10.0) for _ in range(10)),
        *(bus.read(0x68, 0x75) for _ in range(50)),
    )

    order = "".join("a" if each.address == 0x76 else "b" for each in bus.log)
    runs = [run for run in order.split("b") if run]
    assert order.count("b") == 50
    whole = len(order.replace("b", "")) // 10
    assert whole > 4
    assert all(len(run) % whole == 0 for run in runs)
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.longer
@pytest.mark.fault("I05")
async def test_drivers_on_two_buses_do_not_share_their_buffer(request) -> None:
    """adafruit_register has one for the whole process; two threads would mix it up."""

    def giving_way(i2c: Any) -> Any:
        """Make a driver whose thread gives way wherever it locks and unlocks."""

        def give_way() -> bool:
            time.sleep(0)
            return True

        i2c.try_lock = i2c.unlock = give_way
        return adafruit_mpu6050.MPU6050(i2c)

    felt = [
        Motion((0.0, 0.0, sign * GRAVITY), (0.0, 0.0, 0.0), 25.0) for sign in (1, -1)
    ]
    sensors = [
        AdafruitSensor(
            name=f"imu_{n}",
            library=giving_way,
            value="acceleration",
            bus=FakeI2c(f"bus_{n}", chips={0x68: FakeMpu6050(motion)}, timeout=10.0),
        )
        for n, motion in enumerate(felt)
    ]
    for sensor in sensors:
        await session(sensor, "open")
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        values = await asyncio.gather(
            *(
                sensor.bus.executor.call(sensor.read, timeout=20.0)
                for _ in range(200 if request.config.getoption("--esair-long") else 20)
                for sensor in sensors
            )
        )
    finally:
        sys.setswitchinterval(interval)

    assert {round(z, 1) for _, _, z in values[0::2]} == {9.8}
    assert {round(z, 1) for _, _, z in values[1::2]} == {-9.8}
    for sensor in sensors:
        await sensor.bus.close()


@pytest.mark.real_clock
@pytest.mark.longer
async def test_a_stuck_bus_does_not_hold_up_drivers_on_another() -> None:
    """They fail in time, by name, and go on when it does."""
    left, right = (
        FakeI2c(name, chips=chips(), timeout=0.1) for name in ("left", "right")
    )
    sensors = []
    for bus in (left, right):
        sensor = AdafruitSensor(
            name=f"air_{bus.name}",
            library=BME280,
            address=0x76,
            value="temperature",
            bus=bus,
        )
        sensor.deadline = 0.4
        await session(sensor, "open")
        sensors.append(sensor)
    left.stall()
    with pytest.raises(DriverStuckError):
        await left.executor.call(sensors[0].read, timeout=0.05)

    begin = time.monotonic()
    with pytest.raises(DriverStuckError, match=r"'air_right'.*on another bus"):
        await right.executor.call(sensors[1].read, timeout=5.0)
    assert within(2.0, time.monotonic() - begin)
    assert await right.read(0x68, 0x75) == b"\x68"

    left.resume()
    assert await right.executor.call(sensors[1].read, timeout=5.0) == pytest.approx(
        23.5, abs=0.1
    )
    await left.close()
    await right.close()


@pytest.mark.real_clock
@pytest.mark.fault("I01", "I02")
@pytest.mark.parametrize(
    "code", [errno.ENXIO, errno.EREMOTEIO, errno.EIO, errno.EPROTO]
)
async def test_a_failed_transfer_is_the_drivers_to_see(code: int) -> None:
    """It gets an OSError with its number, as it would from busio; nothing is repeated."""
    bus = FakeI2c(chips=chips())
    sensor = AdafruitSensor(library=BME280, address=0x76, value="temperature", bus=bus)
    await session(sensor, "open", "read")
    bus.fail(code)

    with pytest.raises(DeviceFaultError) as caught:
        await session(sensor, "read")

    assert caught.value.errno == code
    assert bus.stats.retries == 0
    assert await session(sensor, "read") == pytest.approx(23.5, abs=0.1)
    await bus.close()


@pytest.mark.real_clock
async def test_a_part_that_is_not_there_is_lost_though_the_driver_says_otherwise() -> (
    None
):
    """adafruit_bus_device makes a ValueError of it: no device at the address."""
    bus = FakeI2c(chips={})
    sensor = AdafruitSensor(library=BME280, address=0x76, value="temperature", bus=bus)
    with pytest.raises(DeviceLostError, match="No I2C device at address: 0x76"):
        await session(sensor, "open")

    bus.unplug(noticed=False)
    with pytest.raises(DeviceLostError):
        await bus.executor.call(sensor.open, timeout=5.0)
    async with asyncio.timeout(5.0):
        while bus.is_open:  # noqa: ASYNC110 - it is told in a turn of the loop
            await asyncio.sleep(0.001)
    with pytest.raises(DeviceLostError):
        await bus.executor.call(sensor.open, timeout=5.0)
    await bus.close()
    bus.executor.close()


@pytest.mark.real_clock
async def test_the_bus_looks_like_busio() -> None:
    """Slices of buffers, text, a scan, a lock, and nothing that closes the bus."""
    bus = FakeI2c(chips={0x50: bytes(range(256)), 0x20: b""})
    await bus.open()

    def use() -> None:
        with AdafruitBus(bus) as i2c:
            assert i2c.try_lock()
            assert i2c.scan() == [0x20, 0x50]
            buffer = bytearray(6)
            i2c.writeto(0x50, b"\xff\x10\xff", start=1, end=2)
            i2c.readfrom_into(0x50, buffer, start=1, end=4)
            assert buffer == bytes([0, 0x10, 0x11, 0x12, 0, 0])
            i2c.writeto_then_readfrom(
                0x50, b"\x00\x40", buffer, out_start=1, in_start=4
            )
            assert buffer == bytes([0, 0x10, 0x11, 0x12, 0x40, 0x41])
            i2c.writeto_then_readfrom(0x50, b"\x30\x00", buffer, out_end=1, in_end=1)
            assert buffer[0] == 0x30
            i2c.writeto(0x20, "\x05\xe9")
            i2c.writeto(0x20, b"")
            i2c.unlock()

    await bus.executor.call(use, timeout=5.0)
    assert bus.is_open
    assert await bus.read(0x20, 5) == b"\xe9"
    with pytest.raises(RuntimeError, match="thread of the bus"):
        AdafruitBus(bus).scan()
    await bus.close()


@pytest.mark.real_clock
async def test_an_actuator_may_be_an_attribute_or_a_method() -> None:
    """The command is assigned, or the method is called with it."""
    bus = FakeI2c(chips={0x60: b"", 0x61: b""})
    for address, attribute in ((0x60, "value"), (0x61, "outputs[0].set_output()")):
        actuator = AdafruitActuator(
            library=f"{__name__}:Dac" if __name__ in sys.modules else Dac,
            attribute=attribute,
            safe=0,
            address=address,
            bus=bus,
        )
        await session(actuator, "open")
        await bus.executor.call(actuator.write, 0x42, timeout=5.0)
        assert await bus.read(address, 0x00, 2) == b"\x42\x00"
    assert actuator.value_type is int
    await bus.close()


@pytest.mark.parametrize(
    ("options", "field", "told"),
    [
        ({"library": "adafruit_bme280.basic"}, "library", "module:Class"),
        ({"library": "adafruit_none:X"}, "library", "adafruit-circuitpython"),
        ({"library": "adafruit_bme280.basic:Nothing"}, "library", "Nothing"),
        ({"library": "adafruit_bme280.basic:OVERSCAN_X1"}, "library", "no class"),
        ({"value": "__import__('os')"}, "value", "temperature"),
        ({"value": "a..b"}, "value", "temperature"),
        ({"value": []}, "value", "at least one"),
    ],
)
def test_its_mistakes_are_named(options, field, told) -> None:
    """Before anything is opened."""
    with pytest.raises(ConfigError, match=told) as caught:
        AdafruitSensor(**{"library": BME280, "value": "temperature", **options})

    assert caught.value.field == field


def test_an_actuator_needs_something_to_assign_to() -> None:
    """An element of a list is none."""
    with pytest.raises(ConfigError, match="attribute"):
        AdafruitActuator(library=Dac, attribute="outputs[0]", safe=0)


@pytest.mark.real_clock
async def test_it_is_closed_before_it_is_opened() -> None:
    """Reading then is a loss, not a mistake of the driver."""
    bus = FakeI2c(chips=chips())
    sensor = AdafruitSensor(library=BME280, address=0x76, value="temperature", bus=bus)
    with pytest.raises(DeviceLostError, match="not open"):
        await session(sensor, "read")
    await session(sensor, "open", "read", "close")
    with pytest.raises(DeviceLostError, match="not open"):
        await session(sensor, "read")
    await bus.close()


def test_the_drivers_need_no_board() -> None:
    """Blinka is imported by them, but no pins, and nothing of a board is asked for."""
    run = subprocess.run(
        [
            sys.executable,
            "-W",
            "error",
            "-c",
            "import sys, adafruit_bme280.basic, adafruit_mpu6050, adafruit_ads1x15\n"
            "print('board' in sys.modules, 'microcontroller.pin' in sys.modules)",
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )

    assert run.stdout.split() == ["False", "False"]
