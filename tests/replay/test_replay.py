"""A recorded run is repeated by the robot's code, without its devices, and compared."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import attrs
import pytest
from tests.patience import within
from tests.replay import robots
from tests.replay.soak import folder_of_robot, unequal

import esair
from esair.buses import Bus
from esair.codec import Kinds
from esair.exceptions import RecordingBrokenError
from esair.recording import VALUE_LIMIT, Kept, chunks_of, events_of, facts_of
from esair.replay import Replay, Unrepeatable, unrepeatable
from esair.testing import FakeActuator

pytestmark = pytest.mark.real_clock

ROOT = Path(__file__).parents[2]


def never(*_: object) -> Any:
    """No driver is called."""
    raise AssertionError("a driver was called")


@pytest.fixture
def no_drivers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every driver call fail the test."""
    monkeypatch.setattr(robots.Sonar, "read", never)
    monkeypatch.setattr(robots.Compass, "read", never)
    monkeypatch.setattr(robots.Wheel, "write", never)
    monkeypatch.setattr(robots.Arm, "write", never)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a part of a second."""
    return robots.recorded(tmp_path_factory.mktemp("run") / "run.mcap", 0.7)


@pytest.mark.promise("REP-2")
@pytest.mark.usefixtures("no_drivers")
@pytest.mark.long
def test_the_same_code_decides_the_same(recording: Path) -> None:
    """To the last event of the stop, far quicker than it was."""
    outcome = Replay(recording).run(robots.make())

    assert outcome.divergence is None
    assert outcome.short == ""
    assert outcome.equal > 100
    assert within(outcome.seconds, outcome.took)


@pytest.mark.fault("P08")
@pytest.mark.promise("REP-2")
@pytest.mark.usefixtures("no_drivers")
def test_a_changed_constant_is_named_as_the_first_difference(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who, what it did and does now, and what it had read."""
    monkeypatch.setattr(robots, "GAIN", 0.6)
    found = Replay(recording).run(robots.make()).divergence

    assert found is not None
    assert found.component == "follow"
    assert found.expected is not None
    assert found.actual is not None
    assert found.actual.value == pytest.approx(found.expected.value / 0.5 * 0.6)
    assert {seen.sensor for seen in found.readings} == {"sonar", "bumper"}
    (sonar,) = (seen for seen in found.readings if seen.sensor == "sonar")
    assert found.expected.value == pytest.approx(0.5 * sonar.value)
    assert found.turn > 0
    assert found.expected.time - sonar.time < 0.1


class Line(Bus):
    """One thread for all who are on it."""

    async def _open(self) -> None:
        pass

    async def _close(self) -> None:
        pass


class Slow(esair.Actuator[float]):
    """Keeps the thread of its line for a while."""

    safe = 0.0
    command_timeout = 1.0

    def write(self, command: float) -> None:  # type: ignore[override]
        time.sleep(0.05 * command)


class HaltsBetween(esair.Behavior):
    """Halts the robot while one command waits for the thread that has another."""

    first = esair.writes(float)
    second = esair.writes(float)

    async def run(self) -> None:
        writes = [
            asyncio.ensure_future(w.write(1.0)) for w in (self.first, self.second)
        ]
        await asyncio.sleep(0.01)
        await self.halt_robot("enough")
        await asyncio.gather(*writes)


@pytest.mark.promise("REP-2", "RS-3")
def test_a_command_that_a_thread_has_refused_is_refused_again(tmp_path: Path) -> None:
    """It was in the thread's queue when the robot was halted: that is no driver's error."""

    def make(record: esair.Recording | None = None) -> esair.Robot:
        line = Line(name="line")
        both = [Slow(name=name, bus=line) for name in ("first", "second")]
        return esair.Robot(resources=both, behaviors=[HaltsBetween()], record=record)

    path = tmp_path / "run.mcap"
    esair.run(make(esair.Recording(path, min_free=0)), duration=0.3)
    kinds = [str(each.kind) for each in events_of(path) if each.component == "second"]
    assert "refused" in kinds
    assert "unanswered" not in kinds

    assert Replay(path).run(make()).divergence is None


class Echo(esair.Sensor[float]):
    rate = 50.0

    async def read(self) -> float:
        return 1.0


class Wheel(esair.Actuator[float]):
    safe = 0.0

    async def write(self, command: float) -> None:
        """It takes no time."""


