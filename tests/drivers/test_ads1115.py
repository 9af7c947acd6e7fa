"""The ADS1115: registers to volts, and several sensors on one chip."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.parts import OnChip

import esair
from esair.drivers.ads1115 import (
    CHANNELS,
    DATA_RATES,
    FULL_SCALES,
    Ads1115,
    config_for,
    decode_volts,
)
from esair.drivers.ads1115.fake import FakeAds1115
from esair.exceptions import DeviceFaultError
from esair.testing import FakeI2c, SensorContract, VirtualLoop


@pytest.mark.parametrize(
    ("block", "full_scale", "volts"),
    [("7fff", 4.096, 4.095875), ("8000", 4.096, -4.096), ("0001", 2.048, 0.0000625),
     ("ffff", 0.256, -0.0000078125), ("0000", 6.144, 0.0)],
)  # fmt: skip
def test_a_conversion_is_a_signed_part_of_the_full_scale(
    block: str, full_scale: float, volts: float
) -> None:
    """Table 3 and 6 of the data sheet: FSR / 32768 is one count."""
    assert decode_volts(bytes.fromhex(block), full_scale) == pytest.approx(volts)


def test_the_configuration_is_that_of_the_data_sheet() -> None:
    """After power-up it is 0x8583, which a latch of no comparator tells from ours."""
    assert config_for("0-1", 2.048, 128) == 0x8583 | 4
    assert config_for("3", 0.256, 860) == 0xFBE3 | 4


@given(
    channel=st.sampled_from(sorted(CHANNELS)),
    full_scale=st.sampled_from(FULL_SCALES),
    data_rate=st.sampled_from(DATA_RATES),
    inputs=st.tuples(*[st.floats(-6.5, 6.5)] * 4),
)
def test_what_is_at_the_inputs_is_what_is_read(
    channel, full_scale, data_rate, inputs
) -> None:
    """Within one count, or at the end of the scale."""
    chip = FakeAds1115(*inputs)
    chip.busy = 0
    chip.write(1, config_for(channel, full_scale, data_rate).to_bytes(2, "big"))

    volts = decode_volts(chip.read(0, 2), full_scale)

    plus, _, minus = channel.partition("-")
    true = inputs[int(plus)] - (inputs[int(minus)] if minus else 0.0)
    limited = max(-full_scale, min(full_scale * 32767 / 32768, true))
    assert volts == pytest.approx(limited, abs=full_scale / 32768)


class TestAds1115(OnChip, SensorContract):
    """What every sensor must do."""

    def make(self) -> Ads1115:
        return Ads1115(channel=2, bus=FakeI2c(chips={0x48: FakeAds1115(0, 0, 1.5)}))

    keeps_nothing = "each conversion says all that the chip needs"


@pytest.mark.promise("ROB-5")
def test_one_robot_after_another_has_the_chip() -> None:
    """Each in a loop of its own; who waits for the other's turn belongs to one of them."""
    bus = FakeI2c(chips={0x48: FakeAds1115(0.5, 1.25)})
    sensors = [Ads1115(name=f"input_{n}", channel=n, bus=bus) for n in range(2)]
    reads = {each.name: esair.reads(float) for each in sensors}

    async def live() -> None:
        user: Any = esair.Behavior(name="user", reads=reads)
        async with esair.Robot(resources=sensors, behaviors=[user]):
            ports = user.input_0, user.input_1
            volts = await asyncio.gather(*(each.read(fresh=True) for each in ports))
            assert volts == pytest.approx([0.5, 1.25], abs=1e-3)

    for _ in range(2):
        with asyncio.Runner(loop_factory=VirtualLoop) as runner:
            runner.run(live())


async def sensors_on(chip: FakeAds1115, *channels: int | str, **settings: Any) -> Any:
    """Make sensors on a bus with one chip."""
    bus = FakeI2c(chips={0x48: chip})
    await bus.open()
    sensors = [
        Ads1115(
            name=f"input_{str(channel).replace('-', '_')}",
            channel=channel,
            bus=bus,
            **settings,
        )
        for channel in channels
    ]
    for sensor in sensors:
        await sensor.open()
    return sensors


