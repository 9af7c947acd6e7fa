"""A robot in C decides as in MIN: to the bit in double, but for rounding in float."""

import math
import random
import shutil
import struct
from pathlib import Path
from typing import Any

import pytest
from tests.chips import avr, reflexes, robots, written
from tests.minimal import natural
from tests.minimal.test_natural import make_world

from esair.minimal import guards, reads, writes

pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.promise("MIN-7"),
    pytest.mark.skipif(not shutil.which("gcc"), reason="needs gcc"),
]


def random_robot(module: Any, seed: int) -> robots.Robot:
    """Wire the reactions of a module; the same each time for a seed."""
    rng = random.Random(seed)
    examples = {**written.SENSORS, "feel": module.Touch(False, 0, 0.0)}
    kinds = {**written.KINDS, "twist": module.Twist(0.0, 0.0)}
    sensors = [
        robots.Given(name, example, rng.choice([None, 50, 25, 10, 30]))
        for name, example in examples.items()
    ]
    actuators = []
    for name, safe in kinds.items():
        made = robots.Told(name, safe, rng.choice([0.1, 0.2, 0.3]))
        limits = rng.choice(["", "refuse", "clamp"])
        if name in {"number", "amount"} and limits:
            made.limits = rng.choice([(-0.8, 0.8), (-2.5, 3), (0, 10)])
            made.clamp = limits == "clamp"
        elif name == "twist" and limits:
            made.limits = {"angular": (-1, 1.5)}
        actuators.append(made)
    names = sorted(key for key in vars(module) if key[:1] == "R" and key[1:].isdigit())
    reactions = [getattr(module, key)(key.lower()) for key in names]
    return robots.Robot(reactions, sensors, actuators, rng.choice([50, 50, 30, 100]))


def random_journal(rng: random.Random, module: Any, steps: int) -> list[Any]:
    """Draw readings, lost ones, actuators that do not take, late steps, arming."""
    journal: list[Any] = []
    for _ in range(steps):
        chance = rng.random()
        if chance < 0.04:
            journal.append(
                rng.choice([f"k {rng.randint(1, 9)}", f"a {rng.randint(0, 1)}"])
            )
        readings = [written.value(rng, name, module) for name in written.SENSORS]
        journal.append((readings, [rng.random() > 0.03 for _ in written.KINDS]))
    return journal


def differing(seeds: range, worlds: int, folder: Path, *flags: str) -> dict[Any, Any]:
    """Play random robots in MIN and in C; return where they differ first."""
    found = {}
    told = 0
    for seed in seeds:
        rng = random.Random(seed)
        text = written.robot(rng)
        user = robots.imported(written.plain(text), folder / f"user{seed}.py")
        checked = robots.imported(text, folder / f"checked{seed}.py")
        program = robots.in_c(random_robot(user, seed), folder / f"c{seed}", *flags)
        for world in range(worlds):
            robot = random_robot(checked, seed)
            journal = random_journal(rng, checked, 60)
            one = robots.run_min(robot, journal)
            other = robots.run_c(robot, program, journal)
            told += sum(len(each) == 2 for each in one)
            if one != other:
                at = next(
                    (
                        n
                        for n, (a, b) in enumerate(zip(one, other, strict=False))
                        if a != b
                    ),
                    min(len(one), len(other)),
                )
                found[seed, world] = one[at : at + 1], other[at : at + 1]
                break
    assert told > 3 * len(seeds) * worlds, "they hardly move"
    return found


@pytest.mark.long
def test_written_at_random_to_the_bit(tmp_path, request) -> None:
    """Whatever is said with what can be translated; also each fault, at its step."""
    seed = random.randrange(2**31) if request.config.getoption("--esair-soak") else 20
    many = 6 if request.config.getoption("--esair-long") else 2
    assert differing(range(seed, seed + many), 8, tmp_path) == {}


@pytest.mark.long
def test_what_equals_safe_and_passes_who_is_blind_is_safe_itself(tmp_path) -> None:
    """A zero with the other sign, wanted while a higher one is blind, goes as 0.0."""
    assert differing(range(10_319, 10_320), 2, tmp_path) == {}


@pytest.mark.long
def test_nothing_undefined(tmp_path, request) -> None:
    """No overflow, no wild shift, no step over the end of a row."""
    many = 6 if request.config.getoption("--esair-long") else 1
    seeds = range(301, 301 + many)
    assert differing(seeds, 8, tmp_path, *robots.SANITIZED) == {}


@pytest.mark.soak
@pytest.mark.parametrize("part", range(8))
def test_ten_thousand_worlds(tmp_path, part) -> None:
    first = 10_000 + 50 * part
    assert differing(range(first, first + 50), 25, tmp_path, "-O2") == {}


