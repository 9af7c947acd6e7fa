"""The BME280: its compensation, against the data sheet and other implementations."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.parts import OnChip

from esair.drivers.bme280 import (
    Bme280,
    Calibration,
    Climate,
    compensate,
    fine_temperature,
    humidity_of,
    measuring_time,
    pressure_of,
)
from esair.drivers.bme280.fake import CALIBRATION, FakeBme280
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.testing import FakeI2c, SensorContract

NONE = Calibration((0, 0, 0), (0,) * 9, (0,) * 6)


def block(pressure: int, temperature: int, humidity: int) -> bytes:
    """Return the eight registers of raw numbers."""
    return (
        (pressure << 4).to_bytes(3, "big")
        + (temperature << 4).to_bytes(3, "big")
        + humidity.to_bytes(2, "big")
    )


def floating_humidity(raw: int, fine: int, calibration: Calibration) -> float:
    """Compensate as the maker's reference does in floating point (appendix A)."""
    h1, h2, h3, h4, h5, h6 = calibration.h
    h = fine - 76800.0
    h = (raw - (h4 * 64.0 + h5 / 16384.0 * h)) * (
        h2 / 65536.0 * (1.0 + h6 / 67108864.0 * h * (1.0 + h3 / 67108864.0 * h))
    )
    h *= 1.0 - h1 * h / 524288.0
    return max(0.0, min(100.0, h)) / 100.0


def test_the_example_of_the_data_sheet() -> None:
    """Section 3.12 of the BMP280's: 25.08 °C and 100653.27 Pa, step by step."""
    fine = fine_temperature(519888, CALIBRATION)

    assert fine == 128422
    assert pressure_of(415148, fine, CALIBRATION) == pytest.approx(100653.27, abs=0.05)
    climate = compensate(block(415148, 519888, 30000), CALIBRATION)
    assert climate.temperature == 25.08
    assert climate.pressure == pytest.approx(100653.27, abs=0.05)


@given(raw=st.integers(0, 65535), fine=st.integers(-204800, 435200))
def test_humidity_agrees_with_the_floating_point_of_the_maker(raw, fine) -> None:
    """Over the whole range of temperatures, to a tenth of a percent."""
    assert humidity_of(raw, fine, CALIBRATION) == pytest.approx(
        floating_humidity(raw, fine, CALIBRATION), abs=0.001
    )


@given(
    temperature=st.floats(-40.0, 85.0),
    humidity=st.floats(0.05, 0.95),
    pressure=st.floats(30_000.0, 110_000.0),
)
def test_what_the_fake_feels_is_what_is_read(temperature, humidity, pressure) -> None:
    """To the resolution of the chip."""
    chip = FakeBme280(Climate(temperature, humidity, pressure))
    chip.write(0xF2, b"\x01")
    chip.write(0xF4, b"\x25")

    climate = compensate(chip.read(0xF7, 8), CALIBRATION)

    assert climate.temperature == pytest.approx(temperature, abs=0.02)
    assert climate.humidity == pytest.approx(humidity, abs=0.002)
    assert climate.pressure == pytest.approx(pressure, abs=10.0)


@given(
    t=st.tuples(st.integers(0, 65535), *[st.integers(-32768, 32767)] * 2),
    p=st.tuples(st.integers(0, 65535), *[st.integers(-32768, 32767)] * 8),
    h=st.tuples(
        st.integers(0, 255), st.integers(-32768, 32767), st.integers(0, 255),
        *[st.integers(-2048, 2047)] * 2, st.integers(-128, 127),
    ),
)  # fmt: skip
def test_a_calibration_comes_back(t, p, h) -> None:
    """Also the two numbers that share a register, with their signs."""
    calibration = Calibration(t, p, h)
    first, second = calibration.encode()

    assert (len(first), len(second)) == (26, 7)
    assert Calibration.decode(first, second) == calibration


@pytest.mark.fault("D26")
@given(
    data=st.binary(min_size=8, max_size=8),
    first=st.binary(min_size=26, max_size=26),
    second=st.binary(min_size=7, max_size=7),
)
def test_no_registers_give_a_value_that_is_none(data, first, second) -> None:
    """Whatever comes: numbers, or an error that the driver knows."""
    try:
        climate = compensate(data, Calibration.decode(first, second))
    except (ValueError, ZeroDivisionError):
        return
    assert all(
        map(math.isfinite, (climate.temperature, climate.humidity, climate.pressure))
    )
    assert 0.0 <= climate.humidity <= 1.0


class TestBme280(OnChip, SensorContract):
    """What every sensor must do."""

    def make(self) -> Bme280:
        return Bme280(bus=FakeI2c(chips={0x76: FakeBme280()}))


async def sensor_on(chip: FakeBme280, **settings: Any) -> Bme280:
    """Make a sensor on a bus with one chip."""
    bus = FakeI2c(chips={0x76: chip})
    await bus.open()
    sensor = Bme280(bus=bus, **settings)
    await sensor.open()
    return sensor


