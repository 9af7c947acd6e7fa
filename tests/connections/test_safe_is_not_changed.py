"""What is safe stays what it was declared to be, whatever a driver does with it."""

from __future__ import annotations

import asyncio

import pytest

import esair

pytestmark = pytest.mark.virtual_clock


class Arm(esair.Actuator[dict[str, float]]):
    """Its driver writes into the command that it was given."""

    safe = {"shoulder": 0.0, "elbow": 0.0}  # noqa: RUF012 - as users write it
    command_timeout = 0.2

    def __init__(self) -> None:
        super().__init__()
        self.told: list[dict[str, float]] = []

    async def write(self, command: dict[str, float]) -> None:
        self.told.append(dict(command))
        command["shoulder"] = 99.0


class Lifts(esair.Behavior):
    """Moves the arm once."""

    arm = esair.writes(dict)

    async def run(self) -> None:
        await self.arm.write({"shoulder": 0.5, "elbow": 0.5})


@pytest.mark.promise("AC-5")
async def test_a_driver_cannot_change_what_is_safe() -> None:
    """Each safe command is a copy of its own, as each other command is."""
    arm = Arm()
    async with esair.Robot(resources=[arm], behaviors=[Lifts()]):
        await asyncio.sleep(1.0)

    assert {"shoulder": 0.5, "elbow": 0.5} in arm.told
    assert all(told["shoulder"] <= 0.5 for told in arm.told)
    assert arm.told[-1] == {"shoulder": 0.0, "elbow": 0.0}
