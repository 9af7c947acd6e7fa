"""A part on a CAN bus that is asked for numbers, for the contract of buses."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from esair.buses import Exchanges
from esair.exceptions import DeviceLostError

QUESTION, ANSWER = 0x102, 0x182


class Asked:
    """Asks by one frame, and is answered by another, as drivers of such parts do."""

    exchanges: Exchanges | None = None
    hearing: asyncio.Task[None]

    async def ask(self, bus: Any, number: int) -> int:
        if self.exchanges is None:
            self.exchanges = Exchanges(bus, late_limit=1.0)
            self.hearing = asyncio.ensure_future(self.hear(bus, self.exchanges))

        async def send(_left: float) -> None:
            await bus.send(QUESTION, bytes((number,)))

        return (await self.exchanges.ask(send, timeout=5.0))[0]

    async def hear(self, bus: Any, exchanges: Exchanges) -> None:
        with contextlib.suppress(DeviceLostError):
            async for frame in bus.frames(ANSWER):
                exchanges.offer(frame.data)
