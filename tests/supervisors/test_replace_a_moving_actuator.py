"""An actuator that somebody moves while another takes its place."""

import asyncio

import pytest

import esair


class Slow(esair.Actuator[float]):
    """Its driver takes 10 ms for each command."""

    safe = 0.0

    def __init__(self) -> None:
        super().__init__(name="motor")
        self.commands: list[float] = []

    async def write(self, command: float) -> None:
        self.commands.append(command)
        await asyncio.sleep(0.01)


class Drive(esair.Behavior):
    """Writes whenever it can."""

    motor = esair.writes(float)

    async def run(self) -> None:
        while True:
            try:
                await self.motor.write(0.5)
            except esair.DeviceLostError:
                await asyncio.sleep(0.001)


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-4", "RS-5")
async def test_a_write_that_waits_does_not_follow_the_safe_command() -> None:
    """The old one is left safe; the new one moves on a fresh command."""
    old, new = Slow(), Slow()

    async with esair.Robot(resources=[old], behaviors=[Drive()]) as robot:
        await asyncio.sleep(0.105)  # amid a write
        await robot.resources.replace("motor", new)
        await asyncio.sleep(0.1)
        assert robot.resources.why("motor").holder == "drive"

    assert old.commands[-2:] == [0.5, 0.0]
    assert new.commands[0] == new.commands[-1] == 0.0
    assert 0.5 in new.commands
