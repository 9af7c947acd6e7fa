"""Words of Python that C has otherwise: what a reaction says of them is the same."""

# ruff: noqa: E501 - a case is a line

import textwrap
from typing import Any

import pytest
from tests.chips import robots, written

pytestmark = [pytest.mark.promise("MIN-7"), pytest.mark.real_clock]

HEAD = """
import math
from collections import namedtuple
from esair.minimal import Reaction, guards, reads, writes

class Pose(namedtuple("Pose", ("register", "PI"))):
    def long(self, double=2.0):
        return self.register * double + self.PI

es_add = 2

def i32(value):
    if not -2147483648 <= value <= 2147483647:
        raise OverflowError
    return value
R = 1.5
"""

REACTION = """
class R{number}(Reaction):
    x = reads(float)
    k = reads(int)
    out = writes(float, name="out{number}")
    count = writes(int, name="count{number}")
    int = 0.5
    auto = 3
    maybe = None
    log = 0

    def put(self, digit):
        self.log = i32(i32(self.log * 10) + digit)
        return digit

    place = 0
    def react(self, k, x):
"""

NUMBERS = [0.0, -0.0, 1.0, -1.0, 0.5, 1.5, 2.5, -2.5, 1e308, -7.3, 3e-320, 2147483646.5]
WHOLE = [0, 1, -1, 7, -7, 3, 31, 32, 2**31 - 1, -(2**31), 1000]

CASES = {
    "floor division and modulo": "return {'out': x // -0.3 + x % -0.7, 'count': (7 // (k or 2)) + k % -5}",
    "modulo of integers": "return {'count': k % 7 * 100 + k // 7 % 10}",
    "division by what is zero": "return {'out': 1 / x, 'count': k}",
    "division of integers": "return {'out': 7 / k}",
    "a default that nobody takes": "return {'count': {True: 1, False: 2}.get(k > 1, 7 // k)}",
    "minus zero": "return {'out': -x * 0.0, 'count': int(math.copysign(1.0, x))}",
    "halves to even": "return {'count': i32(round(x))}",
    "towards zero": "return {'count': i32(int(x))}",
    "floor and ceil": "return {'count': i32(i32(math.floor(x)) + i32(math.ceil(x)))}",
    "shifts": "return {'count': i32(i32(1 << (k & 63)) + (k >> (k & 63)))}",
    "a wide shift of nothing": "return {'count': i32((k & 0) << 1000)}",
    "bits": "return {'count': (k & 255) ^ (~k | 12)}",
    "overflow": "return {'count': i32(k + 1)}",
    "product": "return {'count': i32(k * 65536)}",
    "minus": "return {'count': i32(-k)}",
    "the order of a sum": "a = self.log + self.put(1) * self.put(2)\nreturn {'count': a + self.log}",
    "the order of arguments": "a = max(self.put(3), self.log, self.put(4))\nreturn {'count': self.log % 1000 + a}",
    "the order of a display": "a = (self.log, self.put(1), self.log)\nself.log = 0\nreturn {'count': a[2] - a[0]}",
    "a chain": "a = 1 if 0 < self.put(2) <= self.put(1) < self.put(5) else 2\n"
    "b, self.log = self.log, 0\nreturn {'count': b * 10 + a}",
    "not more than needed": "a = x > 0 and self.put(1) > 3 or self.put(2) == 2\n"
    "b, self.log = self.log, 0\nreturn {'count': b + a}",
    "values of or": "a = x or self.int\nb = k and self.put(7)\nself.log = 0\nreturn {'out': a, 'count': b}",
    "swap": "a, b = x, self.int\na, b = b, a\nreturn {'out': a - b}",
    "a tuple stays": "a = (x, 1.0)\nb = a\na = (2.0, 3.0)\nself.place = 1\nreturn {'out': b[0]}",
    "a loop goes on over what it was": "row = (x, 2.0)\ns = 0.0\nfor each in row:\n    s = s * 2 + each\n"
    "    row = (5.0, 7.0)\nreturn {'out': s}",
    "a name that was asked for": "y = None\nif x > 0:\n    y = x\nif y is not None and k > 0:\n    z = y\n"
    "    y = None\nelse:\n    z = 3.0\nreturn {'out': z, 'count': 1 if y is None else 2}",
    "words of C": "register = x\nint = register + self.int\nauto = self.auto\nt1 = 2\nfloat = int\n"
    "return {'out': float * t1 * es_add + R, 'count': auto}",
    "a name of C, and one with _": "int = k\nint_ = 2\nreturn {'count': i32(i32(int * 3) + int_)}",
    "names of fields": "return {'out': Pose(x, 2.0).long() + Pose(1.0, PI=x).PI}",
    "a loop and its name": "n = 0\nfor i in range(7, -4, -3):\n    i = i * 2\n    n += i\n"
    "    if n > 20:\n        break\nreturn {'count': n}",
    "a row of constants": "s = 0.0\nfor i, each in enumerate((x, 2.0, -x)):\n    if each < 0:\n"
    "        continue\n    s = s + each * i\nreturn {'out': s}",
    "none at first": "self.maybe = x if self.maybe is None else None\n"
    "return {'out': self.maybe, 'count': 1 if self.maybe is None else 2}",
    "none in a calculation": "self.maybe = None if x < 0 else x\nreturn {'out': self.maybe + 1.0}",
    "raise": "if x < 0:\n    raise ValueError('x')\nreturn {'out': x}",
    "assert": "assert x >= 0, 'x'\nreturn {'out': x}",
    "state before a fault stays": "self.auto += 1\nself.int = 1 / x\nself.auto += 1\nreturn {'count': self.auto}",
    "not a number": "a = math.inf - math.inf\nreturn {'count': 1 if a != a else 2, 'out': min(x, a)}",
    "least and greatest": "a = max(x, -0.0, 0.0)\nreturn {'out': min((a, x, 3.0)), 'count': min(k, 3, i32(-k))}",
    "functions of mathematics": "return {'out': math.sqrt(x) + math.atan2(x, -0.0) + math.degrees(x)}",
    "exp over the end": "return {'out': math.exp(x)}",
    "log of nothing": "return {'out': math.log(x)}",
    "a table": "return {'out': {(True, False): 1.5, (False, True): -1.5}.get((x > 1, k > 3), 0.25)}",
    "one of": "return {'count': 1 if k in (1, 31, 7.0) else 2}",
    "truth as a number": "return {'count': (x > 0) + (k > 0) * 2 + abs(x > 1)}",
    "nothing at all": "return None",
    "no word": "pass",
}


