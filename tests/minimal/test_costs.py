"""What MIN costs on a 32-bit board: instructions and bytes, the same on any machine."""

import json

import pytest
from tests.minimal.hw.board import Board, why_not

pytestmark = [pytest.mark.long, pytest.mark.real_clock, pytest.mark.promise("MIN-1")]

MEASURE = """
import gc, json, time
from esair.minimal import Actuator, Loop, Reaction, Sensor, reads, writes

class A(Sensor):
    def read(self):
        return 5

class B(A):
    pass

class M(Actuator):
    safe = 0.0
    def write(self, command):
        pass

class P(M):
    safe = (0.0, 0.0)

class Go(Reaction):
    a = reads(int)
    m = writes(float)
    def react(self, a):
        return 0.5

class Two(Go):
    b = reads(int)
    def react(self, a, b):
        return 0.5

class Pair(Go):
    m = writes(tuple, name="p")
    def react(self, a):
        return (0.5, a)

class Higher(Go):
    m = writes(float, priority=2)

class Highest(Go):
    m = writes(float, priority=3)

def nothing(count):
    for _ in range(count):
        pass

def calls(count):
    a, go, m = A(), Go(), M()
    for _ in range(count):
        m.write(go.react(a.read()))

def cost(function):
    function(10)
    gc.collect()
    before = gc.mem_alloc()
    begin = time.ticks_us()
    function(1000)
    took = time.ticks_diff(time.ticks_us(), begin)
    return took, (gc.mem_alloc() - before) / 1000

empty = cost(nothing)[0]
three = cost(calls)[0] - empty
found = {}
for name, reactions, sensors, actuators in (
    ("number", [Go()], [A()], [M()]),
    ("two sensors", [Two()], [A(), B()], [M()]),
    ("fresh tuple", [Pair()], [A()], [P()]),
    ("three reactions", [Go(), Higher(), Highest()], [A()], [M()]),
):
    loop = Loop(reactions, sensors, actuators, rate=50)
    def steps(count):
        step = loop.step
        for _ in range(count):
            step()
    took, size = cost(steps)
    found[name] = [round((took - empty) / three, 2), size]

def is_enough(size):
    "Whether four reactions can be wired where so many bytes are free."
    parts = [Go(), Two(), Higher(), Highest()], [A(), B()], [M()]
    gc.collect()
    free, rest = bytearray(size), None
    for each in (4000, 400, 64, 16):
        try:
            while True:
                rest = rest, bytearray(each)
        except MemoryError:
            pass
    free = None
    try:
        Loop(*parts)
        return True
    except MemoryError:
        return False

loop = None
least, most = 0, 20000
while most - least > 16:
    size = (least + most) // 2
    if is_enough(size):
        most = size
    else:
        least = size
found["wiring"] = most
print(json.dumps(found))
"""

COSTS = {
    "number": (4.5, 0),
    "two sensors": (6.2, 0),
    "fresh tuple": (10.5, 16),
    "three reactions": (9.0, 0),
}
"""At most so many times three calls, `write(react(read()))`, and bytes, for one step."""


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, list[float]]:
    """What was measured."""
    import shutil

    from esair import minimal

    reason = why_not()
    if reason:
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("board")
    (folder / "esair").mkdir()
    shutil.copy(minimal.__file__, folder / "esair" / "minimal.py")
    with Board(folder, exact=True) as board:
        costs: dict[str, list[float]] = json.loads(board.run(MEASURE))
    return costs


@pytest.mark.parametrize("step", COSTS)
def test_a_step_costs_little(found, step) -> None:
    """In instructions, and no memory but that of a fresh command itself."""
    times, size = found[step]

    assert times <= COSTS[step][0]
    assert size < COSTS[step][1] + 0.5  # the clock's own number, once


def test_wiring_takes_little_memory(found) -> None:
    """Four reactions, two sensors and an actuator: the least free heap that is enough."""
    assert found["wiring"] <= 2600
