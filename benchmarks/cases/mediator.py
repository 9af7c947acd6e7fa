"""P1 and P2: put and get through the behavior supervisor, in units of F."""

from __future__ import annotations

import asyncio
import time

import esair
from benchmarks.cases.components import Idle
from benchmarks.harness import Row, future_round_trip, neighbors, us

BATCH = 16  # what an inbox holds by default


async def rows() -> list[Row]:
    one, other = Idle(name="one"), Idle(name="other")
    async with esair.Robot(behaviors=[one, other]):

        async def put() -> float:
            spent = 0.0
            for _ in range(200):
                begin = time.perf_counter()
                for _ in range(BATCH):
                    await one.put("other", 1)
                spent += time.perf_counter() - begin
                for _ in range(BATCH):
                    await other.receive()
            return spent / 200 / BATCH

        async def get() -> float:
            spent = 0.0
            for _ in range(200):
                for _ in range(BATCH):
                    one.offer(1)
                begin = time.perf_counter()
                for _ in range(BATCH):
                    await other.get("one")
                spent += time.perf_counter() - begin
            return spent / 200 / BATCH

        async def waiting_put() -> float:
            """The receiver has no room; it takes one piece after the other."""
            for _ in range(BATCH):
                await one.put("other", 0)
            count = 1500

            async def take() -> None:
                for _ in range(count):
                    await other.receive()
                    await asyncio.sleep(0)

            taker = asyncio.create_task(take())
            begin = time.perf_counter()
            for _ in range(count):
                await one.put("other", 1)
            seconds = (time.perf_counter() - begin) / count
            await taker
            for _ in range(BATCH):
                await other.receive()
            return seconds

        found = []
        for case, operation, goal in (
            ("P1 put, the receiver is ready", put, 0.12),
            ("P1 get, the data is offered", get, 0.12),
            ("P2 put, it waits for the receiver", waiting_put, 1.8),
        ):
            mine, limit, ratio = await neighbors(operation, future_round_trip)
            found.append(Row(case, us(mine), f"F {us(limit)}", ratio, goal))
    found.append(await _hundred_senders())
    found.extend(await _peers())
    return found


async def _hundred_senders() -> Row:
    """A hundred behaviors put at once into boxes that are full: all have to wait."""
    senders = [Idle(name=f"sender_{number}") for number in range(100)]
    targets = [Idle(name=f"target_{number}") for number in range(2)]
    async with esair.Robot(behaviors=[*senders, *targets]):

        async def crowd() -> float:
            for target in targets:
                for _ in range(BATCH):
                    await senders[0].put(target.name, 0)
            puts = [
                asyncio.create_task(sender.put(targets[number % 2].name, number))
                for number, sender in enumerate(senders)
            ]
            await asyncio.sleep(0)
            begin = time.perf_counter()
            for target in targets:
                for _ in range(len(senders) // 2):
                    await target.receive()
            await asyncio.gather(*puts)
            seconds = (time.perf_counter() - begin) / len(senders)
            for target in targets:
                for _ in range(BATCH):
                    await target.receive()
            return seconds

        async def repeated() -> float:
            return sum([await crowd() for _ in range(8)]) / 8

        mine, limit, ratio = await neighbors(repeated, future_round_trip)
    return Row("P2 100 senders at once, each", us(mine), f"F {us(limit)}", ratio, 1.5)


async def _peers() -> list[Row]:
    """The same request through what people could use instead, if it is installed."""
    try:
        import pykka
    except ImportError:
        note = "not installed: pip install -r benchmarks/requirements-peers.txt"
        return [Row("P1 peer: pykka ask", "", "", 0.0, None, note)]

    class Actor(pykka.ThreadingActor):  # type: ignore[misc, unused-ignore]
        def on_receive(self, message: object) -> object:
            return message

    actor = Actor.start()

    async def ask() -> float:
        begin = time.perf_counter()
        for _ in range(500):
            actor.ask(1)
        return (time.perf_counter() - begin) / 500

    try:
        mine, limit, ratio = await neighbors(ask, future_round_trip)
    finally:
        actor.stop()
    return [Row("P1 peer: pykka ask", us(mine), f"F {us(limit)}", ratio, None)]
