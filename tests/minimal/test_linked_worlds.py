"""A robot whose sensors and actuators are on a board, over the link, decides as one loop.

The board is a real MicroPython, or CPython, that makes its steps as the virtual clock goes
on; the line between is in memory. Some of the reactions live on the board, the others here.
"""

import asyncio
import json
import random
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.minimal import linked_board, natural
from tests.minimal.conftest import MicroPython
from tests.minimal.test_natural import differs, steps_of

import esair
from esair.boards import line, link
from esair.boards.link import PRIORITY
from esair.buses.serial import FakeSerial
from esair.drivers.board import Board, BoardActuator, BoardSensor
from esair.testing import VirtualLoop

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-2", "MIN-4")]

World = dict[str, Any]
PHASE = 400
"""Steps that the readings stay: a sensor that was lost is back here after less."""


def make_world(rng: random.Random) -> World:
    """Draw a robot, and what its sensors see: the same for a while, or nothing."""
    rates = [rng.choice([50, 50, 25, 10]) for _ in range(rng.randint(1, 3))]
    phases = rng.randint(2, 3)
    sensors = []
    for rate in rates:
        values: list[float | None] = []
        for phase in range(phases):
            gone = phase and rng.random() < 0.2
            value = None if gone else round(rng.uniform(0.2, 2.0), 3)
            values += [value] * (PHASE * rate // natural.RATE)
        sensors.append({"rate": rate, "values": values})
    actuators = [
        {
            "kind": rng.choice(["number", "pair", "count"]),
            "timeout": rng.choice([0.3, 0.5]),
            "limits": rng.choice(["", "refuse", "clamp"]),
        }
        for _ in range(rng.randint(1, 3))
    ]
    for each in actuators:
        if each["kind"] != "number":
            each["limits"] = ""
    world = {"steps": phases * PHASE, "sensors": sensors, "actuators": actuators}
    here = [make_reaction(rng, world, n, host=True) for n in range(rng.randint(1, 3))]
    there = [make_reaction(rng, world, n, host=False) for n in range(rng.randint(0, 3))]
    world["reactions"] = there + here
    return world


def make_reaction(
    rng: random.Random, world: World, number: int, *, host: bool
) -> World:
    many, moved = len(world["sensors"]), len(world["actuators"])
    able = ["Follow", "Avoid"] + ["Fuse", "Maybe"] * (many > 1)
    if moved > 1 and world["actuators"][1]["kind"] != "count":
        able += ["Both"]
    if not host:
        able += ["Sum", "Back", "Wrong", "Slower", "Stops"]
    kind = rng.choice(able)
    seen = rng.sample(range(many), 2 if kind in {"Fuse", "Maybe"} else 1)
    outputs = [0, 1] if kind == "Both" else [rng.randrange(moved)]
    priority = PRIORITY - number if host else number
    return {
        "kind": kind,
        "host": host,
        "rate": rng.choice([None, 25, 10]),
        "inputs": [[each, 0.5] for each in seen],
        "outputs": [[each, priority, None, "safe", False] for each in outputs],
    }


class Remote:
    """A board in another process: a MicroPython."""

    def __init__(self, process: subprocess.Popen[str], world: World) -> None:
        self._process = process
        self._say(json.dumps(world))

    def _say(self, text: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(text + "\n")
        self._process.stdin.flush()

    def _hear(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def step(self, data: bytes) -> bytes:
        self._say(":" + data.hex())
        return bytes.fromhex(self._hear()[1:])

    def end(self) -> Any:
        self._say("end")
        return json.loads(self._hear())


async def over_the_link(world: World, board: Any) -> Any:
    """Play a world with a board; return what its actuators were told there."""
    come, steps = bytearray(), 0
    over = asyncio.Event()

    def step() -> bytes:
        nonlocal steps
        steps += 1
        if steps > world["steps"]:
            over.set()
        data = bytes(come)
        come.clear()
        said: bytes = board.step(data)
        return said

    bus = FakeSerial("base", framing="cobs")
    bus.on_write = come.extend  # type: ignore[assignment]
    bus.repeat(step, 1 / natural.RATE)
    reactions, _, _ = natural.make_parts(world, None)
    both = zip(reactions, world["reactions"], strict=True)
    here = [(each, about) for each, about in both if about["host"]]
    seen = sorted({number for _, about in here for number, _ in about["inputs"]})
    moved = sorted({each[0] for _, about in here for each in about["outputs"]})
    kinds = [natural.KINDS[each["kind"]] for each in world["actuators"]]
    resources: list[Any] = [Board(name="base", bus=bus)]
    resources += [BoardSensor(name=f"s{number}", bus=bus) for number in seen]
    resources += [BoardActuator(name=f"m{n}", bus=bus, safe=kinds[n]) for n in moved]
    behaviors = [each for each, _ in here]
    async with esair.Robot(resources=resources, behaviors=behaviors):
        await over.wait()
        return board.end()


def differ(world: World, board: Any) -> list[Any]:
    """Return where a board over the link and one loop differ.

    What nobody here moves is the same at each step; else what stands at the end of each
    phase, when all that was on its way is there.
    """
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        told = runner.run(over_the_link(world, board))
    alone = natural.play(world)
    moved = {f"m{e[0]}" for r in world["reactions"] if r["host"] for e in r["outputs"]}
    own = {name for name in steps_of(alone, world) if name not in moved}
    found = [each for each in differs(told, alone, world) if each[0] in own]
    there, here = steps_of(told, world), steps_of(alone, world)
    ends = range(PHASE - 1, world["steps"], PHASE)
    both = [(n, end, there[n][end], here[n][end]) for n in moved for end in ends]
    found += [each for each in both if each[2] != each[3]]
    return found


def worlds_of(request: Any, plain: int) -> tuple[int, list[World]]:
    seed, count = 5, 40 if request.config.getoption("--esair-long") else plain
    if request.config.getoption("--esair-soak"):
        seed, count = random.randrange(2**32), 1000
    rng = random.Random(seed)
    return seed, [make_world(rng) for _ in range(count)]


@pytest.fixture
def remote(micropython: MicroPython, board: Path) -> Iterator[Any]:
    """Makes boards of worlds, one after the other, in one MicroPython."""
    (board / "esair" / "boards").mkdir()
    for module in (link, line):
        shutil.copy(str(module.__file__), board / "esair" / "boards")
    start = Path(link.__file__).with_name("start.py")
    shutil.copy(start, board / "esair" / "boards")
    for module in (natural, linked_board):
        shutil.copy(str(module.__file__), board)
    serve = "import linked_board; linked_board.serve()"
    with subprocess.Popen(
        [micropython.program, "-X", "heapsize=64m", "-c", serve],
        cwd=board,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield lambda world: Remote(process, world)
        assert process.stdin is not None
        process.stdin.close()


@pytest.mark.long
def test_a_linked_board_decides_as_one_loop(request, remote) -> None:
    """A real MicroPython; what lives on it at each step, the rest when it is there."""
    seed, many = worlds_of(request, 2)
    found = {
        number: each[:3]
        for number, world in enumerate(many)
        if (each := differ(world, remote(world)))
    }
    assert found == {}, f"of seed {seed}"


@pytest.mark.long
def test_so_it_does_on_cpython(request) -> None:
    """The same worlds, with the very files of the board in this process."""
    seed, many = worlds_of(request, 0)
    found = {
        number: each[:3]
        for number, world in enumerate(many)
        if (each := differ(world, linked_board.Linked(world)))
    }
    assert found == {}, f"of seed {seed}"


@pytest.mark.parametrize("rates", [[25.0] * 6, [50.0] * 8], ids=["six", "eight"])
def test_no_actuator_of_a_line_waits_for_the_others(rates: list[float]) -> None:
    """What is written to each goes on without a gap, and no beat is missed."""
    writers = [
        {"kind": "Follow", "host": True, "rate": rate, "inputs": [[0, 0.5]]}
        | {"outputs": [[number, PRIORITY, None, "safe", False]]}
        for number, rate in enumerate(rates)
    ]
    world = {
        "steps": 150,
        "sensors": [{"rate": 50, "values": [1.0]}],
        "actuators": [{"kind": "pair", "timeout": 0.2, "limits": ""} for _ in rates],
        "reactions": writers,
    }
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        told = runner.run(over_the_link(world, linked_board.Linked(world)))

    assert len(told) == len(rates)
    for lines in told.values():
        moved = [command for now, command in lines if 1000 < now < 3000]
        assert set(moved) == {(0.3, -0.15)}
        assert len(moved) >= 95


def test_the_linked_worlds_are_worth_it() -> None:
    """Both sides move, guards are there, and sensors are lost."""
    rng = random.Random(5)
    many = [make_world(rng) for _ in range(20)]
    moved = sum(
        len({str(command) for _, command in lines}) > 2
        for world in many
        for lines in natural.play(world).values()
    )
    kinds = [each["kind"] for world in many for each in world["reactions"]]

    assert moved > 10
    assert kinds.count("Slower") + kinds.count("Stops") > 3
    assert sum(None in each["values"] for w in many for each in w["sensors"]) > 5
