"""What a robot does with its watchdog, which is a fake here."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

import esair
import esair.watchdog
from esair.supervisors._keeper import STARTS
from esair.testing import FakeActuator

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("GRD-1", "GRD-3")]


class FakeWatchdog:
    """Notes what it is told; it dies when the test says so."""

    made: list[FakeWatchdog]
    missing = False

    def __init__(
        self, *, limit: float, policy: str, on_death: Callable[[], None]
    ) -> None:
        self.made.append(self)
        self.die = on_death
        self.starts = self.beats = 0
        self.told: list[Any] = []
        self.latched = False
        self.armed = asyncio.Event()

    async def start(self) -> None:
        if self.missing:
            raise OSError(12, "no memory")
        self.starts += 1

    async def arm(self, name: str, _frames: object, _outlet: object) -> str:
        self.told.append(("arm", name))
        self.armed.set()
        return ""

    async def drop(self, name: str) -> None:
        self.told.append(("drop", name))

    def moving(self, name: str, moves: bool) -> None:
        self.told.append(("moves" if moves else "safe", name))

    def beat(self) -> None:
        self.beats += 1

    async def close(self) -> None:
        self.told.append("close")


class Motor(FakeActuator[float]):
    outlet: Any = object()

    def safe_frames(self) -> Any:
        return ()


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> type[FakeWatchdog]:
    """Put the fake in the place of the watchdog."""
    fresh = type("Fresh", (FakeWatchdog,), {"made": []})
    monkeypatch.setattr(esair.watchdog, "Watchdog", fresh, raising=False)
    return fresh


def robot_with(**options: Any) -> tuple[esair.Robot, Motor, Any]:
    motor = Motor("motor", safe=0.0, command_timeout=5.0)
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    options = {"watchdog": True, "watchdog_limit": 0.1, **options}
    return esair.Robot(resources=[motor], behaviors=[user], **options), motor, user


async def test_it_is_started_first_and_closed_last(fake: type[FakeWatchdog]) -> None:
    """Between them it hears what is open, what moves, and that the scheduler turns."""
    robot, _, user = robot_with()
    async with robot:
        (dog,) = fake.made
        assert (dog.starts, dog.told) == (1, [("arm", "motor")])
        await user.motor.write(1.0)
        assert dog.told[1:] == [("moves", "motor")]
        before = dog.beats
        while dog.beats < before + 3:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0.01)
        assert robot.resources.query("motor").state is esair.ResourceState.READY
    assert dog.told[2] == ("safe", "motor")
    assert dog.told[-2:] == [("drop", "motor"), "close"]
    assert {*dog.told[2:-2]} == {("safe", "motor")}


async def test_nothing_moves_once_it_has_acted(fake: type[FakeWatchdog]) -> None:
    """Neither a write nor an operation: this process is about to end."""
    robot, motor, user = robot_with()
    async with robot:
        (dog,) = fake.made
        dog.latched = True
        with pytest.raises(esair.StoppingError, match="watchdog"):
            await user.motor.write(1.0)
        assert motor.commands == [0.0]


@pytest.mark.parametrize("policy", ["stop", "alarm"])
async def test_one_that_dies_is_started_anew(
    fake: type[FakeWatchdog], policy: Any
) -> None:
    """And told again what to watch; the robot is halted unless the user wants less."""
    robot, _, user = robot_with(watchdog_death=policy)
    async with robot:
        (dog,) = fake.made
        dog.told.clear()
        dog.armed.clear()
        for number in range(1, STARTS + 2):
            dog.die()
            if number <= STARTS:
                await asyncio.wait_for(dog.armed.wait(), 10.0)
                dog.armed.clear()
            await asyncio.sleep(0.01)
            assert dog.told.count(("arm", "motor")) == min(number, STARTS)
            assert (await user.motor.write(1.0)).__class__ is (
                esair.Refused if policy == "stop" else esair.Written
            )
            robot.resume()
        assert dog.starts == STARTS + 1


@pytest.mark.parametrize("policy", ["stop", "alarm"])
async def test_without_it_a_robot_starts_halted(
    fake: type[FakeWatchdog], policy: Any
) -> None:
    """Or unwatched, if the user says so."""
    fake.missing = True
    robot, _, user = robot_with(watchdog_death=policy)
    async with robot:
        answer = await user.motor.write(1.0)
        assert bool(answer) is (policy == "alarm")
        if policy == "stop":
            assert "cannot be started" in answer.rule
        robot.resume()
        assert await user.motor.write(1.0)


@pytest.mark.parametrize("field", ["watchdog_policy", "watchdog_death"])
def test_its_policies_are_words(fake: type[FakeWatchdog], field: str) -> None:
    """Another word is a mistake that names what there is."""
    with pytest.raises(esair.ConfigError, match=f"{field}.* or "):
        robot_with(**{field: "perhaps"})
    with pytest.raises(esair.ConfigError, match="watchdog_limit"):
        robot_with(watchdog_limit=0.0)
    assert fake.made == []
