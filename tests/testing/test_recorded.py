"""A recording is a fake: its sensors give again what they gave, in any test."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import pytest

import esair
from esair.exceptions import RecordingBrokenError
from esair.journal import Kind
from esair.loop import TurnLoop
from esair.testing import (
    FakeActuator,
    FakeSensor,
    RecordedRun,
    VirtualLoop,
    recording,
)


@attrs.frozen
class Range:
    """What the sonar gives."""

    metres: float


class Follows(esair.Reaction):
    """Drives as far as there is room."""

    sonar = esair.reads(Range)
    wheel = esair.writes(float)

    def react(self, sonar: Range) -> float:
        return sonar.metres


def record(path: Path, loop_factory: Callable[[], asyncio.AbstractEventLoop]) -> None:
    """Record a sensor that speaks, fails once, is pulled out and comes back."""

    async def main() -> None:
        sonar = FakeSensor("sonar", Range(1.0), type=Range, rate=100.0)
        wheel = FakeActuator("wheel", safe=0.0)
        robot = esair.Robot(
            resources=[sonar, wheel],
            behaviors=[Follows()],
            record=esair.Recording(path, min_free=0),
        )
        async with robot:
            await asyncio.sleep(0.2)
            sonar.feed(Range(2.0))
            await asyncio.sleep(0.2)
            sonar.fail(OSError(5, "noise"))
            await asyncio.sleep(0.2)
            sonar.unplug()
            await asyncio.sleep(0.3)
            sonar.plug()
            sonar.feed(Range(3.0))
            await asyncio.sleep(0.4)

    with asyncio.Runner(loop_factory=loop_factory) as runner:
        runner.run(main())


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that can be repeated."""
    found = tmp_path_factory.mktemp("run") / "run.mcap"
    record(found, TurnLoop)
    return found


Seen = list[tuple[float, object]]


def drive(
    path: Path, script: Callable[[RecordedRun], object] | None = None
) -> tuple[Seen, list[tuple[float, float]], esair.ResourceStatus]:
    """Run another robot on the recording, on the virtual clock."""
    readings: Seen = []

    async def main() -> tuple[list[tuple[float, float]], esair.ResourceStatus]:
        run = recording(path, types={"sonar": Range})
        if script is not None:
            script(run)
        wheel = FakeActuator("wheel", safe=0.0)
        robot = esair.Robot(resources=[*run, wheel], behaviors=[Follows()])
        robot.journal.listen(
            lambda event: readings.append((event.time, event.value.value)),
            kinds=[Kind.READING],
        )
        async with robot:
            await asyncio.sleep(run.duration)
            status = robot.resources.query("sonar")
        return list(zip(wheel.landed, wheel.commands, strict=True)), status

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        commands, status = runner.run(main())
    return readings, commands, status


@pytest.mark.long
@pytest.mark.promise("REP-1")
@pytest.mark.real_clock
def test_values_come_again_when_they_came(path: Path) -> None:
    """Of their own class, with their pauses; a robot decides on them."""
    readings, commands, _ = drive(path)

    assert {value for _, value in readings} == {Range(1.0), Range(2.0), Range(3.0)}
    second = min(time for time, value in readings if value == Range(2.0))
    assert second == pytest.approx(0.2, abs=0.15)
    assert 3.0 in [command for _, command in commands]
    assert len(readings) > 20


@pytest.mark.long
@pytest.mark.promise("REP-1")
@pytest.mark.real_clock
def test_losses_and_faults_come_again(path: Path) -> None:
    """The robot notices each as it did then, and stands while it is away."""
    readings, commands, status = drive(path)

    assert status.losses == 1
    assert status.faults == 1
    times = [time for time, _ in readings]
    away = max(itertools.pairwise(times), key=lambda pair: pair[1] - pair[0])
    assert away[1] - away[0] > 0.25
    stopped = [time for time, command in commands if command == 0.0]
    assert any(away[0] < time < away[1] for time in stopped)


