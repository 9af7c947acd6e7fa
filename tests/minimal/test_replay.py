"""One journal of readings through STD and MIN: the commands are the same."""

import asyncio
import json
import math
import random
import shutil
from pathlib import Path

import hypothesis
import pytest
import worlds
from hypothesis import strategies as st

import esair
from esair.testing import FakeSensor

T = 1.0 / worlds.RATE


class Told(esair.Actuator[float]):
    """An actuator of STD that writes down what it is told, and when."""

    safe = 0.0

    def __init__(self, number: int, about: dict, told) -> None:
        recorder = worlds.Recorder(number, about, told)
        super().__init__(name=recorder.name)
        self.command_timeout = recorder.command_timeout
        self.limits = recorder.limits  # type: ignore[assignment]
        self.tell = told

    async def write(self, command: float) -> None:
        self.tell(self.name, command)


async def play_in_std(world: dict) -> dict[str, list]:
    """Run a world in STD; readings arrive half a period before the steps."""
    loop = asyncio.get_running_loop()
    told: dict[str, list] = {}
    begin = loop.time()
    end = math.inf
    # With a rate they step a whole period after the beginning, else on each reading.
    behind = 1.0 if world["reactions"][0]["timed"] else 0.5

    def tell(name: str, command: float) -> None:
        line = math.ceil((loop.time() - begin) / T - behind - 1e-6)
        told.setdefault(name, []).append([max(-1, min(line, end)), command])

    journal = world["journal"]
    sensors = [FakeSensor(f"s{i}") for i in range(len(journal[0]))]
    actuators = [Told(i, each, tell) for i, each in enumerate(world["actuators"])]
    robot = esair.Robot(
        resources=[*sensors, *actuators], behaviors=worlds.make_reactions(world)
    )
    begin += T  # the opening counts as before the first line
    async with robot:
        begin = loop.time()
        for line, readings in enumerate(journal):
            await asyncio.sleep(begin + (line + 0.5) * T - loop.time())
            for sensor, reading in zip(sensors, readings, strict=True):
                if reading is not None:
                    sensor.feed(reading)
        await asyncio.sleep(begin + (len(journal) + 0.25) * T - loop.time())
        end = len(journal)
    return told


def steps_of(told: dict[str, list], world: dict) -> dict[str, list]:
    """Leave out the end, where STD need not repeat a safe command, but check it."""
    end = len(world["journal"])
    assert all(lines[-1][1] == 0.0 for lines in told.values())
    return {
        name: [line for line in lines if line[0] < end] for name, lines in told.items()
    }


def in_min(world: dict) -> dict[str, list]:
    return steps_of(worlds.play(world), world)


def in_std(world: dict) -> dict[str, list]:
    from esair.testing import VirtualLoop

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return steps_of(runner.run(play_in_std(world)), world)


def two_writers_at_most(world: dict) -> dict:
    """Leave out what STD leaves open, where readings get lost.

    When one reaction is parked in a step, the others wait in STD for the safe command
    to end, and two of them may come to their turns in another order.
    """
    if not any(None in line for line in world["journal"]):
        return world
    writers: dict[int, int] = {}
    kept = []
    for reaction in world["reactions"]:
        written = [actuator for actuator, _, _ in reaction["outputs"]]
        if all(writers.get(each, 0) < 2 for each in written):
            kept.append(reaction)
            for each in written:
                writers[each] = writers.get(each, 0) + 1
    return {**world, "reactions": kept}


DECISIONS = [None, None, 0.25, 0.5, 1, -0.75, 2.0, "nan", "inf"]


@st.composite
def some_world(draw) -> dict:
    """Any world: who reads and writes what, which decisions, which readings."""
    timed = draw(st.booleans())
    sensors = draw(st.integers(1, 3)) if timed else 1
    actuators = [
        {
            "timeout": draw(st.integers(2, 8)),
            "limits": draw(st.sampled_from([None, [-1.0, 1.0]])),
        }
        for _ in range(draw(st.integers(1, 3)))
    ]
    reactions = []
    for _ in range(draw(st.integers(1, 5))):
        reads = draw(
            st.lists(
                st.integers(0, sensors - 1), min_size=1, max_size=sensors, unique=True
            )
        )
        writes = draw(
            st.lists(
                st.integers(0, len(actuators) - 1),
                min_size=1,
                max_size=len(actuators),
                unique=True,
            )
        )
        outputs = [
            [one, draw(st.integers(0, 3)), draw(st.none() | st.integers(1, 12))]
            for one in writes
        ]
        decision = st.sampled_from(DECISIONS)
        if len(writes) > 1:
            keys = "xyz"[: len(writes)]
            decision = st.none() | st.dictionaries(st.sampled_from(keys), decision)
        reactions.append(
            {
                "inputs": [[one, draw(st.integers(2 - timed, 6))] for one in reads],
                "outputs": outputs,
                "timed": timed,
                "decisions": draw(st.lists(decision, min_size=1, max_size=6)),
            }
        )
    # Between two steps STD sees at once that a reading is too old, MIN at the step.
    reading = st.integers(0, 5) | st.none() if timed else st.integers(0, 5)
    line = st.lists(reading, min_size=sensors, max_size=sensors)
    journal = draw(st.lists(line, min_size=4, max_size=30))
    return two_writers_at_most(
        {"reactions": reactions, "actuators": actuators, "journal": journal}
    )


