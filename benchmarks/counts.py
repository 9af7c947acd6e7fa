"""``python -m benchmarks.counts``: what hot paths cost, in byte codes and Python calls.

These repeat to the digit whatever else the computer does, so that a change can be held to
them where no time can be measured. A row is counted on the virtual clock, with all that the
interpreter executes for it, the standard library's too, but not the clock's own loop.
"""

from __future__ import annotations

import argparse
import asyncio
import collections
import gc
import json
import logging
import os
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterable, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

import attrs

import esair
from benchmarks.cases.components import Decide as Beside
from benchmarks.cases.components import (
    Idle,
    Meter,
    Motor,
    PlainMotor,
    User,
    reacting_robot,
)
from benchmarks.cases.data_path import PlainUser
from benchmarks.cases.devices import Arrival, Command, Reflex
from esair.journal import Event, Kind
from esair.testing import FakeCan, VirtualLoop

KEPT = Path(__file__).with_name("counts.json")
"""What was accepted, by version of Python."""

CHANGE = 0.02
"""By which part a number may differ from what was accepted."""

ACCEPT = "python -m benchmarks.counts --accept"

BATCH = 16
TIMES = 50
REACTIONS = 100
TRIPLES = 1_600

NOT_COUNTED = (
    str(Path(esair.__file__).parent / "testing"),
    str(Path(__file__).parent),
)

Work = Callable[[], Awaitable[object]]


@attrs.frozen
class Count:
    """What one operation takes.

    Attributes:
        codes: Byte codes that are executed.
        calls: Python functions that are called, or go on.
    """

    codes: float
    calls: float


async def counted(work: Work, times: int) -> Count:
    """Count while something is awaited that does its operation so many times."""
    codes = calls = 0

    def see_code(_frame: FrameType, event: str, _argument: object) -> Any:
        nonlocal codes
        codes += event == "opcode"
        return see_code

    def see(frame: FrameType, _event: str, _argument: object) -> Any:
        nonlocal calls
        if frame.f_code.co_filename.startswith(NOT_COUNTED):
            return None
        calls += 1
        frame.f_trace_lines, frame.f_trace_opcodes = False, True
        return see_code

    gc.collect()
    gc.disable()
    before = sys.gettrace()  # who measures which lines are tested goes on with that
    sys._getframe().f_trace_opcodes = True  # Python 3.12 looks only now if any is set
    sys.settrace(see)
    try:
        await work()
    finally:
        sys.settrace(before)
        gc.enable()
    return Count(round(codes / times, 2), round(calls / times, 2))


async def repeated(work: Work, times: int) -> Count:
    """Count an operation that is awaited so many times."""

    async def all_of_it() -> None:
        for _ in range(times):
            await work()

    await work()  # what is made once is made
    return await counted(all_of_it, times)


async def put_and_get() -> dict[str, Count]:
    one, other = Idle(name="one"), Idle(name="other")
    async with esair.Robot(behaviors=[one, other]):
        put = await repeated(lambda: one.put("other", 1), BATCH - 1)
        for _ in range(BATCH):
            one.offer(1)
        get = await repeated(lambda: other.get("one"), BATCH - 1)
    return {"P1 put, the receiver is ready": put, "P1 get, the data is offered": get}


async def data_path() -> dict[str, Count]:
    user, plain = User(), PlainUser()
    robot = esair.Robot(
        resources=[Meter(rate=1.0), Motor(), PlainMotor()], behaviors=[user, plain]
    )
    async with robot:
        await user.meter.read(fresh=True)
        return {
            "P3 read, the newest reading will do": await repeated(
                user.meter.read, TIMES
            ),
            "P4 write of a number": await repeated(
                lambda: user.motor.write(0.5), TIMES
            ),
            "P4 write of a number, plain driver": await repeated(
                lambda: plain.motor.write(0.5), TIMES
            ),
        }


async def steps() -> dict[str, Count]:
    found = {}
    for case, acting, plain in (
        ("P5 a step, 1 in 10 writes", 10, False),
        ("P5 a step, all write", 1, False),
        ("P5 a step, plain drivers, 1 in 10 writes", 10, True),
        ("P5 a step, plain drivers, all write", 1, True),
    ):
        async with reacting_robot(REACTIONS, acting=acting, plain=plain):
            await asyncio.sleep(1.0005)  # between two moments of the grid
            found[case] = await counted(lambda: asyncio.sleep(0.2), 20 * REACTIONS)
    return found


