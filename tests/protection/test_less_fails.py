"""What a guard leaves of a standing command, and the device does not take."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Cap(esair.Reaction):
    """Lets as much pass as its sensor says."""

    cap = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, cap: float, wheels: float) -> float:
        return min(cap, wheels)


@pytest.mark.promise("PRO-8")
@pytest.mark.parametrize("seconds", [0.0, 0.01])
@pytest.mark.parametrize("left", [0.2, 0.0])
async def test_what_does_not_take_less_is_made_safe(
    left: float, seconds: float
) -> None:
    """Else more than a guard lets pass would stand until somebody writes."""
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=60.0)
    cap = FakeSensor("cap", 9.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels, cap], behaviors=[user, Cap()]):
        assert await user.wheels.write(1.0)
        wheels.fail(ValueError("checksum"))
        wheels.slow(seconds)
        cap.feed(left)
        await asyncio.sleep(0.5)
        assert wheels.commands == [0.0, 1.0, 0.0]
        assert (await user.wheels.write(1.0)).command == left


class Row(Mapping[str, float]):
    """A mapping of numbers that nobody can change."""

    def __init__(self, speed: float) -> None:
        self._entries = {"speed": speed}

    def __getitem__(self, key: str) -> float:
        return self._entries[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)


@pytest.mark.promise("PRO-8")
async def test_what_cannot_be_made_less_is_made_safe() -> None:
    """Its class keeps its parts: what stands would be more than a guard lets pass."""

    class CapRow(esair.Reaction):
        cap = esair.reads(float)
        wheels = esair.guards(Row)

        def react(self, cap: float, wheels: Row) -> Row:
            return Row(min(cap, wheels["speed"]))

    wheels = FakeActuator("wheels", safe=Row(0.0), command_timeout=60.0)
    cap = FakeSensor("cap", 9.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(Row)})
    async with esair.Robot(resources=[wheels, cap], behaviors=[user, CapRow()]):
        assert await user.wheels.write(Row(1.0))
        cap.feed(0.2)
        await asyncio.sleep(0.5)
        assert wheels.commands[-1] == Row(0.0)


class Stop(esair.Reaction):
    """Keeps still what it cannot see."""

    cap = esair.reads(float)
    wheels = esair.writes(float, priority=9)

    def react(self, cap: float) -> None:
        return None


@pytest.mark.promise("PRO-1", "PRO-5")
@pytest.mark.parametrize(
    ("sees", "still"), [(Stop, 0.0), (Cap, 0.0), (Stop, esair.HOLD)]
)
@pytest.mark.parametrize("seconds", [0.0, 0.05])
async def test_a_stop_that_was_not_taken_is_no_standstill(
    sees: Any, still: Any, seconds: float
) -> None:
    """Who is blind then, or has become so meanwhile, has it made safe, as any motion."""
    wheels = FakeActuator[Any]("wheels", safe=still, command_timeout=60.0)
    cap = FakeSensor("cap", 9.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels, cap], behaviors=[user, sees()]):
        assert await user.wheels.write(1.0)
        wheels.fail(ValueError("checksum"))
        wheels.slow(seconds)
        stopping = asyncio.create_task(user.wheels.write(still))
        await asyncio.sleep(seconds / 2)
        cap.unplug()
        with pytest.raises(esair.DeviceFaultError):
            await stopping
        await asyncio.sleep(0.5)
        assert wheels.commands == [still, 1.0, still]