@pytest.mark.virtual_clock
@pytest.mark.fault("I07")
async def test_sensors_of_one_chip_convert_in_turn() -> None:
    """Nobody reads the conversion of another input, though a conversion takes long."""
    chip = FakeAds1115(0.1, 0.2, 0.3, 0.4)
    chip.busy = 3
    channels: list[int | str] = [0, 1, 2, 3, "0-1"]
    sensors = await sensors_on(chip, *channels, full_scale=0.512, data_rate=860)

    for _ in range(3):
        values = await asyncio.gather(*(each.read() for each in sensors))
        assert values == pytest.approx([0.1, 0.2, 0.3, 0.4, -0.1], abs=2e-5)

    assert chip.conversions == [str(each) for each in channels] * 3


@pytest.mark.virtual_clock
@pytest.mark.fault("I07")
async def test_a_conversion_that_nobody_waits_for_is_not_taken_for_another() -> None:
    """The chip begins no other while one is under way: its end is waited for first."""
    chip = FakeAds1115(0.1, 0.2)
    first, second = await sensors_on(chip, 0, 1, full_scale=0.512, data_rate=8)
    reading = asyncio.ensure_future(first.read())
    await asyncio.sleep(0.01)
    reading.cancel()

    assert await second.read() == pytest.approx(0.2, abs=2e-5)
    assert await first.read() == pytest.approx(0.1, abs=2e-5)
    assert chip.conversions == ["0", "1", "0"]


@pytest.mark.virtual_clock
@pytest.mark.parametrize("data_rate", DATA_RATES)
async def test_a_reading_takes_as_long_as_a_conversion(data_rate: int) -> None:
    """With the tolerance of the chip's clock; the bus is free for others meanwhile."""
    chip = FakeAds1115(1.0)
    chip.busy = 0
    (sensor,) = await sensors_on(chip, 0, data_rate=data_rate)
    loop = asyncio.get_running_loop()

    begin = loop.time()
    assert await sensor.read() == pytest.approx(1.0, abs=2e-4)

    assert loop.time() - begin == pytest.approx(1.1 / data_rate)
    assert loop.time() - begin < sensor.deadline


@pytest.mark.virtual_clock
async def test_a_changed_full_scale_counts_from_the_next_conversion() -> None:
    """The same voltage is read the same, with more of its places."""
    chip = FakeAds1115(0.123456)
    (sensor,) = await sensors_on(chip, 0, full_scale=6.144)
    coarse = await sensor.read()

    await sensor.apply(full_scale=0.256)
    fine = await sensor.read()

    assert abs(coarse - 0.123456) < 1e-4
    assert abs(fine - 0.123456) < 4e-6


@pytest.mark.virtual_clock
async def test_a_conversion_of_somebody_else_is_a_fault() -> None:
    """Another program, or a chip that has lost its power: the value is not taken."""
    chip = FakeAds1115(1.0)
    (sensor,) = await sensors_on(chip, 0)
    reading = asyncio.ensure_future(sensor.read())
    await asyncio.sleep(0.001)
    chip.write(1, bytes.fromhex("8583"))

    with pytest.raises(DeviceFaultError, match=r"0x0583|0x8583"):
        await reading


@pytest.mark.virtual_clock
@pytest.mark.promise("RES-4")
async def test_what_a_chip_holds_that_has_lost_its_power_is_no_voltage() -> None:
    """Its settings may be those that it has by itself, and the voltage would be 0."""
    chip = FakeAds1115(1.0)
    (sensor,) = await sensors_on(chip, "0-1", full_scale=2.048)
    reading = asyncio.ensure_future(sensor.read())
    await asyncio.sleep(0.001)
    chip.power_cycle()

    with pytest.raises(DeviceFaultError, match="lost its power"):
        await reading


@pytest.mark.virtual_clock
async def test_a_conversion_that_does_not_end_is_a_fault() -> None:
    """It is not waited for for ever, and an old value is not given."""
    chip = FakeAds1115(1.0)
    (sensor,) = await sensors_on(chip, 0)
    chip.busy = 1000

    with pytest.raises(DeviceFaultError, match="does not end"):
        await sensor.read()