@pytest.mark.virtual_clock
@pytest.mark.parametrize("oversampling", [1, 2, 4, 8, 16])
async def test_each_reading_is_a_measurement_of_its_own(oversampling: int) -> None:
    """It is waited for as long as the data sheet says, and until the chip is done."""
    chip = FakeBme280(Climate(20.0, 0.5, 100_000.0))
    sensor = await sensor_on(chip, oversampling=oversampling)
    loop = asyncio.get_running_loop()
    chip.busy = 3

    begin = loop.time()
    first = await sensor.read()
    lasted = loop.time() - begin
    chip.climate = Climate(30.0, 0.5, 100_000.0)
    second = await sensor.read()

    assert first.temperature == pytest.approx(20.0, abs=0.02)
    assert second.temperature == pytest.approx(30.0, abs=0.02)
    assert chip.measurements == 2
    assert measuring_time(oversampling) <= lasted <= measuring_time(oversampling) + 0.01


@pytest.mark.virtual_clock
async def test_settings_are_in_the_chip() -> None:
    """Humidity's before the others, for it counts with the next of those."""
    chip = FakeBme280()
    sensor = await sensor_on(chip, oversampling=4, smoothing=16)
    assert chip.read(0xF2, 1) == b"\x03"
    assert chip.read(0xF5, 1) == b"\x10"

    await sensor.apply(oversampling=2)
    await sensor.read()

    assert chip.read(0xF2, 1) == b"\x02"
    assert chip.read(0xF4, 1)[0] & 0xFC == 2 << 5 | 2 << 2


@pytest.mark.virtual_clock
@pytest.mark.fault("D05")
@pytest.mark.parametrize(("found", "what"), [(0x58, "BMP280"), (0x61, "another chip")])
async def test_another_chip_at_the_address_is_refused(found: int, what: str) -> None:
    """The sensor without humidity is named, for it looks the same."""
    bus = FakeI2c(chips={0x76: {0xD0: found}})
    await bus.open()

    with pytest.raises(DeviceFaultError, match=f"{found:#04x}.*{what}"):
        await Bme280(bus=bus).open()

    assert [each.written for each in bus.log] == [b"\xd0"]


@pytest.mark.virtual_clock
async def test_a_chip_that_has_lost_its_power_is_lost() -> None:
    """Its settings are gone: what it gives is not taken for a value."""
    chip = FakeBme280()
    sensor = await sensor_on(chip)
    await sensor.read()

    chip.write(0xE0, b"\xb6")
    with pytest.raises(DeviceLostError, match=r"settings are gone.*lost its power"):
        await sensor.read()

    await sensor.open()
    assert (await sensor.read()).temperature == pytest.approx(21.0, abs=0.02)


@pytest.mark.virtual_clock
@pytest.mark.fault("D26")
@pytest.mark.parametrize("place", [0, 1, 2])
async def test_a_value_may_be_the_number_of_what_was_not_measured(place: int) -> None:
    """One air temperature, near 26 °C, is that number, and one humidity."""
    usual = [0x65A00, 0x7FF00, 0x6000]
    chip = FakeBme280()
    chip.raw = (usual[0], usual[1], usual[2])
    sensor = await sensor_on(chip)
    before = await sensor.read()

    usual[place] = [0x80000, 0x80000, 0x8000][place]
    chip.raw = (usual[0], usual[1], usual[2])
    value = await sensor.read()

    assert value == compensate(block(*usual), CALIBRATION)
    assert value != before


def test_what_nothing_was_measured_of_is_no_climate() -> None:
    """All three numbers of a chip that has only just got its power."""
    with pytest.raises(ValueError, match="not measured"):
        compensate(block(0x80000, 0x80000, 0x8000), CALIBRATION)


@pytest.mark.virtual_clock
async def test_a_measurement_that_does_not_end_is_a_fault() -> None:
    """It is not waited for for ever, and an old value is not given."""
    chip = FakeBme280()
    sensor = await sensor_on(chip)
    chip.busy = 1000

    with pytest.raises(DeviceFaultError, match="does not end"):
        await sensor.read()


@pytest.mark.virtual_clock
async def test_a_chip_without_calibration_is_at_fault() -> None:
    """Nothing is divided by its zeros."""
    sensor = await sensor_on(FakeBme280(calibration=CALIBRATION))
    sensor.bus.chips[0x76] = FakeBme280(calibration=NONE)
    sensor.bus.chips[0x76].raw = (415148, 519888, 30000)
    await sensor.open()

    with pytest.raises(DeviceFaultError, match="memory"):
        await sensor.read()


@pytest.mark.virtual_clock
async def test_it_measures_nothing_before_it_is_open() -> None:
    """Its calibration is read at the opening."""
    with pytest.raises(DeviceFaultError, match="not open"):
        await Bme280(bus=FakeI2c()).read()