def natural_robot(world: dict[str, Any]) -> tuple[robots.Robot, list[Any]]:
    """Wire a natural world, with the reactions that C knows; return its journal, too."""
    kinds = [each["kind"] for each in world["actuators"]]
    reactions = []
    for number, about in enumerate(world["reactions"]):
        cls = getattr(reflexes, about["kind"])
        moved = [kinds[each[0]] for each in about["outputs"]]
        bases = [cls, reflexes.KINDS[moved[0]]]
        bases += [reflexes.SECOND[kind] for kind in moved[1:]]
        attributes: dict[str, Any] = {"rate": about["rate"]}
        for key, (sensor, age) in zip("ab", about["inputs"], strict=False):
            optional = about["kind"] == "Maybe" and key == "b"
            attributes[key] = reads(
                float, name=f"s{sensor}", max_age=age, optional=optional
            )
        for key, (actuator, priority, hold, blind, latch) in zip(
            "xy", about["outputs"], strict=False
        ):
            name = f"m{actuator}"
            if about["kind"] in {"Slower", "Stops"}:
                attributes[key] = guards(
                    None, name=name, priority=priority, latch=latch
                )
            else:
                attributes[key] = writes(
                    None, name=name, priority=priority, hold=hold, blind=blind
                )
        reactions.append(type("Some", tuple(bases), attributes)(f"r{number}"))
    sensors = [
        robots.Given(f"s{number}", 1.0, each["rate"])
        for number, each in enumerate(world["sensors"])
    ]
    actuators = []
    for number, each in enumerate(world["actuators"]):
        made = robots.Told(f"m{number}", natural.KINDS[each["kind"]], each["timeout"])
        if each["limits"]:
            made.limits, made.clamp = (-0.8, 0.8), each["limits"] == "clamp"
        actuators.append(made)
    journal = []
    for step in range(world["steps"]):
        line = []
        for sensor in world["sensors"]:
            values = sensor["values"]
            line.append(values[min(step * sensor["rate"] // 50, len(values) - 1)])
        journal.append((line, [True] * len(actuators)))
    return robots.Robot(reactions, sensors, actuators), journal


LATCHES = """
from esair.minimal import Reaction, guards, reads, writes

class Latches(Reaction):
    s0 = reads(float, max_age=9.0)
    m0 = guards(float, latch=True)

    def react(self, s0, m0):
        return m0 if s0 > 0.5 else None

class Stops(Latches):
    m0 = guards(float, priority=5)

class Go(Reaction):
    rate = 50.0
    m0 = writes(float)

    def react(self):
        return 0.5
"""


def test_a_guard_that_refuses_keeps_no_latch_open(tmp_path) -> None:
    """When both let it pass again nothing moves, as in MIN and in STD."""
    module = robots.imported(LATCHES, tmp_path / "latches.py")
    robot = robots.Robot(
        [module.Latches(), module.Stops(), module.Go()],
        [robots.Given("s0", 1.0)],
        [robots.Told("m0", 0.0, 1.0)],
    )
    journal = [([value], [True]) for value in (1.0, 0.0, 1.0, 1.0)]
    program = robots.in_c(robot, tmp_path)
    told = robots.run_c(robot, program, journal)
    assert told == robots.run_min(robot, journal)
    assert sum(len(each) == 2 for each in told) == 4  # safe, 0.5, safe, and at the end


FEW = """
from esair.minimal import Reaction, reads, writes

class Go(Reaction):
    s0 = reads(float, max_age=9.0)
    m0 = writes(float)

    def react(self, s0):
        return self.b_c(s0)

    def b_c(self, s0):
        return s0

class Stop(Reaction):
    rate = 10.0
    m0 = writes(float, priority=1)

    def react(self):
        return self.c()

    def c(self):
        return 0.0
"""


@pytest.mark.parametrize("sensors", [0, 1])
@pytest.mark.parametrize("actuators", [0, 1])
def test_a_robot_may_have_next_to_nothing(tmp_path, sensors, actuators) -> None:
    """No reaction, no sensor, no actuator: what is left is translated without a warning."""
    robot = robots.Robot(
        [],
        [robots.Given("s0", 1.0)] * sensors,
        [robots.Told("m0", 0.0)] * actuators,
    )
    journal: list[Any] = [([0.5] * sensors, [True] * actuators)] * 2
    told = robots.run_c(robot, robots.in_c(robot, tmp_path), journal)
    assert told == robots.run_min(robot, journal)


def test_functions_of_two_reactions_have_two_names(tmp_path) -> None:
    """``b_c`` of a reaction ``a``, and ``c`` of another that is called ``a_b``."""
    module = robots.imported(FEW, tmp_path / "few.py")
    robot = robots.Robot(
        [module.Go("a"), module.Stop("a_b")],
        [robots.Given("s0", 1.0)],
        [robots.Told("m0", 0.0)],
    )
    journal = [([0.5], [True])] * 3
    told = robots.run_c(robot, robots.in_c(robot, tmp_path), journal)
    assert told == robots.run_min(robot, journal)


SCANS = """
from collections import namedtuple
from esair.minimal import Reaction, reads, writes

Scan = namedtuple("Scan", ("first", "ranges"))

class Near(Reaction):
    s0 = reads(Scan, max_age=0.01)
    m0 = writes(float)

    def react(self, s0):
        return s0.first + min(1.0, s0.ranges[0])
"""


def test_a_row_in_a_reading_is_looked_at_too(tmp_path) -> None:
    """NaN is none anywhere; infinity is nothing in reach, but only in a row."""
    module = robots.imported(SCANS, tmp_path / "scans.py")
    scan, nan, inf = module.Scan, math.nan, math.inf
    robot = robots.Robot(
        [module.Near()],
        [robots.Given("s0", scan(0.5, (1.0, 1.0)))],
        [robots.Told("m0", 0.0, 1.0)],
    )
    bad = [(0.5, (nan, 1.0)), (0.5, (1.0, nan)), (inf, (1.0, 1.0))]
    readings = [scan(*each) for each in [*bad, (0.5, (0.25, inf)), *bad]]
    journal = [([each], [True]) for each in readings]
    told = robots.run_c(robot, robots.in_c(robot, tmp_path), journal)
    assert told == robots.run_min(robot, journal)
    assert [each[1] for each in told if len(each) == 3] == [1, 2, 3, 3, 4, 5, 6]


LENT = """
from collections import namedtuple
from esair.minimal import Reaction, reads, writes

Scan = namedtuple("Scan", ("first", "ranges"))

def least(scan):
    return min(scan.ranges[0], scan.ranges[1]) + scan.first

class Keeps(Reaction):
    s0 = reads(Scan, max_age=0.01)
    m0 = writes(float)
    kept = Scan(0.25, (0.5, 0.5))

    def react(self, s0):
        found = self.swapped(self.kept, s0) + least(self.kept)
        if s0.first > 0.0:
            s0 = self.turned(s0)
        return found + least(s0 if found < 2.0 else self.turned(self.turned(s0)))

    def swapped(self, before, now):
        self.kept = now
        return least(before) + 4.0 * least(now)

    def turned(self, scan):
        scan = Scan(-scan.first, (scan.ranges[1], scan.ranges[0] * 0.5))
        return scan
"""


def test_what_a_function_is_given_stays_as_it_was(tmp_path) -> None:
    """A large tuple is not copied, but where it may become another one meanwhile."""
    module = robots.imported(LENT, tmp_path / "lent.py")
    scan = module.Scan
    robot = robots.Robot(
        [module.Keeps()],
        [robots.Given("s0", scan(0.5, (1.0, 1.0)))],
        [robots.Told("m0", 0.0, 1.0)],
    )
    readings = [scan(0.5, (1.0, 2.0)), scan(-0.25, (0.125, 4.0)), scan(1.0, (0.5, 8.0))]
    journal = [([each], [True]) for each in readings]
    program = robots.in_c(robot, tmp_path, *robots.SANITIZED)
    source = (tmp_path / "robot" / "robot.c").read_text()
    assert "const Robot_Scan *" in source
    assert robots.run_c(robot, program, journal) == robots.run_min(robot, journal)


def near(one: Any, other: Any) -> bool:
    """Tell whether two runs are the same but for what single floats round."""
    if len(one) != len(other):
        return False
    for a, b in zip(one, other, strict=True):
        if len(a) != 2 or len(b) != 2:
            if a != b:
                return False
            continue
        for x, y in zip(a[1], b[1], strict=True):
            if isinstance(x, bytes):
                p, q = struct.unpack("d", x)[0], struct.unpack("d", y)[0]
                if abs(p - q) > 1e-6 + 1e-5 * abs(p):
                    return False
            elif x != y:
                return False
    return True


@pytest.mark.longer
def test_natural_wiring(tmp_path, request) -> None:
    """Rates beside none, guards, holds, several actuators: to the bit, and in float."""
    seed = random.randrange(2**31) if request.config.getoption("--esair-soak") else 3
    rng = random.Random(seed)
    for number in range(12 if request.config.getoption("--esair-long") else 2):
        robot, journal = natural_robot(make_world(rng))
        double = robots.in_c(robot, tmp_path / f"d{number}")
        single = robots.in_c(robot, tmp_path / f"f{number}", "-DROBOT_FLOAT")
        expected = robots.run_min(
            robot, journal
        )  # after that the reactions know something
        assert robots.run_c(robot, double, journal) == expected, (seed, number)
        assert near(expected, robots.run_c(robot, single, journal)), (seed, number)


@pytest.mark.skipif(avr.why_not() is not None, reason=str(avr.why_not()))
@pytest.mark.parametrize(
    "count",
    [
        2,
        pytest.param(20, marks=pytest.mark.long),
        pytest.param(300, marks=pytest.mark.soak),
    ],
)
def test_on_an_atmega328p(tmp_path, count) -> None:
    """The same worlds on the simulated chip, but for what single floats round."""
    rng = random.Random(7)
    for number in range(count):
        robot, journal = natural_robot(make_world(rng))
        there = avr.run(robot, journal, tmp_path / str(number))
        expected = robots.run_min(robot, journal)
        assert near(expected, there), number