class Tells(esair.Reaction):
    """Decides by what it knows of time."""

    rate = 70.0
    echo = esair.reads(float, max_age=0.5)
    wheel = esair.writes(float)

    def react(self, echo: float) -> float:
        return self.now_ms + self.elapsed_ms / 1024


class Stumbles(esair.Behavior):
    """Fails at first; then it drives on."""

    echo = esair.reads(float, max_age=0.5)
    wheel = esair.writes(float)
    restart = esair.Restart(delay=0.01)
    speed = 0.5

    def __init__(self) -> None:
        super().__init__()
        self.has_failed = False

    async def run(self) -> None:
        await self.echo.read()
        if not self.has_failed:
            self.has_failed = True
            raise RuntimeError("a stone")
        await self.wheel.write(type(self).speed)


@pytest.mark.promise("REP-2")
def test_who_has_begun_again_had_its_readings_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often it has registered its sensors."""

    def make(record: esair.Recording | None = None) -> esair.Robot:
        parts = [Echo(), Wheel()]
        return esair.Robot(resources=parts, behaviors=[Stumbles()], record=record)

    path = tmp_path / "run.mcap"
    esair.run(make(esair.Recording(path, min_free=0)), duration=0.3)
    monkeypatch.setattr(Stumbles, "speed", 0.6)

    found = Replay(path).run(make()).divergence
    assert found is not None
    assert [seen.sensor for seen in found.readings] == ["echo"]


@attrs.frozen
class Look(esair.Request[float]):
    """What a thread is asked for."""


class Eyes(esair.ThreadBehavior):
    """Answers from its thread, after some work."""

    looks = esair.takes(Look)
    lamp = esair.writes(float)

    def run(self) -> None:
        for number, request in enumerate(self.looks):
            with request:
                time.sleep(0.007 * (number % 3))
                request.progress(0.5)
                self.lamp.write(0.1 * number)
                if number % 4 == 3:
                    request.refuse("enough for now")
                elif number % 4 != 2:  # else it leaves without an answer
                    request.answer(0.5 + number)


class Asker(esair.Behavior):
    async def run(self) -> None:
        for _ in range(9):
            await asyncio.sleep(0.023)
            with contextlib.suppress(esair.EsairError):
                await self.ask("eyes", Look(), progress=lambda _: None)
        await self.stop_robot("it has seen enough")


class Follows(esair.Reaction):
    echo = esair.reads(float)
    wheel = esair.writes(float)

    def react(self, echo: float) -> float:
        return 0.3 * echo


class Planner(esair.Behavior):
    """Ends its steps by chance."""

    echo = esair.reads(float)
    wheel = esair.writes(float)

    def __init__(self) -> None:
        super().__init__()
        self.drawn: list[float] = []

    def _by_chance(self, _: object = None) -> bool:
        self.drawn.append(esair.random.random())
        return self.drawn[-1] > 0.7

    async def run(self) -> None:
        for _ in range(5):
            await self.perform(Follows(), until=self._by_chance, timeout=0.35)
        await self.stop_robot("it was enough")


@pytest.mark.real_clock
@pytest.mark.promise("REP-3", "REP-2")
def test_what_ends_a_step_draws_from_the_stream_of_its_behavior(tmp_path: Path) -> None:
    """Chance in ``until`` is that of the seed, in a run and in its repetition."""
    planners = [Planner() for _ in range(3)]

    def make(planner: Planner, **options: Any) -> esair.Robot:
        parts: list[Any] = [Echo(), Wheel()]
        return esair.Robot(resources=parts, behaviors=[planner], seed=5, **options)

    path = tmp_path / "run.mcap"
    esair.run(make(planners[0], record=esair.Recording(path)))
    assert Replay(path).run(make(planners[1])).divergence is None
    esair.run(make(planners[2]))
    assert planners[0].drawn == planners[1].drawn
    count = min(len(each.drawn) for each in planners)
    assert count > 2
    assert planners[0].drawn[:count] == planners[2].drawn[:count]


@pytest.mark.real_clock
@pytest.mark.promise("REP-2", "BS-8")
def test_what_a_thread_has_answered_is_answered_again(tmp_path: Path) -> None:
    """Whenever it did, its answers, progress and refusals come in the same turns."""

    def make(**options: Any) -> esair.Robot:
        lamp: Any = FakeActuator("lamp", safe=0.0)
        return esair.Robot(
            name="seer", resources=[lamp], behaviors=[Eyes(), Asker()], **options
        )

    path = tmp_path / "run.mcap"
    esair.run(make(record=esair.Recording(path)))
    outcome = Replay(path).run(make())
    assert (outcome.divergence, outcome.late) == (None, "")
    assert outcome.equal > 30


@pytest.mark.promise("REA-4", "REP-2")
def test_a_reaction_is_told_the_same_moments_again(tmp_path: Path) -> None:
    """Milliseconds are cut off, so the beginning has to be the same to the nanosecond."""

    def make(record: esair.Recording | None = None) -> esair.Robot:
        return esair.Robot(
            resources=[Echo(), Wheel()], behaviors=[Tells()], record=record
        )

    path = tmp_path / "run.mcap"
    esair.run(make(esair.Recording(path, min_free=0)), duration=0.5)
    outcome = Replay(path).run(make())
    assert outcome.divergence is None
    assert outcome.equal > 50


def verbs(folder: Path, *words: str, hash_seed: int = 1) -> tuple[int, str]:
    """Run ``esair`` in a process; return its exit code and all that it has said."""
    done = subprocess.run(
        [sys.executable, "-m", "esair", *words],
        cwd=folder,
        env={**os.environ, "PYTHONHASHSEED": str(hash_seed), "COLUMNS": "200"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.promise("REP-2")
@pytest.mark.long
def test_the_command_repeats_and_names_what_was_changed(tmp_path: Path) -> None:
    """In another process with another hash seed: exit 0, and 3 after a change."""
    folder = folder_of_robot(tmp_path)
    options = ("--for", "0.4", "--record", "0.mcap")
    code, said = verbs(folder, "run", "robot.toml", *options)
    assert code == 0, said
    code, said = verbs(folder, "replay", "0.mcap", hash_seed=4711)
    assert (code, said[:5]) == (0, "equal"), said

    code_file = folder / "robots.py"
    code_file.write_text(code_file.read_text().replace("GAIN = 0.5", "GAIN = 0.6"))
    code, said = verbs(folder, "replay", "0.mcap")
    assert code == 3
    assert said.startswith("follow does otherwise at "), said
    for word in (
        "recorded  command wheel <- follow",
        "now       ",
        "sonar, ",
        "bumper, ",
    ):
        assert word in said


@pytest.mark.promise("REP-2")
@pytest.mark.parametrize("what", ["robot", "demo"])
def test_a_hundred_live_minutes_are_repeated(
    what: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Each in another process with another hash seed, whatever else the machine does."""
    if not request.config.getoption("--esair-soak"):
        pytest.skip("it takes an hour: --esair-soak")
    wrong = asyncio.run(unequal(what, 100, 60.0, at_once=4, keep=tmp_path))
    assert wrong == []