def random_world(rng: random.Random) -> dict:
    """A world by a plain random generator: fast, for large numbers of them."""
    timed = rng.random() < 0.7
    sensors = rng.randint(1, 3) if timed else 1
    actuators = [
        {
            "timeout": rng.randint(2, 8),
            "limits": rng.choice([None, [-1.0, 1.0]]),
        }
        for _ in range(rng.randint(1, 3))
    ]
    reactions = []
    for _ in range(rng.randint(1, 6)):
        reads = rng.sample(range(sensors), rng.randint(1, sensors))
        writes = rng.sample(range(len(actuators)), rng.randint(1, len(actuators)))
        decisions: list = [rng.choice(DECISIONS) for _ in range(rng.randint(1, 6))]
        if len(writes) > 1:
            decisions = [
                {
                    key: rng.choice(DECISIONS)
                    for key in "xyz"[: len(writes)]
                    if rng.random() < 0.8
                }
                if rng.random() < 0.8
                else None
                for _ in decisions
            ]
        reactions.append(
            {
                "inputs": [[one, rng.randint(2 - timed, 6)] for one in reads],
                "outputs": [
                    [one, rng.randint(0, 3), rng.choice([None, rng.randint(1, 12)])]
                    for one in writes
                ],
                "timed": timed,
                "decisions": decisions,
            }
        )
    loss = rng.choice([0.0, 0.1, 0.5]) if timed else 0.0
    journal: list[list[int | None]] = []
    for _ in range(rng.randint(10, 40)):
        repeat = journal and rng.random() < 0.5
        line = [rng.randint(0, 5) for _ in range(sensors)] if not repeat else journal[-1]
        journal.append([None if rng.random() < loss else each for each in line])
    return two_writers_at_most(
        {"reactions": reactions, "actuators": actuators, "journal": journal}
    )


@pytest.mark.real_clock
@pytest.mark.promise("MIN-2", "AC-2", "REA-1")
@hypothesis.given(some_world())
@hypothesis.settings(max_examples=60)
def test_any_world_is_the_same_in_std_and_min(world) -> None:
    """Whatever the wiring and the readings, each actuator is told the same."""
    assert in_min(world) == in_std(world)


@pytest.fixture
def many(request) -> list[dict]:
    """The worlds that all three run: more with --esair-soak."""
    rng = random.Random(4)
    count = 1000 if request.config.getoption("--esair-soak") else 150
    return [random_world(rng) for _ in range(count)]


@pytest.mark.real_clock
@pytest.mark.promise("MIN-2")
def test_many_worlds_are_the_same_in_std_and_min(many) -> None:
    """Also large ones, which hypothesis makes rarely."""
    differ = [i for i, world in enumerate(many) if in_min(world) != in_std(world)]

    assert differ == []


@pytest.mark.real_clock
@pytest.mark.promise("MIN-1", "MIN-2")
def test_many_worlds_are_the_same_on_micropython(many, micropython, board) -> None:
    """The same file, unchanged, decides the same on MicroPython."""
    shutil.copy(Path(worlds.__file__), board / "worlds.py")
    printed = micropython.run(
        board,
        "import json, worlds\n"
        "with open('/data.json') as file:\n"
        "    data = json.load(file)\n"
        "for world in data:\n"
        "    print(json.dumps(worlds.play(world)))\n",
        data=many,
        seconds=300.0,
    )
    played = [json.loads(line) for line in printed.splitlines()]

    assert played == [worlds.play(world) for world in many]


@pytest.mark.real_clock
def test_the_worlds_are_worth_playing(many) -> None:
    """Holds refuse, commands time out, and commands that are no good are met."""
    told = [worlds.play(world) for world in many]
    commands = [line for each in told for lines in each.values() for line in lines]

    assert len(commands) > 10 * len(many)
    assert sum(command == 0.0 for _, command in commands) > 2 * len(many)
    assert {0.25, 0.5, 1.0, -0.75, 2.0} <= {command for _, command in commands}