@pytest.mark.long
@pytest.mark.promise("REP-1")
@pytest.mark.real_clock
def test_faults_may_be_laid_over_it(path: Path) -> None:
    """A test pulls a recorded sensor out whenever it likes."""

    def script(run: RecordedRun) -> None:
        run.at(0.1, run["sonar"].unplug)

    readings, _, status = drive(path, script)
    assert status.losses >= 1
    assert not any(0.11 < time < 0.6 for time, _ in readings)


@pytest.mark.promise("REP-1")
@pytest.mark.real_clock
def test_a_recording_without_turns_gives_plain_values(tmp_path: Path) -> None:
    """One on a virtual clock, say: what a viewer sees, with its times and losses."""
    path = tmp_path / "virtual.mcap"
    record(path, VirtualLoop)
    run = recording(path)

    assert list(run.sensors) == ["sonar"]
    assert run["sonar"].value_type is Any
    assert run.duration == pytest.approx(1.3, abs=0.1)
    with pytest.raises(KeyError, match="did you mean 'sonar'"):
        run["sonr"]
    for seconds in (float("nan"), float("inf"), "1"):
        with pytest.raises(esair.ConfigError, match="expected seconds"):
            run.at(seconds, run["sonar"].unplug)  # type: ignore[arg-type]
    with pytest.raises(esair.ConfigError, match="expected what is called"):
        run.at(1.0, None)  # type: ignore[arg-type]


class Room(esair.Derived[Range]):
    """Computes how much is left."""

    sonar = esair.reads(Range)

    def compute(self, sonar: Range) -> Range:
        return Range(sonar.metres / 2)


@pytest.mark.promise("REP-1")
@pytest.mark.virtual_clock
@pytest.mark.parametrize("name", ["room", "left_over"])
async def test_what_was_computed_comes_again_as_its_class(
    tmp_path: Path, name: str
) -> None:
    """A recording holds it as plain data alone: its class, or its type, is known here."""
    path = tmp_path / "virtual.mcap"
    sonar = FakeSensor("sonar", Range(1.0), type=Range)
    parts = [sonar, Room(name=name)]
    kept = esair.Recording(path, min_free=0)
    async with esair.Robot(resources=parts, behaviors=[Reads(name)], record=kept):
        await asyncio.sleep(0.5)

    run = recording(path, types={"left_over": Range, "sonar": Range})
    again = Reads(name)
    async with esair.Robot(resources=[*run], behaviors=[again]):
        await asyncio.sleep(0.5)
    assert again.last == Range(0.5)


class Reads(esair.Behavior):
    """Keeps the last value of what is computed."""

    last: Range | None = None

    def __init__(self, computed: str) -> None:
        super().__init__(name="reads", reads={"port": esair.reads(Any, name=computed)})

    async def run(self) -> None:
        async for value in self.port:  # type: ignore[attr-defined]
            self.last = value


@pytest.mark.promise("REP-1")
def test_what_is_no_recording_is_named(tmp_path: Path) -> None:
    """An error, and no robot without sensors."""
    path = tmp_path / "notes.mcap"
    path.write_text("no recording")

    with pytest.raises(RecordingBrokenError, match="no recording of esair"):
        recording(path)


class Fix(esair.Sensor[float]):
    """Knows that what it gives was measured some time ago."""

    rate = 10.0

    async def read(self) -> Any:
        return esair.Stamped(1.0, age=0.15)


class Looks(esair.Behavior):
    """Looks at how old readings are when they come."""

    age = 0.0
    fix = esair.reads(float)

    async def run(self) -> None:
        async for _ in self.fix:
            self.age = self.fix.newest.arrived - self.fix.newest.time


@pytest.mark.promise("REP-1", "REC-2", "SC-4")
@pytest.mark.virtual_clock
async def test_a_reading_is_as_old_as_it_was(tmp_path: Path) -> None:
    """A recording holds when it was measured, beside when it came."""
    path = tmp_path / "virtual.mcap"

    async def age_of(sensors: list[Any], **options: Any) -> float:
        looks = Looks()
        async with esair.Robot(resources=sensors, behaviors=[looks], **options):
            await asyncio.sleep(0.23)
        return looks.age

    kept = esair.Recording(path, min_free=0)
    assert await age_of([Fix()], record=kept) == pytest.approx(0.15)
    assert await age_of([*recording(path)]) == pytest.approx(0.15)