@pytest.mark.promise("REP-2", "REC-3")
@pytest.mark.usefixtures("no_drivers")
def test_what_a_killed_robot_has_left_is_repeated(
    recording: Path, tmp_path: Path
) -> None:
    """A file that is cut anywhere is repeated up to there."""
    data = recording.read_bytes()
    equal = []
    for part in (0.7, 0.9, 0.97):
        cut = tmp_path / f"{part}.mcap"
        cut.write_bytes(data[: int(part * len(data))])
        outcome = Replay(cut).run(robots.make())
        has_end = "end" in facts_of(cut)
        assert (outcome.short == "") is has_end
        assert outcome.divergence is None
        equal.append(outcome.equal)
    assert equal == sorted(equal)
    assert equal[0] > 50


@pytest.mark.promise("REP-2", "REC-4")
@pytest.mark.usefixtures("no_drivers")
@pytest.mark.parametrize("number", [-1, -2])
def test_a_damaged_end_is_never_called_equal_to_the_end(
    recording: Path, tmp_path: Path, number: int
) -> None:
    """One bit of a chunk is another, so it is left out: of the last there is no gap."""
    data = bytearray(recording.read_bytes())
    chunks, place = list[int](), 8
    while place < len(data) - 8:
        if data[place] == 6:
            chunks.append(place)
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    data[chunks[number] + 200] ^= 1
    path = tmp_path / "run.mcap"
    path.write_bytes(data)

    outcome = Replay(path).run(robots.make())
    assert outcome.divergence is None
    assert outcome.short


