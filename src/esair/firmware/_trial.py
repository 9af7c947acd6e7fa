"""Runs a built folder: ``micropython trial.py FOLDER BESIDE SECONDS REPORT JUMP``.

It runs in MicroPython, beside `esair.boards.stand_in` as ``trial_machine``, and writes
down as JSON what it saw. With a ``JUMP`` of 1 its clock jumps over each sleep.
"""

# mypy: disable-error-code="attr-defined, method-assign, assignment, import-not-found"
# MicroPython's gc and sys have more than CPython's.

import gc
import io
import json
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

folder, beside, seconds, report, jump = sys.argv[1:6]
os.chdir(folder)
sys.path[:] = [folder, beside] + [each for each in sys.path if each[:1] == "."]
import trial_machine  # noqa: E402

sys.modules["machine"] = trial_machine
if jump == "1":
    import trial_time

    sys.modules["time"] = sys.modules["utime"] = trial_time
gc.collect()
before = gc.mem_alloc()
from esair import minimal  # noqa: E402

faults: "dict[str, str]" = {}
mistakes: "dict[str, str]" = {}
loops: "list[minimal.Loop]" = []
note = minimal.Loop.note
run = minimal.Loop.run
used = 0


def traceback_of(error: BaseException) -> str:
    text = io.StringIO()
    sys.print_exception(error, text)
    return text.getvalue().replace(folder + "/", "").strip()


def noted(loop: minimal.Loop, name: str, error: BaseException) -> None:
    note(loop, name, error)
    key = "%s: %r" % (name, error)
    if key not in faults and len(faults) < 100:
        faults[key] = "%s: %s" % (name, traceback_of(error))
        # What a missing part raises is an OSError; all else is the program's own.
        if not isinstance(error, OSError):
            mistakes[key] = faults[key]


def run_a_while(
    loop: minimal.Loop,
    steps: "int | None" = None,
    feed: "Callable[[], Any] | None" = None,
) -> None:
    global used
    loops.append(loop)
    for part in loop.parts:
        if isinstance(part, (minimal.Sensor, minimal.Actuator)):
            own(part)
    gc.collect()
    used = gc.mem_alloc() - before
    loop.arm()  # or nothing would be told to an actuator
    run(loop, steps=max(2, int(float(seconds) * loop.every / 1000)), feed=feed)


def own(part: "Any") -> None:
    """Let the pins that a part takes when it is opened be its own."""
    opened = part.open
    kind = "actuator_" if isinstance(part, minimal.Actuator) else "sensor_"

    def open_it() -> None:
        trial_machine.owner[0] = kind + part.name
        opened()
        trial_machine.owner[0] = "arm"

    part.open = open_it


minimal.Loop.note = noted
minimal.Loop.run = run_a_while
with open("main.py") as file:
    text = file.read()
# The parts are made line by line: the pins that one takes are its own.
begin = max(0, text.find("\n_loop = Loop("))
space: "dict[str, Any]" = {"__name__": "main"}
for line in text[:begin].split("\n"):
    trial_machine.owner[0] = line.split(" = ")[0].split(".")[0]
    exec(line, space)
trial_machine.owner[0] = "arm"
exec(text[begin:], space)

if not loops:
    raise RuntimeError("main.py runs no loop")
with open(report, "w") as file:
    json.dump(
        {
            "steps": loops[0].steps,
            "late": loops[0].late,
            "refused": loops[0].refused,
            "faults": list(faults.values()),
            "mistakes": list(mistakes.values()),
            "pins": trial_machine.used,
            "owners": trial_machine.owners,
            # Words of this computer have 64 bits, those of a board half of it.
            "memory": used // 2,
        },
        file,
    )
