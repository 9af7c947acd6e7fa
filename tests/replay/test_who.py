"""A replay names the component whose code has changed, whoever it happens to."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Any

import attrs
import pytest

import esair
from esair.replay import Replay

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("REP-2")]


@attrs.frozen
class Look(esair.Request[float]):
    """A request with something in it that its asker decides on."""

    where: float


class Echo(esair.Sensor[float]):
    rate = 50.0

    async def read(self) -> float:
        return 1.0


class Lamp(esair.Actuator[float]):
    safe = 0.0
    power = esair.setting(0.5, unit="W", min=0.0, max=2.0)

    async def apply(self, **changes: Any) -> None:
        """It takes no time."""

    async def write(self, command: float) -> None:
        """It takes no time."""


class Shine(esair.Behavior):
    lamp = esair.writes(float)
    level = 0.5

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            await self.lamp.write(self.level)


class Dim(esair.Reaction):
    echo = esair.reads(float)
    lamp = esair.guards(float)
    part: float | None = 0.5

    def react(self, echo: float, lamp: float) -> float | None:
        return None if self.part is None else lamp * self.part * echo


class Eyes(esair.Behavior):
    factor = 2.0

    @esair.answers
    async def look(self, request: Look) -> float:
        await asyncio.sleep(0.03)
        return request.where * self.factor


class Asker(esair.Behavior):
    where = 0.25
    timeout = 1.0

    async def run(self) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                await self.ask("eyes", Look(self.where), timeout=self.timeout)
            await asyncio.sleep(0.05)


class Teller(esair.Behavior):
    told = 1.0
    offered = 1.0

    async def run(self) -> None:
        async for _ in esair.every(0.06):
            self.offer(self.offered, latest=True)
            await self.put("hearer", self.told)


class Hearer(esair.Behavior):
    gets = True

    async def run(self) -> None:
        while True:
            await self.receive()
            if self.gets:
                await self.get("teller")


class Tuner(esair.Behavior):
    lamp = esair.writes(float, configure=True)
    power = 1.0

    async def run(self) -> None:
        await asyncio.sleep(0.1)
        await self.lamp.configure(power=self.power)


PARTS = (Shine, Dim, Eyes, Asker, Teller, Hearer, Tuner)


def make(record: esair.Recording | None = None) -> esair.Robot:
    """Return the robot, not started."""
    behaviors: list[Any] = [part() for part in PARTS]
    return esair.Robot(resources=[Echo(), Lamp()], behaviors=behaviors, record=record)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run, in which everybody does what it does."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    esair.run(make(esair.Recording(path, min_free=0)), duration=0.5)
    assert Replay(path).run(make()).divergence is None
    return path


@pytest.mark.parametrize(
    ("part", "attribute", "value"),
    [
        (Shine, "level", 0.75),
        (Dim, "part", 0.25),
        (Dim, "part", None),
        (Eyes, "factor", 3.0),
        (Asker, "where", 0.75),
        (Asker, "timeout", 0.01),
        (Teller, "told", 2.0),
        (Teller, "offered", 2.0),
        (Hearer, "gets", False),
        (Tuner, "power", 1.5),
    ],
)
def test_the_one_that_has_changed_is_named(
    run: Path, monkeypatch: pytest.MonkeyPatch, part: type, attribute: str, value: Any
) -> None:
    """A command, a guard, a request, its answer, data, a setting."""
    monkeypatch.setattr(part, attribute, value)
    found = Replay(run).run(make()).divergence

    assert found is not None
    assert found.component == part.__name__.lower()


class Ahead(esair.Reaction):
    """Has nothing to say, until a test has it decide."""

    rate = 50.0
    echo = esair.reads(float)
    horn = esair.writes(float)
    command: float | None = None

    def react(self, echo: float) -> float | None:
        return self.command


class Behind(esair.Reaction):
    """Decides in the same turns."""

    rate = 50.0
    echo = esair.reads(float)
    lamp = esair.writes(float)

    def react(self, echo: float) -> float:
        return 0.5


def beside(record: esair.Recording | None = None) -> esair.Robot:
    """Return a robot with two reactions of one beat."""
    parts: list[Any] = [Echo(), Lamp(), Lamp(name="horn")]
    return esair.Robot(resources=parts, behaviors=[Ahead(), Behind()], record=record)


def test_one_more_decision_in_a_turn_is_that_of_who_makes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not of the one that does in this turn what it did, after it."""
    path = tmp_path / "run.mcap"
    esair.run(beside(esair.Recording(path, min_free=0)), duration=0.3)
    monkeypatch.setattr(Ahead, "command", 0.25)
    found = Replay(path).run(beside()).divergence

    assert found is not None
    assert found.component == "ahead"
