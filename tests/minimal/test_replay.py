"""One journal of readings through STD and MIN: the commands are the same."""

import asyncio
import json
import math
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from hypothesis import strategies as st
from tests.minimal import worlds

import esair
from esair.testing import FakeSensor, VirtualLoop

T = 1.0 / worlds.RATE

World = dict[str, Any]
Told = dict[str, list[Any]]


class Teller(esair.Actuator[Any]):
    """An actuator of STD that writes down what it is told."""

    def __init__(self, recorder: worlds.Recorder) -> None:
        super().__init__(name=recorder.name)
        self.recorder = recorder
        self.safe = recorder.safe
        self.command_timeout = recorder.command_timeout
        self.limits = recorder.limits  # type: ignore[assignment]
        self.clamp = recorder.clamp

    async def write(self, command: Any) -> None:
        self.recorder.write(command)


class Notes:
    """What actuators are told in STD, by lines of the journal.

    Args:
        behind: How long after the beginning the first line counts, in periods.
    """

    def __init__(self, behind: float) -> None:
        self.told: Told = {}
        self.loop = asyncio.get_running_loop()
        self.behind = behind
        self.begin = math.inf
        """When the journal begins; what is told first, or before, is of the opening."""
        self.end: int | None = None
        """The line of what is told from now on: the end."""

    def tell(self, name: str, command: Any) -> None:
        line = self.end
        if line is None:
            line = -1
            if name in self.told and self.loop.time() >= self.begin:
                periods = (self.loop.time() - self.begin) / T - self.behind
                line = max(-1, math.ceil(periods - 1e-3))
        self.told.setdefault(name, []).append([line, command])


async def play_in_std(world: World) -> Told:
    """Run a world in STD, with devices that answer in the event loop."""
    # Readings arrive amid two steps. Reactions with a rate step a whole period after
    # the beginning, the others at once.
    notes = Notes(behind=1.0 if world["reactions"][0]["every"] else 0.5)
    loop, journal = notes.loop, world["journal"]
    sensors: list[FakeSensor[int]] = [
        FakeSensor(f"s{i}") for i in range(len(journal[0]))
    ]
    _, recorders = worlds.make_devices(world, worlds.Moment(), notes.tell)
    robot = esair.Robot(
        resources=[*sensors, *map(Teller, recorders)],
        behaviors=worlds.make_reactions(world),
    )
    async with robot:
        begin = notes.begin = loop.time()
        for line, readings in enumerate(journal):
            await asyncio.sleep(begin + (line + 0.5) * T - loop.time())
            for sensor, every, reading in zip(
                sensors, world["sensors"], readings, strict=True
            ):
                if line % every == 0 and reading is not None:
                    sensor.feed(reading)
        await asyncio.sleep(begin + (len(journal) + 0.25) * T - loop.time())
        notes.end = len(journal)
    return notes.told


