"""Requests that are there at the same time, as one on the wire."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping

from esair.loop import spawn

Made = Mapping[int, "int | BaseException"]


class Together:
    """Gathers requests for the same entry of several servos until their turn.

    Args:
        make: Makes requests for one entry; gets its address and size and, by servo, the
            value to write or None to read. Returns the value, or the error, by servo.
    """

    def __init__(
        self, make: Callable[[int, int, Mapping[int, int | None]], Awaitable[Made]]
    ) -> None:
        self._make = make
        self._turn = asyncio.Lock()
        self._open: dict[tuple[int, int, bool], _Batch] = {}

    async def ask(
        self, servo: int, address: int, size: int, value: int | None
    ) -> int | None:
        """Read or write an entry; one that is cancelled before its turn is not sent."""
        key = (address, size, value is None)
        batch = self._open.get(key)
        if batch is None:
            loop = asyncio.get_running_loop()
            batch = self._open[key] = _Batch()
            spawn(loop, self._run(key, batch), name="servos together")
        future: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        batch.append((servo, value, future))
        return await future

    async def _run(self, key: tuple[int, int, bool], batch: _Batch) -> None:
        await asyncio.sleep(0)  # what is asked in the same moment comes with it
        async with self._turn:
            if self._open.get(key) is batch:
                del self._open[key]
            live = [each for each in batch if not each[2].done()]
            asked = {servo: value for servo, value, _ in live}  # the newest wins
            made: Made = {}
            if asked:
                try:
                    made = await self._make(key[0], key[1], asked)
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


class _Batch(list[tuple[int, "int | None", "asyncio.Future[int]"]]):
    """Requests that wait for their turn."""
