"""P18: the journal while nobody listens, and with one listener that keeps all."""

from __future__ import annotations

import asyncio
import collections
import time

import esair
from benchmarks.cases.components import Meter, Motor, User
from benchmarks.harness import Row, future_round_trip, neighbors, us
from esair.journal import Event, Journal, Kind

COUNT = 4000
LOOKS = 3
"""How often a write looks whether anybody listens."""


async def rows() -> list[Row]:
    user = User()
    robot = esair.Robot(resources=[Meter(rate=1.0), Motor()], behaviors=[user])
    journal = Journal()

    async def looks() -> float:
        begin = time.perf_counter()
        for _ in range(COUNT):
            for _ in range(LOOKS):
                if journal.heard.sent:
                    raise RuntimeError("nobody listens")
        looked = time.perf_counter() - begin
        begin = time.perf_counter()
        for _ in range(COUNT):
            for _ in range(LOOKS):
                pass
        return max(looked - (time.perf_counter() - begin), 1e-12) / COUNT

    async def write() -> float:
        begin = time.perf_counter()
        for _ in range(COUNT):
            await user.motor.write(0.5)
        return (time.perf_counter() - begin) / COUNT

    kept: collections.deque[Event] = collections.deque(maxlen=1000)
    told = Journal()
    told.listen(kept.append, backlog=2 * COUNT)
    told.start(asyncio.get_running_loop())

    async def publish() -> float:
        begin = time.perf_counter()
        for number in range(COUNT):
            told.publish(Kind.SENT, "wheels", "wander", number)
        while told.number != (kept[-1].number if kept else 0):  # noqa: ASYNC110
            await asyncio.sleep(0)
        return (time.perf_counter() - begin) / COUNT

    async with robot:
        nobody, whole, share = await neighbors(looks, write)
    one, limit, ratio = await neighbors(publish, future_round_trip)
    return [
        Row("P18 nobody listens", us(nobody), f"write {us(whole)}", share, 0.01),
        Row("P18 an event to one listener", us(one), f"F {us(limit)}", ratio, 0.15),
    ]
