"""What is safe stays what it was declared to be, whatever a driver does with it."""

from __future__ import annotations

import asyncio
from typing import Any

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


@pytest.mark.promise("ROB-2")
async def test_a_safe_command_that_is_computed_is_one() -> None:
    """Made anew each time it is asked for: the actuator is safe when it was told that."""

    class Computed(esair.Actuator[list[float]]):
        told = 0

        @property
        def safe(self) -> list[float]:  # type: ignore[override]
            return [0.0, 0.0]

        async def write(self, command: list[float]) -> None:
            self.told += 1

    wheels = Computed(name="wheels")
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(list)})
    robot = esair.Robot(resources=[wheels], behaviors=[user])
    async with robot:
        await user.wheels.write([0.5, 0.5])
        await asyncio.sleep(1.0)
        assert "safe command" in robot.resources.why("wheels").rule
    assert robot.stopped is not None
    assert [each.safe for each in robot.stopped] == [True]
