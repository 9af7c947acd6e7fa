"""Robots as people wire them decide the same in STD and on every board."""

import asyncio
import json
import math
import random
import shutil
from pathlib import Path
from typing import Any

import pytest
from tests.minimal import natural
from tests.minimal.hw.board import Board, why_not

import esair
from esair.testing import VirtualLoop

PERIOD_MS = 1000 // natural.RATE

TWO = {"Both", "Half"}
"""What moves two actuators."""

World = dict[str, Any]
Told = dict[str, list[Any]]


def make_world(rng: random.Random) -> World:
    """Draw a robot, and what its sensors see."""
    steps = rng.randint(20, 75)
    sensors = []
    for _ in range(rng.randint(1, 3)):
        rate = rng.choice([None, 50, 25, 10, 5])
        sensors.append(
            {
                "rate": rate or natural.RATE,
                "values": make_values(rng, steps * (rate or natural.RATE) // 50 + 2),
            }
        )
    actuators = [
        {
            "kind": rng.choice(["number", "pair", "pair", "count"]),
            "timeout": rng.choice([0.1, 0.2, 0.3, 0.5]),
            "limits": "",
        }
        for _ in range(rng.randint(1, 2))
    ]
    for each in actuators:
        if each["kind"] == "number":
            each["limits"] = rng.choice(["", "refuse", "clamp", "clamp"])
    reactions = [
        make_reaction(rng, sensors, actuators) for _ in range(rng.randint(1, 5))
    ]
    add_lamp(rng, sensors, actuators, reactions)
    return {
        "steps": steps,
        "sensors": sensors,
        "actuators": actuators,
        "reactions": reactions,
    }


def make_values(rng: random.Random, count: int) -> list[float | None]:
    """Let something wander nearer and farther, and the sensor fail for a while."""
    values: list[float | None] = []
    at, lost, often = rng.uniform(0.2, 2.0), 0, rng.choice([0.0, 0.0, 0.05, 0.15])
    for _ in range(count):
        at = min(2.0, max(0.2, at + rng.gauss(0.0, 0.15)))
        if not lost and rng.random() < often:
            lost = rng.randint(1, 12)
        lost = max(0, lost - 1)
        values.append(None if lost else round(at, 3))
    return values


def make_reaction(
    rng: random.Random, sensors: list[Any], actuators: list[Any]
) -> dict[str, Any]:
    able = ["Follow", "Avoid", "Sum", "Back", "Wrong", "Slower", "Stops"]
    able += ["Fuse"] * (len(sensors) > 1)
    if len(actuators) > 1 and actuators[1]["kind"] != "count":
        able += ["Both", "Half"]
    kind = rng.choice(able)
    seen = rng.sample(range(len(sensors)), 2 if kind == "Fuse" else 1)
    moved = [rng.randrange(len(actuators))] if kind not in TWO else [0, 1]
    return {
        "kind": kind,
        "rate": rng.choice([None, 50, 25, 10, 5]),
        "inputs": [[one, make_age(rng, sensors[one])] for one in seen],
        "outputs": [[one, *make_say(rng)] for one in moved],
    }


def make_say(rng: random.Random) -> list[Any]:
    """Draw a priority, a hold, what is done while blind, and whether a guard latches."""
    return [
        rng.randint(0, 3),  # some are equal
        rng.choice([None, None, 0.1, 0.3]),
        rng.choice(["safe", "safe", "release"]),
        rng.random() < 0.2,
    ]


OWN = [0, None, "safe", False]
"""What a reaction says that has its actuator for itself."""


def add_lamp(
    rng: random.Random,
    sensors: list[Any],
    actuators: list[Any],
    reactions: list[Any],
) -> None:
    """Add one that goes on without its second reading.

    One without a rate is called by STD between two steps when that is lost, and by MIN at
    the next: what it holds from then on ends a step apart, so nobody else moves the same.
    """
    if len(sensors) == 1:
        return
    seen = rng.sample(range(len(sensors)), 2)
    rate = rng.choice([None, 50, 25, 10, 5])
    if rate is None:
        actuators.append({"kind": "number", "timeout": 0.3, "limits": ""})
    moved = rng.randrange(len(actuators)) if rate else len(actuators) - 1
    reactions.append(
        {
            "kind": "Maybe",
            "rate": rate,
            "inputs": [[one, make_age(rng, sensors[one])] for one in seen],
            "outputs": [[moved, *(make_say(rng) if rate else OWN)]],
        }
    )


def make_age(rng: random.Random, sensor: dict[str, Any]) -> float:
    least: float = 1 / sensor["rate"] + 0.02
    return max(least, rng.choice([0.06, 0.1, 0.2, 0.5]))


async def _in_std(world: World) -> Told:
    told: Told = {}
    loop = asyncio.get_running_loop()
    begin = loop.time()

    def tell(name: str, command: Any) -> None:
        told.setdefault(name, []).append([(loop.time() - begin) * 1000, command])

    reactions, sensors, actuators = natural.make_parts(world, tell)
    async with esair.Robot(resources=[*sensors, *actuators], behaviors=reactions):
        await asyncio.sleep((world["steps"] - 0.5) * PERIOD_MS / 1000)
        return {name: list(lines) for name, lines in told.items()}


def in_std(world: World) -> Told:
    """Run it with plain devices on worker threads, on the virtual clock."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(_in_std(world))


def steps_of(told: Told, world: World) -> dict[str, dict[int, Any]]:
    """Return what stands after each step, for each actuator.

    A step is the finest that MIN knows: what ends in STD between two steps ends in MIN in
    the second of them. What was told again is not told anew.
    """
    found: dict[str, dict[int, Any]] = {}
    for number, about in enumerate(world["actuators"]):
        safe = natural.KINDS[about["kind"]]
        lines = json.loads(json.dumps(told.get(f"m{number}", [])))
        stands = {math.ceil(ms / PERIOD_MS - 1e-6): command for ms, command in lines}
        last: Any = json.loads(json.dumps(safe))
        found[f"m{number}"] = steps = {}
        for step in range(world["steps"]):
            last = stands.get(step, last)
            steps[step] = last
    return found


def differs(one: Told, other: Told, world: World, *, exactly: bool = True) -> list[Any]:
    """Return where two runs differ."""
    found = []
    a, b = steps_of(one, world), steps_of(other, world)
    for name, steps in a.items():
        for step, command in steps.items():
            there = b[name][step]
            if command != there and (exactly or not _near(command, there)):
                found.append((name, step * PERIOD_MS, command, there))
    return found


def _near(one: Any, other: Any) -> bool:
    """Tell whether two commands are equal but for what single floats round."""
    if isinstance(one, list):
        return all(map(_near, one, other))
    return math.isclose(one, other, rel_tol=1e-5, abs_tol=1e-6)


@pytest.fixture
def worlds(request) -> tuple[int, list[World]]:
    """The seed and the worlds: some of the same, or with --esair-soak new ones."""
    seed, count = 11, 60 if request.config.getoption("--esair-long") else 15
    if request.config.getoption("--esair-soak"):
        seed, count = random.randrange(2**32), 1000
    rng = random.Random(seed)
    return seed, [make_world(rng) for _ in range(count)]


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-2", "MIN-3", "REA-4")
def test_std_decides_as_min(worlds) -> None:
    """Plain devices on worker threads get what they get in MIN, in the same step."""
    seed, many = worlds
    differ = {
        i: found[:3]
        for i, world in enumerate(many)
        if (found := differs(in_std(world), natural.play(world), world))
    }

    assert differ == {}, f"of seed {seed}"


GONE = [None] * 8


def a_hold_ends_as_somebody_sees(
    rate: float, values: list[float | None], *reactions: dict[str, Any]
) -> World:
    """The reading is back before, and the turn of the blind one is when the hold ends."""
    return {
        "steps": 32,
        "sensors": [{"rate": rate, "values": values}],
        "actuators": [
            {"kind": "number", "timeout": 0.3, "limits": ""},
            {"kind": "number", "timeout": 0.5, "limits": ""},
        ],
        "reactions": reactions,
    }


def reaction(
    kind: str, rate: float, max_age: float, *outputs: list[Any]
) -> dict[str, Any]:
    return {"kind": kind, "rate": rate, "inputs": [[0, max_age]], "outputs": outputs}


@pytest.mark.real_clock
@pytest.mark.promise("MIN-2", "MIN-3", "PRO-1")
@pytest.mark.parametrize(
    ("world", "moment"),
    [
        pytest.param(
            a_hold_ends_as_somebody_sees(
                25,
                [1.0, 1.0, None, None, None, None, *[1.0] * 14],
                reaction("Back", 10, 0.1, [0, 0, None, "safe", False]),
                reaction(
                    *("Both", 5, 0.2, [0, 3, 0.1, "safe", False]),
                    [1, 1, None, "safe", False],
                ),
            ),
            300,
            id="no sensor is asked then",
        ),
        pytest.param(
            a_hold_ends_as_somebody_sees(
                50,
                [
                    1.0,
                    *GONE,
                    1.0,
                    0.2,
                    *[1.0] * 4,
                    0.665,
                    *[1.0] * 4,
                    0.797,
                    *GONE,
                    1.0,
                ],
                reaction("Avoid", 25, 0.06, [0, 0, None, "safe", False]),
                reaction("Avoid", 10, 0.2, [0, 1, 0.1, "release", False]),
            ),
            600,
            id="the sensor is asked then",
        ),
        pytest.param(
            a_hold_ends_as_somebody_sees(
                50,
                [*[1.0] * 15, 0.6, *[1.0] * 20],  # it wants what is no number
                reaction("Wrong", 10, 0.2, [0, 0, None, "safe", False]),
                reaction(
                    *("Both", 5, 0.2, [0, 3, 0.1, "safe", False]),
                    [1, 1, None, "safe", False],
                ),
            ),
            300,
            id="somebody is blind then",
        ),
    ],
)
def test_at_the_end_of_a_hold_its_command_stands(world, moment) -> None:
    """At that very moment, whoever sees, or does not see any more, at the same one."""
    there = natural.play(world)
    stands = steps_of(there, world)["m0"]

    assert differs(in_std(world), there, world) == []
    assert stands[moment // PERIOD_MS] == stands[moment // PERIOD_MS - 1] != 0.0


def folder_with(board: Path, many: list[World]) -> Path:
    shutil.copy(natural.__file__, board / "natural.py")
    lines = [json.dumps(world) + "\n" for world in many]
    (board / "worlds.txt").write_text("".join(lines))
    return board


PLAY = """
import json, natural
with open({0!r}) as file:
    for line in file:
        print(json.dumps(natural.play(json.loads(line))))
"""


def played(printed: str) -> list[Told]:
    lines = printed.splitlines()
    return [json.loads(each) for each in lines if not each.startswith("esair: ")]


@pytest.mark.longer
@pytest.mark.real_clock
@pytest.mark.promise("MIN-1", "MIN-2")
def test_micropython_decides_as_cpython(worlds, micropython, board) -> None:
    """The same files, unchanged, to the last bit: its floats are as wide."""
    seed, many = worlds
    printed = micropython.run(
        folder_with(board, many), PLAY.format("worlds.txt"), seconds=300.0
    )
    differ = {
        i: found[:3]
        for i, (there, world) in enumerate(zip(played(printed), many, strict=True))
        if (found := differs(there, natural.play(world), world))
    }

    assert differ == {}, f"of seed {seed}"


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("MIN-1", "MIN-2")
def test_a_small_board_decides_as_cpython(worlds, board) -> None:
    """With 32-bit words and single floats: equal but for what they round."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    seed, many = worlds
    with Board(folder_with(board, many)) as small:
        printed = small.run(PLAY.format("/rom/worlds.txt"), seconds=300.0)
    differ = {
        i: found[:3]
        for i, (there, world) in enumerate(zip(played(printed), many, strict=True))
        if (found := differs(there, natural.play(world), world, exactly=False))
    }

    assert differ == {}, f"of seed {seed}"


@pytest.mark.real_clock
def test_the_robots_are_worth_it() -> None:
    """They move, lose sight, guards stop them, and rates stand beside none."""
    rng = random.Random(11)
    many = [make_world(rng) for _ in range(60)]
    moved = sum(
        len({json.dumps(command) for _, command in lines}) > 3
        for world in many
        for lines in natural.play(world).values()
    )
    lost = sum(None in each["values"] for world in many for each in world["sensors"])
    mixed = sum(len({each["rate"] for each in w["reactions"]}) > 1 for w in many)
    guarded = sum(
        each["kind"] in {"Slower", "Stops"} for w in many for each in w["reactions"]
    )

    assert moved > 30
    assert lost > 30
    assert mixed > 20
    assert guarded > 30