@pytest.mark.promise("REP-2")
def test_two_robots_in_one_loop_are_not_taken_for_one(tmp_path: Path) -> None:
    """The turns of the first end where the second begins; those are of both."""
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"

    async def both() -> None:
        async with robots.make(first):
            await asyncio.sleep(0.1)
            async with robots.make(second):
                await asyncio.sleep(0.2)

    with asyncio.Runner(loop_factory=esair.new_event_loop) as runner:
        runner.run(both())
    outcome = Replay(first).run(robots.make())
    assert outcome.short == "another robot has begun in its event loop"
    with pytest.raises(RecordingBrokenError, match="not exact: another robot"):
        Replay(second)


class Camera(esair.Sensor[bytes]):
    """Gives pictures that are larger than what is recorded of a value."""

    rate = 50.0

    async def read(self) -> bytes:
        return bytes(2 * VALUE_LIMIT)


class Measure(esair.Reaction):
    """Reads them."""

    camera = esair.reads(bytes)
    wheel = esair.writes(float)

    def react(self, camera: bytes) -> float:
        return len(camera) / VALUE_LIMIT


@pytest.mark.promise("REP-2")
def test_large_pictures_are_repeated(tmp_path: Path) -> None:
    """What the journal leaves out is no difference; the turns have it."""
    path = tmp_path / "run.mcap"

    def make(record: esair.Recording | None = None) -> esair.Robot:
        parts = [Camera(), robots.Wheel()]
        return esair.Robot(resources=parts, behaviors=[Measure()], record=record)

    esair.run(make(esair.Recording(path, min_free=0)), duration=0.2)
    commands = [event.value for event in events_of(path) if event.kind == "command"]
    assert commands
    assert {*commands} == {2.0}
    outcome = Replay(path).run(make())
    assert (outcome.divergence, outcome.short) == (None, "")


@pytest.mark.promise("REP-2")
def test_a_loop_of_another_kind_is_said_to_be_inexact(tmp_path: Path) -> None:
    """The user's own loop has no border; its file says so."""
    path = tmp_path / "own.mcap"
    esair.run(robots.make(path), duration=0.05, loop_factory=asyncio.new_event_loop)

    with pytest.raises(RecordingBrokenError, match="not exact: its event loop is"):
        Replay(path)


@pytest.mark.promise("REP-2")
@pytest.mark.parametrize(
    ("data", "words"),
    [(b"", "no recording of esair"), (b"motor,1.0\n" * 50, "no recording of esair")],
    ids=["empty", "text"],
)
def test_what_is_no_recording_is_named(tmp_path: Path, data: bytes, words: str) -> None:
    """A clear line, and the exit code of what cannot be used."""
    path = tmp_path / "run.mcap"
    path.write_bytes(data)

    with pytest.raises(RecordingBrokenError, match=words):
        Replay(path)


@pytest.mark.promise("REP-2")
@pytest.mark.parametrize("fact", [b"exact", b"simulated", b"duration"])
def test_damaged_facts_are_named(recording: Path, tmp_path: Path, fact: bytes) -> None:
    """A byte of them has changed its value on the disk."""
    data = recording.read_bytes()
    assert fact in data
    path = tmp_path / "run.mcap"
    path.write_bytes(data.replace(fact, fact[:-1] + b"#"))

    with pytest.raises(RecordingBrokenError, match=f"damaged.*{fact.decode()}"):
        Replay(path)


class Evil:
    """Would be made by a call, if it were read back by what asks it how."""

    def __reduce__(self) -> Any:
        return os.system, ("true",)


@pytest.mark.promise("REP-2", "SEC-2")
def test_what_is_no_plain_data_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It is told when it is recorded, once, and what is kept ends there."""
    path = tmp_path / "run.mcap"

    async def read(_: object) -> Any:
        return Evil()

    monkeypatch.setattr(robots.Sonar, "read", read)
    robots.recorded(path, 0.5)
    told = "what call sonar read gave cannot be kept: "
    assert sum(told in line for line in caplog.messages) == 1

    kept = Kept(path, chunks_of(path), Kinds())
    assert [item for item in kept if type(item) is float]
    assert str(kept.spoiled).startswith(told)
    assert "Evil is no plain data" in str(kept.spoiled)


@pytest.mark.promise("REP-2")
@pytest.mark.parametrize(("number", "held_up"), [(1, 0), (2, 0), (5, 0), (5, 0.05)])
def test_what_is_before_it_is_repeated(
    number: int, held_up: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What else came in that very turn is no difference, be it the first.

    Nor is what a busy computer tells of some turns later.
    """

    async def stream(_: object) -> AsyncIterator[Any]:
        for each in itertools.count(1):
            time.sleep(held_up)  # noqa: ASYNC251 - much comes in in few turns
            yield Evil() if each == number else True
            await asyncio.sleep(0.005)

    with monkeypatch.context() as once:
        once.setattr(robots.Bumper, "stream", stream)
        path = robots.recorded(tmp_path / "run.mcap", 0.3)
    if held_up:
        monkeypatch.setattr("esair.journal._journal.SLICE", 0.0)  # one event a turn
    outcome = Replay(path).run(robots.make())
    assert outcome.divergence is None
    assert outcome.short.startswith("what bumper pushed gave cannot be kept")


