"""Components that a process could treat otherwise than a task."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import attrs

import esair


@attrs.frozen
class Count(esair.Request[int]):
    what: Any


class Threads(esair.Behavior):
    """Writes what a thread has computed."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        for number in range(1, 4):
            value = await asyncio.to_thread(self.computed, number)
            await self.wheels.write(value)
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, time.sleep, 0.01)
        await self.wheels.write(9.0)

    def computed(self, number: int) -> float:
        time.sleep(0.01)
        return float(number)


class Twice(esair.Behavior):
    """Goes on with another loop over a port where it has left the first."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    async def run(self) -> None:
        for wanted in (2, 3):
            seen = 0
            async for value in self.sonar:
                await self.wheels.write(value)
                seen += 1
                if seen == wanted:
                    break


class Plans(esair.Behavior):
    """Works for a second with a pause each millisecond, and drives meanwhile."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            drives = tasks.create_task(self.drive())
            end = time.monotonic() + 1.0
            while time.monotonic() < end:
                until = time.monotonic() + 0.001
                while time.monotonic() < until:
                    pass
                await asyncio.sleep(0)
            drives.cancel()

    async def drive(self) -> None:
        while True:
            await self.wheels.write(0.3)
            await asyncio.sleep(0.05)


class Receives(esair.Behavior):
    inbox_size = 4
    counts = esair.takes(Count)

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.hear())
            async for count in self.counts:
                async with count:
                    count.answer(1)

    async def hear(self) -> None:
        while True:
            await self.receive()


class Asks(esair.Behavior):
    """Asks one that answers with what cannot cross."""

    inbox_size = 1

    async def run(self) -> None:
        try:
            await self.ask("answers", Count(1))
        except esair.BehaviorFailedError as error:
            self.offer(str(error), latest=True)
        await self.receive()


class Answers(esair.Behavior):
    met = ""
    counts = esair.takes(Count)

    async def run(self) -> None:
        async for count in self.counts:
            with contextlib.suppress(esair.BadValueError):
                async with count:
                    try:
                        count.answer(Path("/somewhere"))  # type: ignore[arg-type]
                    except esair.BadValueError as error:
                        self.met = str(error)
                        raise


class Looks(esair.Reaction):
    camera = esair.reads(Any)
    wheels = esair.writes(float)

    def react(self, camera: Any) -> float:
        return 0.5


class Murmurs(esair.Behavior):
    """Writes what has no end of line, and logs."""

    async def run(self) -> None:
        os.write(1, b"loading")
        logging.getLogger("rover").error("it is hot")
        os.write(1, b"ready")


class Notes(esair.Behavior):
    """Goes on after an error, which it logs."""

    async def run(self) -> None:
        try:
            raise ValueError("a stone")
        except ValueError:
            logging.getLogger("rover").exception("it turns:\nto the left")


class Wants(esair.Reaction):
    """Wants what is no command when the sonar says 2."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> Any:
        return Path("/somewhere") if sonar == 2.0 else sonar


class Decides(esair.Reaction):
    """Says which one it is, after a while."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def __init__(self, number: float, nap: float) -> None:
        super().__init__()
        self.number, self.nap = number, nap

    def react(self, sonar: float) -> float:
        time.sleep(self.nap)
        return self.number


class Sees(esair.Behavior):
    """Answers with a small number what is too large to come to it."""

    camera = esair.reads(Any)

    @esair.answers
    async def count(self, request: Count) -> int:
        picture: Any = await self.camera.read()
        return len(picture)


class Eyes(esair.Reaction):
    """Hangs at its sixth reading."""

    placement = esair.Placement(stall=9.0)
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=5)

    def react(self, sonar: float) -> float:
        if sonar > 5.0:
            time.sleep(30.0)
        return 0.2


class Drive(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        while True:
            await self.wheels.write(9.0)
            await asyncio.sleep(0.013)


class Begins(esair.Behavior):
    """Begins programs, and says which."""

    async def run(self) -> None:
        one = subprocess.Popen(["sleep", "1000"])  # noqa: ASYNC220 - as users do
        other = await asyncio.create_subprocess_exec("sleep", "1000")
        self.offer([one.pid, other.pid], latest=True)
        await asyncio.sleep(1000.0)


class Dies(esair.Behavior):
    """Its process ends while it works on a request."""

    counts = esair.takes(Count)

    async def run(self) -> None:
        async for count in self.counts:
            async with count:
                os._exit(3)


class Talks(esair.Behavior):
    """Logs more than is shown, and dies."""

    placement = "process"
    restart = esair.Restart(max=0)

    async def run(self) -> None:
        for number in range(300):
            logging.getLogger("talks").info("word %d", number)
        os._exit(3)


class Falls(esair.Behavior):
    """Dies far below, with others at work, after a word on why."""

    placement = esair.Placement(stall=0.5)
    restart = esair.Restart(max=0)

    def __init__(self, how: str) -> None:
        super().__init__()
        self.how = how

    async def run(self) -> None:
        for _ in range(3):
            threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()
        print("no such part", flush=True)  # noqa: T201 - as a library in C does
        self.fall(40)

    def fall(self, depth: int) -> None:
        if depth:
            self.fall(depth - 1)
        else:
            self.culprit()

    def culprit(self) -> None:
        if self.how == "hang":
            time.sleep(60.0)
        os.abort()


class TakesApart(esair.Behavior):
    """Goes from the end of a list."""

    def __init__(self, route: list[int], *, by: dict[str, list[int]]) -> None:
        super().__init__()
        self.first, self.by = route.pop(), by.popitem()

    async def run(self) -> None:
        self.offer((self.first, self.by), latest=True)
        await asyncio.sleep(1e6)


class Tells(esair.Behavior):
    """Where another Python that it begins would look for modules."""

    async def run(self) -> None:
        self.offer(os.environ.get("PYTHONPATH"), latest=True)
        await asyncio.sleep(1e6)


class Complains(esair.Behavior):
    """Fails with all that it has read."""

    restart = esair.Restart(max=0)

    async def run(self) -> None:
        raise ValueError("x" * 3_000_000)


class Goes(esair.Behavior):
    """Writes for ever, whatever it is told; what it performs first does the same."""

    wheels = esair.writes(float)

    def __init__(self, below: int = 0) -> None:
        super().__init__()
        self.below = below

    async def run(self) -> None:
        for _ in range(30):
            with contextlib.suppress(asyncio.CancelledError, esair.EsairError):
                if self.below:
                    await self.perform(Goes(self.below - 1), timeout=None)
                await self.wheels.write(1.0)
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(0.1)


class Limits(esair.Behavior):
    """Performs one that goes on after its time is over, and performs others."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        await self.perform(Goes(below=2), timeout=0.3)