async def heard() -> dict[str, Count]:
    """A step that writes, by who listens to the journal."""
    found = {}
    kept: collections.deque[Event] = collections.deque(maxlen=10)
    for case, plain, kinds in (
        ("P18 a writing step, all kinds heard", False, Kind),
        ("P18 a writing step, all kinds heard, plain drivers", True, Kind),
        ("P18 a writing step, another kind heard", False, [Kind.LOG]),
    ):
        robot = reacting_robot(REACTIONS, acting=1, plain=plain)
        listener = robot.journal.listen(kept.append, kinds=kinds)
        listener.is_waited_for = True  # else it hears less in a turn that takes long
        async with robot:
            await asyncio.sleep(1.0005)
            found[case] = await counted(lambda: asyncio.sleep(0.2), 20 * REACTIONS)
    return found


async def frame_to_command() -> dict[str, Count]:
    can = FakeCan("wire")
    robot = esair.Robot(
        resources=[Arrival(bus=can), Command(bus=can)], behaviors=[Reflex()]
    )
    async with robot:

        async def frame() -> None:
            sent = len(can.sent)
            can.feed(0x181, b"\x01")
            while len(can.sent) == sent:  # noqa: ASYNC110 - no more than the turns it takes
                await asyncio.sleep(0)

        await asyncio.sleep(0.1)
        return {"P9 frame to command": await repeated(frame, TIMES)}


def hold(name: str, number: int | str) -> esair.Reaction:
    return Beside(
        name=name,
        reads={"meter": esair.reads(float, name=f"meter_{number}")},
        writes={"motor": esair.writes(float, name=f"motor_{number}")},
    )


async def changes() -> dict[str, Count]:
    found = {}
    async with reacting_robot(TRIPLES, acting=0) as robot:
        for case, there, make in (
            ("behavior", robot.behaviors, lambda: Idle(name="new")),
            ("sensor", robot.resources, lambda: Meter(name="new")),
            ("reaction", robot.behaviors, lambda: hold("new", 7)),
        ):

            async def pair(there: Any = there, make: Any = make) -> None:
                await there.add(make())
                await there.remove("new")

            count = await repeated(pair, 3)
            found[f"P10 add and remove a {case} beside {3 * TRIPLES:,}"] = count
    return found


ROWS: tuple[Callable[[], Awaitable[dict[str, Count]]], ...] = (
    put_and_get,
    data_path,
    steps,
    heard,
    frame_to_command,
    changes,
)


def count_all() -> dict[str, Count]:
    """Count every row, each group in a loop of its own."""
    found: dict[str, Count] = {}
    for rows in ROWS:
        with asyncio.Runner(loop_factory=VirtualLoop) as runner:
            found |= runner.run(rows())  # type: ignore[arg-type]
    return found


def changed(accepted: Mapping[str, Count], found: Mapping[str, Count]) -> Iterable[str]:
    """Return a line for each number that is not what was accepted."""
    for case in sorted({*accepted, *found}):
        if case not in accepted or case not in found:
            yield f"{case}: {'gone' if case in accepted else 'new'}"
            continue
        for what in ("codes", "calls"):
            was, now = getattr(accepted[case], what), getattr(found[case], what)
            if abs(now - was) > CHANGE * was:
                yield f"{case}: {now:g} {what}, accepted {was:g}, {now / was - 1:+.1%}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.counts")
    parser.add_argument(
        "--accept", action="store_true", help="keep the numbers as they are now"
    )
    arguments = parser.parse_args()
    if os.environ.get("PYTHONHASHSEED") != "0":  # sets have one order
        again = [sys.executable, "-m", "benchmarks.counts", *sys.argv[1:]]
        sys.exit(subprocess.call(again, env={**os.environ, "PYTHONHASHSEED": "0"}))
    logging.disable(logging.WARNING)
    version = "{}.{}".format(*sys.version_info)
    found = count_all()
    for case, count in found.items():
        print(f"{case:58} {count.codes:10,.2f} codes {count.calls:9,.2f} calls")
    kept: dict[str, Any] = json.loads(KEPT.read_text())
    if arguments.accept:
        kept[version] = {case: attrs.asdict(count) for case, count in found.items()}
        KEPT.write_text(json.dumps(kept, indent=2, sort_keys=True) + "\n")
        return
    if version not in kept:
        print(f"nothing is accepted for Python {version}: {ACCEPT}")
        return
    accepted = {case: Count(**count) for case, count in kept[version].items()}
    lines = list(changed(accepted, found))
    if lines:
        told = [*lines, f"if it is meant to be so: {ACCEPT}"]
        sys.exit("\n".join([f"changed by more than {CHANGE:.0%}:", *told]))


if __name__ == "__main__":
    main()
