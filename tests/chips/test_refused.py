"""What C cannot have is refused, with file, line and the way to write it."""

import textwrap
from pathlib import Path

import pytest
from tests.chips import robots

from esair.firmware.c._wiring import Wiring

pytestmark = pytest.mark.promise("MIN-7")

HEAD = """
import functools
import math
from collections import namedtuple
from esair.minimal import Reaction, guards, reads, writes

TABLE = [1, 2]
ROW = (1.0, 2.0, 3.0)
count = 0

class Odd(namedtuple("Odd", ("a", "b"))):
    def __new__(cls, a, b=0.0):
        return super().__new__(cls, a, b * 2)

def counts():
    global count
    count += 1

def twice(function):
    @functools.wraps(function)
    def both(*args):
        return function(*args) * 2
    return both

@twice
def half(a):
    return a / 2

def outer():
    gain = 2.0
    def inner(a):
        return a * gain
    return inner

inner = outer()

class R(Reaction):
    far = reads(float)
    motor = writes(float)
    n = 0
    level = 0.5
    names = ()
    maybe = None
    @property
    def speed(self):
        return 1.0
    @classmethod
    def of(cls, a):
        return a
"""

CASES = {
    "while far > 0:\n    far -= 1": "for _ in range(100)",
    "self.n += 1\nfor i in range(self.n):\n    pass": "for i in range(100)",
    "for i in range(3, 9, 0):\n    pass": "another step",
    "for i in range(3):\n    pass\nelse:\n    far = 1.0": "whether it broke",
    "self.n = far": "write 0.0, not 0",
    "x = 0\nx = x + far": "write 0.0, not 0",
    "return 0 if far > 1 else 0.5": "write 0.0, not 0",
    "return max(0, far)": "max(0.0, x)",
    "return far ** 2": "x * x",
    "return math.hypot(far, far)": "math.sqrt(x * x + y * y)",
    "return math.pow(far, 2)": "x * x",
    "return sum(ROW)": "for loop",
    "return round(far, 2)": "nothing like it",
    "return self.react(far)": "for loop",
    "return half(far)": "write each of them",
    "return inner(far)": "attribute of self",
    "counts()": "keep it on self",
    "global count\ncount = 1": "keep it on self",
    "return self.of(far)": "method of a class",
    "return self.speed": "call a method",
    "return self.motor": "the reading of react's parameter",
    "return self.far": "the reading of react's parameter",
    "return self.nothing": "first value",
    "return nothing": "there is no nothing",
    "self.now_ms = 3": "another name",
    "return TABLE[0]": "write a tuple",
    "return ROW[1:2][0]": "one by one",
    "return ROW[3]": "there is none",
    "self.n += 1\nreturn (far, 1)[self.n]": "row of equal types",
    "return 3000000000": "32 bits",
    "return 'fast'": "numbers",
    "return f'{far}'": "nothing like it",
    "return [far][0]": "nothing like it",
    "return sum(x for x in ROW)": "nothing like it",
    "return (lambda a: a)(far)": "no such function",
    "try:\n    far = 1 / far\nexcept ZeroDivisionError:\n    pass": "ask before",
    "with far:\n    pass": "nothing like it",
    "import math": "head of the file",
    "def f():\n    pass": "make it a method",
    "if far > 1:\n    y = 1.0\nreturn y": "give it one before",
    "return far if far is ROW else 1.0": "`is None`",
    "return (far, far) < (1.0, 2.0)": "compare their fields",
    "return far & 1": "int(...)",
    "return Odd(far, 1.0).a": "a plain one",
    "return (self, 1.0)[1]": "what is needed of it",
    "return {'motor': far, 'other': far}": "names of ports",
    "return {'a': far}['a']": "names of ports",
    "d = {}\nreturn d.get(1, 2.0)": "names of ports",
    "return (far, far)": "return that",
    "return far > 1": "return that",
    "print(far)": "count on self",
    "ROW[0] = far": "values do not change",
    "self.maybe += 1": "with None",
    "del far": "another value",
    "return far if (y := far) else 1.0": "nothing like it",
    "return self.names": "an empty tuple",
    "return min(*ROW)": "each argument",
    "return super().react(far)": "nothing like it",
    "yield far": "plain function",
    "return " + "far + " * 800 + "1.0": "in several lines",
}


def refused(tmp_path: Path, body: str, head: str = HEAD) -> tuple[int, str]:
    text = (
        head + "    def react(self, far):\n" + textwrap.indent(body, "        ") + "\n"
    )
    module = robots.imported(text, tmp_path / "user.py")
    found = []
    Wiring(
        [module.R("r")],
        [robots.Given("far", 1.0)],
        [robots.Told("motor", 0.0)],
        50,
        True,
        lambda part, error: found.append((error.file, error.line, error.reason)),
    ).program()
    ((file, line, reason),) = found
    assert file == "user.py"
    return line - (head + "    def react(self, far):\n").count("\n"), reason


@pytest.mark.parametrize("body", CASES)
def test_it_is_told_where_and_what_to_write(tmp_path, body) -> None:
    line, reason = refused(tmp_path, body)

    assert CASES[body] in reason
    lines = body.count("\n") + 1
    assert line <= lines
    assert line >= 1 or any(
        each in body
        for each in ("half", "inner", "counts", "global", "self.react", "yield")
    )


def test_the_line_is_that_of_the_word(tmp_path) -> None:
    line, reason = refused(
        tmp_path, "a = far\nb = a\nif b > 1:\n    b = b ** 2\nreturn b"
    )

    assert (line, "x * x" in reason) == (4, True)


def test_parts_are_counted_together() -> None:
    """A byte tells them apart: the fault, and the guard that is reset, were another's."""
    found = []
    Wiring(
        [],
        [robots.Given(f"s{number}", 1.0) for number in range(150)],
        [robots.Told(f"m{number}", 0.0) for number in range(150)],
        50,
        True,
        lambda _, error: found.append(error.reason),
    ).program()
    assert found == ["at most 200 parts, and 1000 steps a second"]


def test_names_differ_in_more_than_case() -> None:
    """C tells the parts apart by words in capitals; a sensor has others than a wheel."""
    found = []
    Wiring(
        [],
        [robots.Given(name, 1.0) for name in ("sonar", "Sonar", "wheel")],
        [robots.Told(name, 0.0) for name in ("sonar", "Wheel")],
        50,
        True,
        lambda _, error: found.append(error.reason),
    ).program()
    assert found == ["ROBOT_SENSOR_SONAR: two names that differ in case alone"]