def check(kind: type, folder: Path) -> list[Unrepeatable]:
    """Return what cannot repeat in the code of a class, by a file that names it."""
    file = folder / "robot.toml"
    module = f"tests.replay.{Path(__file__).stem}"
    table = f'[behavior.{kind.__name__.lower()}]\ndriver = "{module}:{kind.__name__}"\n'
    file.write_text(f'[robot]\nname = "it"\n{table}')
    (folder / "tests" / "replay").mkdir(parents=True)
    for each in (Path(__file__), Path(robots.__file__)):
        (folder / "tests" / "replay" / each.name).write_bytes(each.read_bytes())
    return unrepeatable(file)


def draws() -> float:
    """Draw from what nobody seeds."""
    import time

    assert time.time() > 0
    drawn: float = robots.random.random()
    return drawn + float(os.urandom(1)[0])


class Guesses(esair.Reaction):
    """Decides on what no recording has."""

    wheel = esair.writes(float)
    rate = 10.0

    def react(self) -> float:
        with open(os.devnull) as file:
            return len(file.read()) + draws()


@pytest.mark.promise("REP-3")
def test_what_cannot_repeat_is_named(tmp_path: Path) -> None:
    """Files, randomness: with the line, and what to use instead."""
    found = check(Guesses, tmp_path)

    assert {(each.component, each.call) for each in found} == {
        ("guesses", "io.open"),
        ("guesses", "random.random"),
        ("guesses", "os.urandom"),
        ("guesses", "time.time"),
    }
    lines = Path(__file__).read_text().splitlines()
    assert all(each.call.rpartition(".")[2] in lines[each.line - 1] for each in found)
    assert any("esair.random" in each.why for each in found)


class Hides(esair.Reaction):
    """What cannot repeat, behind names and modules."""

    wheel = esair.writes(float)
    rate = 10.0

    def react(self, system: object = None) -> float:
        import functools
        from os import getpid
        from os import system as run
        from os import urandom as some

        clock = functools.partial(time.time)
        names = sorted(robots.stamps(), key=lambda _: some(1))
        assert system is None or isinstance(system, Path)  # neither is a call
        run(f"true {names} {getpid()}")
        seeded = random.Random(3).random() + float(time.strftime("%H", time.gmtime(0)))
        return clock() + float(time.strftime("%H")) + seeded


@pytest.mark.promise("REP-3")
def test_what_hides_is_named_too(tmp_path: Path) -> None:
    """Functions that are only handed on, other names, modules of the same folder."""
    assert {each.call for each in check(Hides, tmp_path)} == {
        *("time.time", "os.urandom", "os.system", "time.strftime", "os.listdir")
    }


class Works(esair.Behavior):
    """In threads that the robot orders, and in one that it does not."""

    async def run(self) -> None:
        from anyio import to_thread

        await asyncio.to_thread(str)
        await to_thread.run_sync(str)


@pytest.mark.promise("REP-3")
def test_a_thread_that_nobody_orders_is_named(tmp_path: Path) -> None:
    """With the way that repeats."""
    (found,) = check(Works, tmp_path)
    assert found.call == "anyio.to_thread.run_sync"
    assert "asyncio.to_thread" in found.why


PLACED = """
import asyncio
import esair


class Base(esair.Behavior):
    placement = {}

    async def run(self) -> None:
        await asyncio.to_thread(str)


class Works(Base):
    pass
"""