JOURNAL: list[Any] = [
    ([x, k], [True] * 2 * len(CASES)) for x in NUMBERS for k in (3, -7)
]
JOURNAL += [([0.5, k], [True] * 2 * len(CASES)) for k in WHOLE]


@pytest.fixture(scope="module")
def said(tmp_path_factory) -> tuple[list[Any], list[Any]]:
    """What MIN and C say, with all of the cases in one robot."""
    folder = tmp_path_factory.mktemp("said")
    text = HEAD + "".join(
        REACTION.format(number=number) + textwrap.indent(body, " " * 8) + "\n"
        for number, body in enumerate(CASES.values())
    )

    def wired(name: str, text: str) -> robots.Robot:
        module = robots.imported(text, folder / f"{name}.py")
        numbers = range(len(CASES))
        return robots.Robot(
            [getattr(module, f"R{n}")(f"r{n}") for n in numbers],
            [robots.Given("x", 0.5), robots.Given("k", 1)],
            [robots.Told(f"out{n}", 0.0) for n in numbers]
            + [robots.Told(f"count{n}", 0) for n in numbers],
        )

    robot = wired("user", written.plain(text))
    program = robots.in_c(robot, folder)
    checked = wired("checked", text)
    return robots.run_min(checked, JOURNAL), robots.run_c(robot, program, JOURNAL)


@pytest.mark.long
@pytest.mark.parametrize("number", range(len(CASES)), ids=list(CASES))
def test_it_means_the_same(said, number) -> None:
    """To the bit, at its step, and safe where MIN has a fault or 32 bits do not hold it."""
    expected, there = (
        [
            each
            for each in told
            if each[0] in {f"out{number}", f"count{number}"} or len(each) == 3
        ]
        for told in said
    )
    assert len(expected) > len(JOURNAL)
    assert there == expected  # with the faults of each step


AGES = """
from esair.minimal import Reaction, writes

class R0(Reaction):
    rate = 1
    out = writes(float)
    count = writes(int)
    n = 0
    def react(self):
        self.n = self.n + 1 if self.elapsed_ms == 1000 else 0
        return {"count": self.n}

class R1(Reaction):
    rate = 1
    out = writes(float)
    def react(self):
        return float(self.now_ms % 8000)
"""


def test_time_never_grows(tmp_path) -> None:
    """12 days are nothing; from 2**31 ms on who asks for them is blind, and is counted."""
    module = robots.imported(AGES, tmp_path / "ages.py")
    actuators = [robots.Told("out", 0.0, 3.0), robots.Told("count", 0, 3.0)]
    robot = robots.Robot([module.R0("a"), module.R1("b")], [], actuators, rate=1)
    robot.reactions[0].rate = robot.reactions[1].rate = 1
    program = robots.in_c(robot, tmp_path)
    steps: list[Any] = [([], [True, True])] * 4
    young = [*steps, "k 1000000", *steps, "k 1000000", *steps]
    old = ["k 147480", *steps, "k 1000000", *steps]
    told = robots.run_c(robot, program, [*young, *old])
    faults = [each[1] for each in told if len(each) == 3]
    expected = robots.run_min(robot, young)

    assert faults == [0] * 12 + [1, 2, 3, 4, 5, 6, 7, 8]
    assert told[: len(expected) - 2] == expected[:-2]
    assert ("count", [3]) in told[-8:]


GAP = """
from esair.minimal import Reaction, reads, writes

class Seen(Reaction):
    eye = reads(float)
    out = writes(float)
    def react(self, eye):
        return eye if self.elapsed_ms > 1000 * 3600 * 24 * 6 else -eye
"""


@pytest.mark.parametrize("days", [1, 7, 13, 100])
def test_who_sees_again_after_days_steps_at_once(tmp_path, days) -> None:
    """However long it was blind: it is told of a long time, and that is no fault."""
    module = robots.imported(GAP, tmp_path / "gap.py")
    eye, out = robots.Given("eye", 1.0), robots.Told("out", 0.0)
    robot = robots.Robot([module.Seen("seen")], [eye], [out], rate=1)
    program = robots.in_c(robot, tmp_path)
    seen: Any = ([0.5], [True])
    journal = [seen, seen, f"k {days * 86400}", seen, seen]

    told, expected = (
        robots.run_c(robot, program, journal),
        robots.run_min(robot, journal),
    )
    assert told == expected
    commands = [each[1] for each in told if each[0] == "out"]
    late = 0.5 if days > 6 else -0.5
    moved = [each for each in commands if each != robots.flat(0.0, 0.0)]
    assert moved == [robots.flat(each, 0.0) for each in (-0.5, -0.5, late, -0.5)]
    assert [each[1] for each in told if len(each) == 3] == [0] * 4  # no fault
