"""Requests that are there at the same time, as one on the wire."""

from __future__ import annotations

import asyncio
import enum
from collections.abc import Awaitable, Callable, Mapping

from esair.loop import spawn

QUIET = 3
"""For how many turns of the loop nothing is asked before what was asked leaves."""

Made = Mapping[int, "int | BaseException"]


class Kind(enum.IntEnum):
    """What a request does with an entry, in the order in which they leave."""

    TELL = 0
    """Change it; nobody answers, so nobody waits."""
    WRITE = 1
    READ = 2


Key = tuple[Kind, int, int]
"""What requests have in common that are made together: its kind, address and size."""


class Together:
    """Gathers requests for the same entry of several servos until their turn.

    What servos are told goes before what they are asked: only that has to wait for them.
    """

    def __init__(
        self, make: Callable[[Key, Mapping[int, int]], Awaitable[Made]]
    ) -> None:
        self._make = make
        self._batches: dict[Key, list[tuple[int, int, asyncio.Future[int]]]] = {}
        self._is_running = False

    async def ask(
        self, kind: Kind, servo: int, address: int, size: int, value: int = 0
    ) -> int:
        """Make a request; one that is cancelled before its turn is not sent."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[int] = loop.create_future()
        batch = self._batches.setdefault((kind, address, size), [])
        batch.append((servo, value, future))
        if not self._is_running:
            self._is_running = True
            spawn(loop, self._run(), name="servos together")
        return await future

    async def _run(self) -> None:
        try:
            while self._batches:
                await self._settled()
                batches, self._batches = self._batches, {}
                for key in sorted(batches, key=lambda key: key[0]):
                    await self._run_batch(key, batches[key])
        finally:
            self._is_running = False

    async def _settled(self) -> None:
        """Wait for what is asked in the same moment, which takes some turns of the loop."""
        asked, quiet = -1, 0
        while quiet < QUIET:
            now = sum(map(len, self._batches.values()))
            quiet = quiet + 1 if now == asked else 0
            asked = now
            await asyncio.sleep(0)

    async def _run_batch(
        self, key: Key, batch: list[tuple[int, int, asyncio.Future[int]]]
    ) -> None:
        live = [each for each in batch if not each[2].done()]
        if not live:
            return
        made: Made
        asked = {servo: value for servo, value, _ in live}  # the newest wins
        try:
            made = await self._make(key, asked)
        except Exception as error:
            made = dict.fromkeys(asked, error)
        for servo, _, future in live:
            result = made[servo]
            if future.done():
                continue
            if isinstance(result, BaseException):
                future.set_exception(result)
            else:
                future.set_result(result)
