"""An `open` that ends after a newer one: the device may have been set up under us."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair.loop import TurnLoop, turn_of
from esair.testing import VirtualLoop

pytestmark = pytest.mark.promise("CALL-4", "CALL-1")

LOOPS = {"virtual": VirtualLoop, "shipped": TurnLoop}


class Motor(esair.Actuator[float]):
    """Its first `open` hangs, swallows its cancellation, and sets it up when it ends."""

    safe = 0.0
    deadline = 0.05
    command_timeout = 0.5

    def __init__(self, *, ends: Exception | None, name: str | None = None) -> None:
        super().__init__(name=name)
        self.ends = ends
        self.late: asyncio.Event | None = None
        self.late_in = -1  # the turn of that end
        self.told: list[object] = []
        self.moved, self.gone = asyncio.Event(), asyncio.Event()

    async def open(self) -> None:
        if self.late is None:
            self.late = asyncio.Event()
            while not self.late.is_set():
                try:
                    await self.late.wait()
                except asyncio.CancelledError:
                    continue
            self.told.append("set up late")
            self.late_in = turn_of(asyncio.get_running_loop()).number
            if self.ends is not None:
                raise self.ends
            return
        self.told.append("opened")

    async def close(self) -> None:
        self.told.append("closed")
        self.gone.set()

    async def write(self, command: float) -> None:
        if turn_of(asyncio.get_running_loop()).number == self.late_in:
            return  # what has come takes effect at the border
        self.told.append(command)
        if command:
            self.moved.set()


class Drive(esair.Behavior):
    """Drives, whatever happens."""

    motor = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.01):
            try:
                await self.motor.write(0.5)
            except esair.DeviceLostError:
                continue


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("ends", [None, OSError("half of it")], ids=["well", "ill"])
def test_a_late_end_is_a_part_that_has_restarted(
    loop: str, ends: Exception | None
) -> None:
    """It is set up again, and safe before anybody moves it."""
    motor: Any = Motor(ends=ends)

    async def main() -> None:
        async with esair.Robot(resources=[motor], behaviors=[Drive()]) as robot:
            await motor.moved.wait()
            assert robot.resources.query("motor").losses == 1
            motor.late.set()
            await asyncio.sleep(0.5)
            assert robot.resources.query("motor").losses == 2
            assert robot.resources.query("motor").state is esair.ResourceState.READY

    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        runner.run(main())
    after = motor.told[motor.told.index("set up late") + 1 :]
    begun = after.index("opened")
    assert after[begun : begun + 3] == ["opened", 0.0, 0.5]
    assert all(each in (0.0, "closed") for each in after[:begun])


@pytest.mark.virtual_clock
async def test_an_end_before_a_newer_opening_costs_no_second_one() -> None:
    """What is not open yet, or was closed since, is opened as it would be anyway."""
    motor: Any = Motor(ends=None)
    async with esair.Robot(resources=[motor], behaviors=[Drive()]) as robot:
        await motor.gone.wait()
        motor.late.set()
        await asyncio.sleep(1.0)
        assert robot.resources.query("motor").losses == 1
    late = motor.told.index("set up late")
    assert motor.told[late + 1 : late + 3] == ["closed", "opened"]
    assert motor.told.count("opened") == 1
