"""``python -m benchmarks.pythons``: what hot paths cost on the Python that runs it.

The least CPU time of many short blocks: what else the computer does makes none of them
shorter. Run it on one Python after the other, several times, and compare the least.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import logging
import platform
import time
from collections.abc import Awaitable, Callable

import esair
from benchmarks.cases.components import Idle, Meter, Motor, User, reacting_robot
from esair.loop import TurnLoop

BLOCKS = 60
TIMES = 400
REACTIONS = 100


async def least(work: Callable[[], Awaitable[object]], times: int = TIMES) -> float:
    """Return the CPU time of one operation in the best block, in microseconds."""
    best = float("inf")
    for _ in range(BLOCKS):
        begin = time.thread_time()
        for _ in range(times):
            await work()
        best = min(best, (time.thread_time() - begin) / times)
        await asyncio.sleep(0)
    return round(best * 1e6, 3)


async def measured() -> dict[str, float]:
    user, one, other = User(), Idle(name="one"), Idle(name="other")
    robot = esair.Robot(
        resources=[Meter(rate=1.0), Motor()], behaviors=[user, one, other]
    )

    async def put() -> None:
        await one.put("other", 1)
        await other.receive()

    async def written() -> None:
        await user.motor.write(0.5)

    async with robot:
        await user.meter.read(fresh=True)
        found = {
            "put and receive": await least(put),
            "read": await least(user.meter.read),
            "write": await least(written),
        }
    for case, acting in (("step, 1 in 10 writes", 10), ("step, all write", 1)):
        best = float("inf")
        async with reacting_robot(REACTIONS, acting=acting) as crowd:
            await asyncio.sleep(0.5)
            names = crowd.behaviors.names()
            for _ in range(BLOCKS):
                before = sum(crowd.behaviors.query(n).steps for n in names)
                begin = time.thread_time()
                await asyncio.sleep(0.1)
                took = time.thread_time() - begin
                made = sum(crowd.behaviors.query(n).steps for n in names) - before
                best = min(best, took / max(made, 1))
        found[case] = round(best * 1e6, 3)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pythons")
    parser.add_argument("--loop", choices=["esair", "uvloop"], default="esair")
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    factory: Callable[[], asyncio.AbstractEventLoop] = TurnLoop
    if arguments.loop == "uvloop":
        import uvloop

        factory = uvloop.new_event_loop
    gc.disable()
    with asyncio.Runner(loop_factory=factory) as runner:
        found = runner.run(measured())
    title = f"{platform.python_version()} {arguments.loop}"
    print(json.dumps({title: found}))


if __name__ == "__main__":
    main()
