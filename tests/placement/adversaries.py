"""Components that are stuck, swallow, flood and lie, each in a process of its own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import socket
from collections.abc import Callable
from typing import Any

from tests.placement.parts import Twist

import esair
from esair.placement._wire import Item, Op

MANY = 1000


def flood(child: Any, count: int, item: Callable[[int], Item]) -> None:
    child._wire.send(Op.IDLE, math.inf, [item(number) for number in range(count)])
    child._has_turn = False


def say(text: str) -> None:
    os.write(1, text.encode())


def record(**changes: object) -> None:
    told = {"level": 20, "name": "esair", "text": "x", **changes}
    say(f"\x1e{json.dumps(told)}\n")


def swallow(child: Any) -> None:
    """Take whatever comes, and answer nothing."""
    end = child._wire._end
    while True:
        end.recv(1 << 16)


def call(child: Any, number: int, verb: str, *args: Any, worked: Any = 0.0) -> Item:
    return Item(Op.CALL, number, verb, child.pack("x", (None, *args)), worked=worked)


def wake(child: Any, when: float) -> None:
    child._wire.send(Op.IDLE, when)
    child._has_turn = False


def send_file(child: Any) -> None:
    file = os.memfd_create("x", os.MFD_ALLOW_SEALING)
    os.ftruncate(file, 8 << 20)
    socket.send_fds(child._wire._end, [b"\0"], [file])


def name_many() -> None:
    for each in range(150):
        record(name=f"adversary.{each}")


def ask_for_ever(child: Any) -> None:
    """Ask one thing after another, and never let the own loop go on."""
    while True:
        child.wait("query", "liar")


def offer_for_ever(child: Any) -> None:
    """The same with all that a message may hold, whatever the robot says to it."""
    rows = [str(each) for each in range(60_000)]
    while True:
        with contextlib.suppress(Exception):
            child.component.offer(rows, latest=True)


LIES: dict[str, Callable[[Any], object]] = {
    "not a number": lambda child: wake(child, math.nan),
    "before all time": lambda child: wake(child, -math.inf),
    "one call for ever": lambda child: flood(
        child, MANY, lambda _: call(child, 9, "receive", None)
    ),
    "calls without end": lambda child: flood(
        child, 2 * MANY, lambda number: call(child, number, "query", "liar")
    ),
    "answers to nobody": lambda child: flood(
        child, 20 * MANY, lambda number: Item(Op.DONE, 9 + number, "", b"")
    ),
    "busy for ever": lambda child: child.queue.append(
        call(child, 9, "write :wheels", Twist(1.0, 1.0), worked=math.nan)
    ),
    "asks for ever": ask_for_ever,
    "long lists for ever": offer_for_ever,
    "swallow": swallow,
    "files": send_file,
}

WORDS: dict[str, Callable[[], object]] = {
    "no level": lambda: record(level=math.inf),
    "nested": lambda: say("\x1e" + "[" * 16000 + "\n"),
    "a name of two lines": lambda: record(name="a\nb", level=40),
    "names": name_many,
}


class Speaker(esair.Behavior):
    """Drives, and then does something bad, once or again and again."""

    placement = "process"
    wheels = esair.writes(Twist)

    def __init__(self, what: str) -> None:
        super().__init__(name="liar")
        self.what = what

    async def run(self) -> None:
        child: Any = self._host._child
        if self.what == "much":
            rows = ["x" * 20] * 20_000
            await asyncio.gather(*(self.put("taker", rows) for _ in range(20)))
            return
        await self.wheels.write(Twist(0.1, 0.0))
        await asyncio.sleep(0.1)
        if self.what in LIES:
            LIES[self.what](child)
            await asyncio.sleep(1.0)
        elif self.what in WORDS:
            WORDS[self.what]()
            say("that was it\n")
            await asyncio.sleep(60.0)
        while self.what == "lines":
            say("\n" * 4096)
        while self.what == "records":
            say("\x1e{\n" * 1300)
        while self.what == "wakes":  # noqa: ASYNC110 - it should not
            await asyncio.sleep(1e-9)
        while self.what == "memory":
            eaten = [bytearray(1 << 20)]
            while True:
                eaten += [bytearray(1 << 20)]
                await asyncio.sleep(0.0)
