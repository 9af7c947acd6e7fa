"""What MIN costs on a 32-bit board: instructions and bytes, the same on any machine."""

import json
import shutil
import struct
from pathlib import Path

import pytest
from tests.minimal.hw.board import Board, why_not

from esair import minimal
from esair.boards import link
from esair.drivers.board.wire import Wire, stuffed

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
    for days in (5, 3650):
        loop.skip(days * 86400 * 50)
        found[name].append(cost(steps)[1])

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

LINK = """import gc, json, struct, time
from binascii import crc32, unhexlify
from esair.boards import link
from esair.boards.line import Line
from esair.minimal import Actuator, Loop, Reaction, Sensor, guards, reads, writes

class Bumper(Sensor):
    def read(self):
        return False

class Light(Sensor):
    rate = 10
    value = 0.25
    def read(self):
        return self.value

class Wheels(Actuator):
    safe = (0.0, 0.0)
    command_timeout = 0.3
    def write(self, command):
        pass

class Avoid(Reaction):
    bumper = reads(bool)
    wheels = writes(tuple, priority=10)
    def react(self, bumper):
        return (-0.5, -0.5) if bumper else None

class Slow(Reaction):
    bumper = reads(bool)
    wheels = guards(tuple)
    def react(self, bumper, wheels):
        return wheels

class Cruise(Reaction):
    light = reads(float)
    wheels = writes(tuple)
    rate = 50
    go = (0.4, 0.4)
    def react(self, light):
        return self.go

import io
YES = (1,)
sent = [0]
come, out = io.BytesIO(), io.BytesIO()
came = takes = {0: YES}.get
read, write = come.readinto, out.write
def also(actuator):
    kind = type("Also", (Cruise,), {"wheels": writes(tuple, name=actuator.name)})
    return kind(actuator.name)

def beat(data, now):
    "A beat of the computer, which answers one of now, in place of one of another time."
    if data[1:2] != b"h":
        return data
    payload = data[:4] + struct.pack("<H", now >> 4)
    payload = payload[1:] + struct.pack("<I", crc32(payload[1:]))
    found = b""
    for piece in payload.split(b"\\0"):
        found += bytes([len(piece) + 1]) + piece
    return found + b"\\0"

def measured(linked, others=0, count=400):
    come = io.BytesIO()
    sensors = [Bumper(), Light()]
    wheels = [Wheels()] + [Wheels("wheels%d" % i) for i in range(others)]
    reactions = [Avoid(), Slow()]
    line = Line(streams=(came, read, takes, write))
    if linked:
        orders = link.from_host(tuple(wheels))
        loop = Loop(reactions + orders, sensors + [link.Host(link.HOST)], wheels, rate=50)
        after = link.Link(loop, orders, "power-on", True, line)
    else:
        loop = Loop(reactions + [also(each) for each in wheels], sensors, wheels, rate=50)
        after = lambda: None
    worst = total = size = 0
    last = 0
    sent[0] = 0
    for i in range(count + 60):
        if linked:
            data = unhexlify(messages[others][i % 50 if i else 50])
            data = beat(data, 20 * i)
            come = io.BytesIO(data)
            line.read = come.readinto
            line.came = takes if data else {0: ()}.get
        gc.collect()
        object()  # room is looked for from here on, not over all that is there
        before = gc.mem_alloc()
        begin = time.ticks_us()
        loop.step()
        after()
        line.flush()
        sent[0] += out.tell()
        out.seek(0)
        took = time.ticks_diff(time.ticks_us(), begin)
        grew = gc.mem_alloc() - before
        if i == 60:
            worst = total = size = 0
            sent[0] = 0
        worst, total, size = max(worst, took), total + took, size + grew
    return [total / count, worst, size / count, sent[0] / count * 50, loop.faults]
print(json.dumps([[measured(False, i), measured(True, i)] for i in (0, 3)]))
"""

COSTS = {
    "number": (4.5, 0),
    "two sensors": (6.2, 0),
    "fresh tuple": (10.5, 16),
    "three reactions": (9.0, 0),
}
"""At most so many times three calls, `write(react(read()))`, and bytes, for one step."""


def told(others: int) -> list[str]:
    """Return what a computer sends in a second, step by step: ten beats, and commands."""
    names = ["wheels", *(f"wheels{number}" for number in range(others))]
    speaks = Wire()
    head = struct.pack("<BBBBHIIIIHH", ord("b"), link.VERSION, *[0] * 9)
    speaks.said(head)
    first = speaks.beat(None)
    rate = struct.pack("<II", 50_000, 0)
    speaks.said(b"n" + rate + f"bumper,light;{','.join(names)}".encode())
    found = [b""] * 50
    for step in range(0, 50, 5):
        (found[step],) = speaks.beat(armed=True)
        waiting = {name: speaks.command(name, (0.4, 0.4)) or b"" for name in names}
        after = step + 2
        while waiting:
            found[after], sent = speaks.commands(waiting)
            waiting = {n: each for n, each in waiting.items() if n not in sent}
            after += 1
    (found[1],) = speaks.rates({"bumper": 10.0, "light": 10.0})
    return [stuffed(each[:-4])[1:].hex() if each else "" for each in [*found, *first]]


def measured(folder: Path) -> dict[str, list[float]]:
    """Measure on the emulated board; its files are put into a folder."""
    (folder / "esair" / "boards").mkdir(parents=True)
    source = Path(minimal.__file__)
    shutil.copy(source, folder / "esair" / "minimal.py")
    for name in ("line", "link", "start"):
        shutil.copy(
            source.parent / "boards" / f"{name}.py", folder / "esair" / "boards"
        )
    with Board(folder, exact=True) as board:
        costs: dict[str, list[float]] = json.loads(board.run(MEASURE))
    with Board(folder, exact=True) as board:
        one, four = json.loads(
            board.run(f"messages = {{0: {told(0)}, 3: {told(3)}}}\n" + LINK)
        )
    costs["bare"], costs["linked"] = one
    costs["bare of four"], costs["linked of four"] = four
    return costs


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, list[float]]:
    """What was measured."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    return measured(tmp_path_factory.mktemp("board"))


@pytest.mark.parametrize("step", COSTS)
def test_a_step_costs_little(found, step) -> None:
    """In instructions, and no memory but that of a fresh command itself, at any age."""
    times, *sizes = found[step]

    assert times <= COSTS[step][0]
    assert max(sizes) < COSTS[step][1] + 0.5  # the clock's own number, once


def test_wiring_takes_little_memory(found) -> None:
    """Four reactions, two sensors and an actuator: the least free heap that is enough."""
    assert found["wiring"] <= 2600


V1 = 10 * (95 + 7) + 10 * (len("Sbumper") + 1 + len("[20, false]") + 7)
V1 += 10 * (len("Slight") + 1 + len("[20, 0.25]") + 7)
"""Bytes a second that version 1 sent for the same: beats and two sensors, ten of each."""


@pytest.mark.promise("MIN-6")
@pytest.mark.parametrize("of", ["", " of four"])
def test_a_link_costs_little(found, of: str) -> None:
    """Each step with beats, commands and two sensors at 10 Hz, to one that drives alone."""
    bare, linked = found[f"bare{of}"], found[f"linked{of}"]
    mean, worst, size, sent, faults = linked

    assert faults == 0
    assert mean <= 2 * bare[0]
    assert worst <= 3 * bare[1]
    assert size - bare[2] <= 120
    assert sent <= V1 / 2
