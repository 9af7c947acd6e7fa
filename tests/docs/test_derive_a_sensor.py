"""The code of docs/how-to/derive-a-sensor.md, besides the examples."""

import asyncio

import pytest
from dry import Dry

import esair


class Water(esair.Behavior):
    """Pump before the valve is open, and on after it has closed."""

    valve = esair.writes(bool)
    pump = esair.writes(float)

    def __init__(self) -> None:
        super().__init__()
        self.answers: list[bool] = []

    async def run(self) -> None:
        self.answers.append(bool(await self.pump.write(1.0)))
        await self.valve.write(True)
        self.answers.append(bool(await self.pump.write(1.0)))
        await asyncio.sleep(0.05)
        self.answers.append(bool(await self.pump.write(1.0)))
        await asyncio.sleep(10.0)


@pytest.mark.promise("PRO-11")
async def test_a_guard_reads_what_stands_now(
    fake_actuator,
) -> None:
    """The valve closes by its own time-out, and the pump stops at once."""

    valve = fake_actuator("valve", safe=False, command_timeout=0.2)
    pump = fake_actuator("pump", safe=0.0, command_timeout=5.0)
    water = Water()

    async with esair.Robot(resources=[valve, pump], behaviors=[Dry(), water]):
        await asyncio.sleep(0.1)
        assert water.answers == [False, True, True]
        assert pump.commands == [0.0, 1.0, 1.0]
        await valve.until(False, timeout=0.2)
        await asyncio.sleep(0.01)
        assert pump.commands == [0.0, 1.0, 1.0, 0.0]