class Clock:
    """Which line of the journal counts, by the clock of the loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.begin = loop.time()

    @property
    def line(self) -> int:
        return round((self.loop.time() - self.begin) / T)


async def play_on_threads(world: World) -> Told:
    """Run a world in STD, with the very devices of MIN, which get worker threads."""
    # Sensors are asked on the lines; reactions with a rate wait for the answers.
    notes = Notes(behind=0.0)
    loop, journal = notes.loop, world["journal"]
    clock = Clock(loop)
    notes.begin = clock.begin
    sensors, actuators = worlds.make_devices(world, clock, notes.tell)
    robot = esair.Robot(
        resources=[*sensors, *actuators],
        behaviors=worlds.make_reactions(world),
        start_patience=1e-6,  # the first decisions may be bad
    )
    async with robot:
        assert loop.time() == pytest.approx(clock.begin, abs=1e-5)
        await asyncio.sleep((len(journal) - 0.75) * T)
        notes.end = len(journal)
    return notes.told


def in_std(world: World, play: Callable[[World], Any] = play_in_std) -> str:
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return steps_of(runner.run(play(world)), world)


def in_min(world: World) -> str:
    return steps_of(worlds.play(world), world)


def steps_of(told: Told, world: World) -> str:
    """Write down what each step has left, but the end: STD need not repeat safe.

    A step is the finest that MIN knows: where a time-out of STD ends between two steps,
    and the second one writes, MIN writes only.
    """
    steps = {}
    for name, lines in sorted(json.loads(json.dumps(told)).items()):
        safe = worlds.KINDS[world["actuators"][int(name[1:])]["kind"]]
        assert json.dumps(lines[-1][1]) == json.dumps(safe)
        left = dict(lines)
        steps[name] = [each for each in left.items() if each[0] < len(world["journal"])]
    return json.dumps(steps)


NUMBERS = [0.25, 0.5, 1, -0.75, 2.0, 0.0]

COMMANDS: dict[str, list[Any]] = {
    "number": [*NUMBERS, "nan", "inf", "x", True],
    "count": [0, 1, 2, -3, 0.5, True, "x"],
    "switch": [True, False, 1],
    "pair": [[0.0, 0.0], [0.25, 0.5], [1, -0.75], [2.0, "nan"], [0.5], 0.5],
    "twist": [[0.0, 0.0], [0.25, 0.5], [1, -0.75], [2.0, 0.25], ["inf", 0.25], 0.5],
}
"""What reactions decide to send to each kind of actuator; some is safe, some no good."""

LIMITS: dict[str, list[Any]] = {
    "number": [None, [-1.0, 1.0]],
    "count": [None, [-1, 2]],
    "switch": [None],
    "pair": [None],
    "twist": [None, {"linear": [-0.5, 1.0]}],
}


def make_world(
    rng: random.Random, *, at_once: bool = True, blind: bool = True
) -> World:
    """Make any world: who reads and writes what, which decisions, which readings.

    Left out is what time decides in STD. While a command is on its way, another write
    waits, and a third may overtake it. Reactions without a rate run in the order in
    which their readings arrive, and those with different rates in any order.

    Args:
        rng: Whose choice it is.
        at_once: Whether drivers end at once, so that no write has to wait for another.
        blind: Whether readings are lost and reactions die.
    """
    timed = rng.random() < 0.7
    # Without a parked reaction, and its safe command, any number may write an actuator.
    calm = not blind or rng.random() < 0.3
    crowd = calm and at_once
    sensors = range(rng.randint(1, 3))
    every = [rng.choice([1, 1, 2, 3]) for _ in sensors]
    losses = [0.0 if calm else rng.choice([0.0, 0.1, 0.5]) for _ in sensors]
    actuators = [make_actuator(rng) for _ in range(rng.randint(1, 3))]
    moved_by = [rng.choice(sensors) for _ in actuators]
    paces = [1 if at_once else rng.choice([1, 1, 2, 3]) for _ in actuators]
    free = [
        each
        for each in range(len(actuators))
        for _ in range(2 if timed and at_once else 1)
    ]
    # No two are equal: who has held an actuator last is not the same after an error.
    ranks = [rng.sample(range(8), 8) for _ in actuators]
    reactions = []
    for _ in range(rng.randint(1, 6)):
        able = sorted(set(free)) or (list(range(len(actuators))) if crowd else [])
        if not able:
            break
        if timed:
            inputs = rng.sample(sensors, rng.randint(1, len(sensors)))
            pace = paces[rng.choice(able)]
            able = [each for each in able if paces[each] == pace]
        else:
            inputs = [moved_by[rng.choice(able)]]
            able = [each for each in able if moved_by[each] in inputs]
        written = rng.sample(able, rng.randint(1, len(able)))
        for each in written:
            if each in free:
                free.remove(each)
        kinds = [actuators[each]["kind"] for each in written]
        reactions.append(
            {
                "inputs": [
                    [one, make_max_age(rng, every[one], losses[one], calm=calm)]
                    for one in inputs
                ],
                "outputs": [
                    [one, ranks[one].pop(), rng.choice([None, rng.randint(1, 12)])]
                    for one in written
                ],
                "every": paces[written[0]] if timed else None,
                "dies": None if calm else rng.choice([None] * 4 + [rng.randint(0, 20)]),
                "decisions": [decide(rng, kinds) for _ in range(rng.randint(1, 6))],
            }
        )
    return {
        "sensors": every,
        "actuators": actuators,
        "reactions": reactions,
        "journal": make_journal(rng, losses),
    }


def make_actuator(rng: random.Random) -> dict[str, Any]:
    kind = rng.choice(["number", "number", *worlds.KINDS])
    limits = rng.choice(LIMITS[kind])
    return {
        "kind": kind,
        "timeout": rng.randint(2, 8),
        "limits": limits,
        "clamp": isinstance(limits, list) and rng.random() < 0.5,
    }


def make_max_age(
    rng: random.Random, every: int, loss: float, *, calm: bool
) -> int | None:
    if calm:
        return rng.choice([None, every + rng.randint(0, 5)])
    # Without one MIN parks at the first loss, STD when the device is given up.
    return rng.choice([None] * (not loss) + [rng.randint(1, 6), rng.randint(2, 6)])


def decide(rng: random.Random, kinds: list[str]) -> Any:
    choices = [rng.choice([None, *COMMANDS[kind], *COMMANDS[kind]]) for kind in kinds]
    if len(kinds) == 1:
        return choices[0]
    taken = [pair for pair in zip("xyz", choices, strict=False) if rng.random() < 0.8]
    return rng.choice([None, *[dict(taken)] * 4])


def make_journal(rng: random.Random, losses: list[float]) -> list[list[int | None]]:
    journal: list[list[int | None]] = []
    line = [0] * len(losses)
    for _ in range(rng.randint(4, 40)):
        if rng.random() < 0.5:
            line = [rng.randint(0, 5) for _ in losses]
        lost = [rng.random() < loss for loss in losses]
        journal.append(
            [None if gone else each for each, gone in zip(line, lost, strict=True)]
        )
    return journal


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-2", "AC-2", "REA-1")
@hypothesis.given(st.randoms(use_true_random=False))
def test_any_world_is_the_same_in_std_and_min(rng) -> None:
    """Whatever the wiring and the readings, each actuator is told the same."""
    world = make_world(rng, blind=False)
    hypothesis.note(json.dumps(world))

    assert in_std(world) == in_min(world)


def reflex(priority: int, *decisions: Any) -> dict[str, Any]:
    """Describe a reaction to the one sensor that decides so on the one actuator."""
    return {
        "inputs": [[0, None]],
        "outputs": [[0, priority, None]],
        "every": 1,
        "dies": None,
        "decisions": list(decisions),
    }


@pytest.mark.real_clock
@pytest.mark.promise("MIN-2", "MIN-3", "PRO-2")
@pytest.mark.parametrize(
    ("decisions", "steps"),
    [
        ([[1], [False]], [-1, 0, 1, 2, 3]),  # 1 is no command: who says it is blind
        ([[None, 1, 1, 1], [False, None, None, None]], [-1, 0, 3]),  # it times out
        ([[None, 1, 1, 1], [True, None, None, None]], [-1, 0, 1]),
        ([[True, None, None, None], [1], [None, False, None, None]], [-1, 0, 1]),
    ],
    ids=[
        "it passes a blind hold",
        "none takes it back",
        "a motion is taken back",
        "a motion that it has ended does not time out",
    ],
)
def test_what_equals_safe_is_safe_in_std_and_min(decisions, steps) -> None:
    """A blind hold lets it pass, and does not send safe again for what stands."""
    world = {
        "sensors": [1],
        "actuators": [{"kind": "switch", "timeout": 2, "limits": None, "clamp": False}],
        "reactions": [reflex(7 - n, *each) for n, each in enumerate(decisions)],
        "journal": [[0], [1], [2], [3]],
    }

    told = in_min(world)

    assert [line for line, _ in json.loads(told)["m0"]] == steps
    assert in_std(world) == told


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-2", "AC-2", "REA-1")
@hypothesis.given(st.randoms(use_true_random=False))
@hypothesis.settings(max_examples=20)
def test_the_very_devices_of_min_are_told_the_same_in_std(rng) -> None:
    """Plain sensors and actuators, on worker threads, get what they get in MIN."""
    world = make_world(rng, at_once=False, blind=False)
    hypothesis.note(json.dumps(world))

    assert in_std(world, play_on_threads) == in_min(world)


@pytest.fixture
def seed_and_count(request) -> tuple[int, int]:
    """The worlds that all of them run: the same each time, or with --esair-soak new ones."""
    if request.config.getoption("--esair-soak"):
        return random.randrange(2**32), 1000
    return 4, 100 if request.config.getoption("--esair-long") else 25


def some_worlds(seed: int, count: int, **options: bool) -> list[World]:
    rng = random.Random(seed)
    return [make_world(rng, **options) for _ in range(count)]


@pytest.mark.longer
@pytest.mark.real_clock
@pytest.mark.promise("MIN-2")
@pytest.mark.parametrize("play", [play_in_std, play_on_threads])
def test_many_worlds_are_the_same_in_std_and_min(seed_and_count, play) -> None:
    """Larger worlds than hypothesis makes."""
    seed, count = seed_and_count
    many = some_worlds(seed, count, at_once=play is play_in_std, blind=False)
    differ = [i for i, world in enumerate(many) if in_std(world, play) != in_min(world)]

    assert differ == [], f"of seed {seed}"


PLAY = """
import json, worlds
with open('data.json') as file:
    data = json.load(file)
