"""Digital inputs and outputs on the kernel's gpio-sim, through libgpiod."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Iterator
from contextlib import aclosing
from pathlib import Path
from typing import Any, ClassVar

import pytest

import esair
from esair.drivers.gpio import DigitalInput, DigitalOutput
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.testing import ActuatorContract, SensorContract

SIMULATED = Path("/sys/kernel/config/gpio-sim")

pytestmark = [pytest.mark.real_clock, pytest.mark.kernel("built")]

LINES = 8
_numbers = itertools.count()


class Chip:
    """A chip of gpio-sim, and its outside world."""

    def __init__(self) -> None:
        self.folder = SIMULATED / f"esair{next(_numbers)}"
        self.label = f"esair-{self.folder.name}"
        bank = self.folder / "bank"
        bank.mkdir(parents=True)
        (bank / "num_lines").write_text(str(LINES))
        (bank / "label").write_text(self.label)
        for number, name in ((3, "BUTTON"), (4, "LAMP")):
            line = bank / f"line{number}"
            line.mkdir()
            (line / "name").write_text(name)
        self.plug()

    def plug(self) -> None:
        """Have the chip appear."""
        if self._is_live:
            return
        (self.folder / "live").write_text("1")
        name = (self.folder / "bank/chip_name").read_text().strip()
        device = (self.folder / "dev_name").read_text().strip()
        self.path = f"/dev/{name}"
        self._lines = Path("/sys/devices/platform") / device / name

    def unplug(self) -> None:
        """Have the chip vanish."""
        if self._is_live:
            (self.folder / "live").write_text("0")

    @property
    def _is_live(self) -> bool:
        return (self.folder / "live").read_text().strip() == "1"

    def drive(self, line: int, level: bool) -> None:
        """Move a line from outside."""
        word = "pull-up" if level else "pull-down"
        (self._lines / f"sim_gpio{line}/pull").write_text(word)

    def level(self, line: int) -> bool:
        """Return the level of a line."""
        return (self._lines / f"sim_gpio{line}/value").read_text().strip() == "1"

    def remove(self) -> None:
        """Take everything away."""
        self.unplug()
        for folder in ("bank/line3", "bank/line4", "bank", ""):
            (self.folder / folder).rmdir()


@pytest.fixture
def chip() -> Iterator[Chip]:
    made = Chip()
    yield made
    made.remove()


async def until(condition: Callable[[], bool]) -> None:
    """Wait for what the kernel does in its own time."""
    async with asyncio.timeout(20):
        while not condition():  # noqa: ASYNC110 - there is nothing that could tell
            await asyncio.sleep(0.01)


class Simulated:
    @pytest.fixture(autouse=True)
    def _chip(self, chip: Chip) -> None:
        self.chip = chip

    silent_for = 2.0

    async def unplug(self, _device: Any) -> None:
        self.chip.unplug()

    silence = unplug

    async def speak(self, _device: Any) -> None:
        self.chip.plug()

    async def power_cycle(self, _device: Any) -> None:
        self.chip.unplug()
        self.chip.plug()


class TestInput(Simulated, SensorContract):
    pytestmark: ClassVar[list[Any]] = [pytest.mark.asyncio]

    def make(self) -> DigitalInput:
        return DigitalInput(chip=self.chip.label, line="BUTTON")


class TestOutput(Simulated, ActuatorContract):
    pytestmark: ClassVar[list[Any]] = [pytest.mark.asyncio]

    def make(self) -> DigitalOutput:
        return DigitalOutput(chip=self.chip.label, line=4)

    def commands(self) -> list[Any]:
        return [True, False, True]


async def test_each_change_outside_is_a_reading(chip: Chip) -> None:
    """Through the descriptor of the request; by label and name, active low."""
    device = DigitalInput(chip=chip.label, line="BUTTON", active_low=True)
    device.open()
    try:
        async with asyncio.timeout(10), aclosing(device.stream()) as stream:  # type: ignore[type-var]
            assert await anext(stream) is True
            for level in (True, False, True):
                chip.drive(3, level)
                assert await anext(stream) is not level
                assert device.read() is not level
    finally:
        device.close()


async def test_a_bounce_is_no_change(chip: Chip) -> None:
    """The kernel waits until the line is steady; the setting changes while it is open."""
    device = DigitalInput(chip=chip.path, line=3, debounce=0.2)
    device.open()
    try:
        async with asyncio.timeout(10), aclosing(device.stream()) as stream:  # type: ignore[type-var]
            assert await anext(stream) is False
            for level in (True, False, True):
                chip.drive(3, level)
            assert await anext(stream) is True
            device.apply(debounce=0.0)
            chip.drive(3, False)
            assert await anext(stream) is False
    finally:
        device.close()


async def test_after_a_burst_the_last_value_is_true(chip: Chip) -> None:
    """However many changes the kernel has joined, or dropped."""
    device = DigitalInput(chip=chip.path, line=3)
    device.open()
    try:
        async with asyncio.timeout(20), aclosing(device.stream()) as stream:  # type: ignore[type-var]
            assert await anext(stream) is False
            for number in range(301):
                chip.drive(3, number % 2 == 0)
            last = False
            with contextlib.suppress(TimeoutError):
                while True:
                    last = await asyncio.wait_for(anext(stream), 1.0)
            assert last is True
    finally:
        device.close()


async def test_an_output_is_safe_from_its_request_on(chip: Chip) -> None:
    """And last of all; a safe value that is high is no exception."""
    device = DigitalOutput(name="lamp", chip=chip.path, line="LAMP", safe=True)
    policy = esair.Policy("lamp", allow={"me": esair.Access.WRITE})
    device.open()
    assert chip.level(4)
    device.close()
    async with esair.Robot(resources=[device], policies=[policy]) as robot:
        right = await robot.resources.register("me", "lamp", esair.Access.WRITE)
        assert await robot.actuators.write(right, False)
        assert not chip.level(4)
        assert await robot.actuators.write(right, False)
        await until(lambda: chip.level(4))


@pytest.mark.fault("D07")
async def test_a_line_that_somebody_has_is_told_with_his_name(chip: Chip) -> None:
    """As the kernel knows him."""
    import gpiod

    with (
        gpiod.request_lines(chip.path, {4: None}, consumer="somebody else"),
        pytest.raises(DeviceFaultError, match="in use by 'somebody else'"),
    ):
        DigitalOutput(chip=chip.path, line=4).open()


async def test_names_that_are_not_there_are_told_with_the_nearest(chip: Chip) -> None:
    """Of the lines as well as of the chips."""
    with pytest.raises(DeviceFaultError, match="did you mean 'BUTTON'"):
        DigitalInput(chip=chip.path, line="BUTTOM").open()
    with pytest.raises(DeviceFaultError, match="has the lines 0 to 7"):
        DigitalInput(chip=chip.path, line=8).open()
    with pytest.raises(DeviceLostError, match=f"did you mean '{chip.label}'"):
        DigitalInput(chip=f"{chip.label}x", line=3).open()


@pytest.mark.fault("D01", "D04")
async def test_a_chip_that_vanishes_is_a_loss_and_its_return_is_found(
    chip: Chip,
) -> None:
    """By its label: the number of its device file may be another one then."""
    device = DigitalInput(name="button", chip=chip.label, line=3)
    async with esair.Robot(resources=[device]) as robot:
        right = await robot.resources.register("me", "button", esair.Access.READ)
        async with asyncio.timeout(20):
            assert (await robot.sensors.read(right, timeout=10)).value is False
            chip.unplug()
            await until(lambda: robot.resources.query("button").losses > 0)
            chip.plug()
            chip.drive(3, True)
            ready = esair.ResourceState.READY
            await until(lambda: robot.resources.query("button").state is ready)
            assert (await robot.sensors.read(right, timeout=10)).value is True
