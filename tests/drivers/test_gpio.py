"""Digital inputs and outputs, on a chip that a test moves."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from tests.drivers.parts import Plugged

import esair
from esair.buses.finding import Device
from esair.drivers import gpio
from esair.drivers.gpio import DigitalInput, DigitalOutput, LineRequest
from esair.drivers.gpio.fake import FakeGpioChip
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.testing import ActuatorContract, SensorContract

pytestmark = pytest.mark.virtual_clock


class TestInput(Plugged, SensorContract):
    def make(self) -> DigitalInput:
        self.far = FakeGpioChip()
        return DigitalInput(chip="fake", line=3, opener=self.far.request)


class TestOutput(Plugged, ActuatorContract):
    def make(self) -> DigitalOutput:
        self.far = FakeGpioChip()
        return DigitalOutput(chip="fake", line=4, opener=self.far.request)

    def commands(self) -> list[Any]:
        return [True, False, True]


@pytest.fixture
def chip() -> FakeGpioChip:
    return FakeGpioChip()


@asynccontextmanager
async def followed(device: DigitalInput) -> AsyncIterator[Any]:
    """Open an input and take its first value."""
    device.open()
    stream: Any = device.stream()
    first = await anext(stream)
    try:
        yield first, stream
    finally:
        await stream.aclose()
        device.close()


def button(chip: FakeGpioChip, **keywords: Any) -> DigitalInput:
    return DigitalInput(chip="fake", line=3, opener=chip.request, **keywords)


def lamp(chip: FakeGpioChip, **keywords: Any) -> DigitalOutput:
    return DigitalOutput(
        name="lamp", chip="fake", line=4, opener=chip.request, **keywords
    )


async def test_each_change_is_a_reading(chip: FakeGpioChip) -> None:
    """After what the line is at first; short pulses are not lost."""
    device = button(chip)
    async with followed(device) as (first, stream):
        assert first is False
        for level in (True, False, True):
            chip.drive(3, level)
        assert [await anext(stream) for _ in range(3)] == [True, False, True]
        assert device.read() is True
        assert device.missed == 0


async def test_a_stream_that_begins_again_goes_on_where_it_was(
    chip: FakeGpioChip,
) -> None:
    """As after a fault: not with what the line was when it was opened."""
    device = button(chip)
    async with followed(device) as (_, stream):
        chip.drive(3, True)
        assert await anext(stream) is True
        await stream.aclose()

        again: Any = device.stream()
        assert await anext(again) is True
        chip.drive(3, False)
        assert await anext(again) is False
        await again.aclose()


async def test_active_low_turns_values_around(chip: FakeGpioChip) -> None:
    """A button to ground is True when it is pressed."""
    chip.drive(3, True)
    async with followed(button(chip, active_low=True, bias="pull_up")) as (
        first,
        stream,
    ):
        assert first is False
        chip.drive(3, False)
        assert await anext(stream) is True


async def test_a_bounce_is_no_change(chip: FakeGpioChip) -> None:
    """What is shorter than the setting; it can be changed while it is open."""
    device = button(chip, debounce=0.01)
    async with followed(device) as (_, stream):
        for level in (True, False, True, False, True):
            chip.drive(3, level)
            await asyncio.sleep(0.001)
        assert await anext(stream) is True
        waiting = asyncio.ensure_future(anext(stream))
        for level in (False, True):  # it was not steady, and is what it was
            chip.drive(3, level)
        await asyncio.sleep(1.0)
        assert not waiting.done()
        device.apply(debounce=0.0)
        chip.drive(3, False)
        assert await waiting is False


@pytest.mark.fault("D13")
async def test_changes_that_nobody_saw_are_counted(chip: FakeGpioChip) -> None:
    """The newest ones win, and the last one is true."""
    device = button(chip)
    async with followed(device) as (_, stream):
        chip.drive(3, True)
        assert await anext(stream) is True
        for number in range(100):
            chip.drive(3, number % 2 == 1)
        values = [await anext(stream) for _ in range(16)]
        assert values[-1] is True
        assert device.missed == 84


@pytest.mark.fault("D01")
async def test_a_chip_that_is_unplugged_is_a_loss_at_once(chip: FakeGpioChip) -> None:
    """Of an input that waits; it is opened again when the chip is back."""
    device = button(chip, name="button")
    async with esair.Robot(resources=[device]) as robot:
        right = await robot.resources.register("me", "button", esair.Access.READ)
        await asyncio.sleep(0.1)
        chip.unplug()
        for _ in range(10):  # the descriptor is looked at once in each turn
            await asyncio.sleep(0.001)
        assert robot.resources.query("button").losses == 1
        chip.plug()
        chip.drive(3, True)
        await asyncio.sleep(6.0)
        assert (await robot.sensors.read(right)).value is True


@pytest.mark.promise("AC-4")
@pytest.mark.parametrize("safe", [False, True])
async def test_an_output_begins_and_ends_with_its_safe_value(
    chip: FakeGpioChip, safe: bool
) -> None:
    """From the request on: there is no glitch."""
    policy = esair.Policy("lamp", allow={"me": esair.Access.WRITE})
    async with esair.Robot(
        resources=[lamp(chip, safe=safe)], policies=[policy]
    ) as robot:
        right = await robot.resources.register("me", "lamp", esair.Access.WRITE)
        assert set(chip.levels[4]) == {safe}
        await robot.actuators.write(right, not safe)
        assert chip.level(4) is not safe
        await robot.actuators.write(right, not safe)
    assert chip.levels[4][0] is safe
    assert chip.levels[4][-1] is safe


async def test_an_active_low_output_is_low_when_it_is_true(chip: FakeGpioChip) -> None:
    """So its safe value is a high voltage."""
    device = lamp(chip, active_low=True)
    device.open()
    device.write(True)
    device.close()
    assert chip.levels[4] == [True, False]


@pytest.mark.fault("D07")
async def test_a_line_that_somebody_has_is_told_with_his_name(
    chip: FakeGpioChip,
) -> None:
    """An input as well as an output."""
    chip.take(3, "spi0 CS0")
    chip.take(4, "spi0 CS1")
    with pytest.raises(
        DeviceFaultError, match=r"line 3 of fake is in use by 'spi0 CS0'"
    ):
        button(chip).open()
    with pytest.raises(DeviceFaultError, match="in use by 'spi0 CS1'"):
        lamp(chip).open()


async def test_a_line_that_is_not_open_is_lost(chip: FakeGpioChip) -> None:
    """It is not quietly left alone."""
    with pytest.raises(DeviceLostError, match="not open"):
        lamp(chip).write(True)
    with pytest.raises(DeviceLostError, match="not open"):
        await anext(button(chip).stream())


def test_a_chip_that_does_not_exist_is_lost() -> None:
    """With a path or with a label; it may be plugged in later."""
    pytest.importorskip("gpiod")
    for chip in ("/dev/gpiochip-nowhere", "no chip has this label"):
        with pytest.raises(DeviceLostError, match="there is no chip"):
            DigitalInput(chip=chip, line=0).open()


def test_a_chip_is_found_by_its_name_and_by_its_label(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As `esair devices` shows them; a label that two chips have is no answer."""
    there = [
        Device("gpio", "/dev/gpiochip0", "main", description="main"),
        Device("gpio", "/dev/gpiochip1", "/dev/gpiochip1", description="hub"),
        Device("gpio", "/dev/gpiochip2", "/dev/gpiochip2", description="hub"),
    ]
    monkeypatch.setattr(gpio, "devices", lambda: there)

    def path_of(chip: str) -> str:
        return gpio._path_of(LineRequest("lamp", chip, 0))

    assert path_of("main") == path_of("gpiochip0") == "/dev/gpiochip0"
    assert path_of("/dev/gpiochip7") == "/dev/gpiochip7"
    with pytest.raises(
        DeviceFaultError, match="several chips are named 'hub': /dev/gp"
    ):
        path_of("hub")
    with pytest.raises(DeviceLostError, match="no chip 'mian'; did you mean 'main'"):
        path_of("mian")