for world in data:
    print(json.dumps(worlds.play(world)))
"""


@pytest.mark.real_clock
@pytest.mark.promise("MIN-1", "MIN-2")
def test_many_worlds_are_the_same_on_micropython(
    seed_and_count, micropython, board
) -> None:
    """The same files, unchanged, decide the same on MicroPython."""
    seed, count = seed_and_count
    many = some_worlds(seed, count)
    shutil.copy(Path(worlds.__file__), board / "worlds.py")

    printed = micropython.run(board, PLAY, data=many, seconds=300.0)

    lines = map(json.loads, printed.splitlines())
    played = [steps_of(told, world) for told, world in zip(lines, many, strict=True)]
    differ = [i for i, world in enumerate(many) if played[i] != in_min(world)]
    assert differ == [], f"of seed {seed}"


@pytest.mark.real_clock
def test_the_worlds_are_worth_playing() -> None:
    """They move every kind of actuator, refuse, time out, are parked, and die."""
    many = some_worlds(4, 200)
    refused = faults = 0
    values = set()
    for world in many:
        loop, told = worlds.run(world)
        refused += loop.refused
        faults += loop.faults
        values |= {json.dumps(line[1]) for lines in told.values() for line in lines}

    assert refused > 1000
    assert faults > 1000
    assert values >= {"0.25", "-0.75", "2.0", "true", "-3", "[0.25, 0.5]", "[1, -0.75]"}
    assert not values & {"NaN", "Infinity", '"x"'}