@pytest.mark.promise("REP-3", "PLC-7")
def test_a_thread_in_a_process_of_its_own_is_named(tmp_path: Path) -> None:
    """Its recording is not exact; that of the same component in the robot's is."""
    file = tmp_path / "works.py"
    toml = tmp_path / "robot.toml"
    toml.write_text('[behavior.works]\ndriver = "works:Works"\nplacement = "process"\n')
    file.write_text(PLACED.format("'task'"))
    assert unrepeatable(f"{file}:robot") == []
    assert "without placement" in unrepeatable(toml)[0].why
    file.write_text(PLACED.format("'process'"))
    assert [each.call for each in unrepeatable(f"{file}:robot")] == [
        "asyncio.to_thread"
    ]


@pytest.mark.promise("REP-3")
def test_what_repeats_is_not_named(tmp_path: Path) -> None:
    """Neither the random numbers of the robot, nor its time, nor drivers."""
    file = tmp_path / "robot.toml"
    file.write_text(
        '[behavior.follow]\ndriver = "robots:Follow"\n'
        '[behavior.wander]\ndriver = "robots:Wander"\n'
    )
    (tmp_path / "robots.py").write_text(Path(robots.__file__).read_text())
    assert unrepeatable(file) == []


@pytest.mark.promise("REP-3", "SEC-2")
def test_a_check_runs_and_makes_nothing(tmp_path: Path) -> None:
    """Neither the modules that are named, nor the classes in them."""
    (tmp_path / "robots.py").write_text(
        f"{Path(robots.__file__).read_text()}\nPath('ran').touch()\n"
    )
    (tmp_path / "robot.toml").write_text('[behavior.wave]\ndriver = "robots:Wave"\n')
    before = {*sys.modules}
    found = unrepeatable(tmp_path / "robot.toml")

    assert {each.call for each in found} == {"random.choice"}
    assert not (tmp_path / "ran").exists()
    assert not Path("ran").exists()
    assert {*sys.modules} == before


@pytest.mark.promise("REP-3")
@pytest.mark.parametrize("driver", ["robotz:Wave", "robots:Wawe", "nothing"])
def test_what_has_no_source_is_not_called_repeatable(
    tmp_path: Path, driver: str
) -> None:
    """A module, a class, an installed driver that is not there: it was not looked at."""
    (tmp_path / "robots.py").write_text(Path(robots.__file__).read_text())
    (tmp_path / "robot.toml").write_text(f'[behavior.wave]\ndriver = "{driver}"\n')

    with pytest.raises(esair.ConfigError, match="there is no source of"):
        unrepeatable(tmp_path / "robot.toml")


@pytest.mark.long
@pytest.mark.promise("REP-3")
def test_the_command_names_them(tmp_path: Path) -> None:
    """``--check`` runs nothing, and its exit code says whether there is any."""
    folder = folder_of_robot(tmp_path)
    verbs(folder, "run", "robot.toml", "--for", "0.1", "--record", "run.mcap")
    code, said = verbs(folder, "replay", "run.mcap", "--check")

    assert code == 3
    assert "wave: " in said
    assert "random.choice: randomness" in said


@pytest.mark.promise("REP-2")
def test_random_numbers_are_those_of_the_run(recording: Path) -> None:
    """The seed is in the file: else what wander asks for would differ."""
    events = [e for e in events_of(recording) if e.peer == "wander"]
    asked = {e.value for e in events if e.kind == "command"}

    assert len(asked) > 2


@pytest.mark.long
@pytest.mark.promise("REP-2")
def test_a_run_that_a_signal_has_ended_is_repeated(tmp_path: Path) -> None:
    """Most runs end so; the stop is compared too."""
    folder = folder_of_robot(tmp_path)
    words = [sys.executable, "-m", "esair", "run", "robot.toml", "--record", "run.mcap"]
    process = subprocess.Popen(words, cwd=folder, stderr=subprocess.PIPE)
    while not (folder / "run.mcap").exists() and process.poll() is None:
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT
    assert b"left behind" not in said

    code, told = verbs(folder, "replay", "run.mcap")
    assert (code, told[:5]) == (0, "equal"), told


@pytest.mark.promise("REP-2")
def test_a_robot_that_cannot_start_today_says_why(recording: Path) -> None:
    """Its mistakes are named, not where it differs."""
    robot = esair.Robot(resources=[robots.Sonar()], behaviors=[robots.Follow()])

    with pytest.raises(ExceptionGroup) as raised:
        Replay(recording).run(robot)
    assert "follow" in str(raised.value.exceptions[0])
