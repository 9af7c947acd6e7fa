"""A behavior that hoists, and can be told to hang in the middle of it."""

import asyncio
import re
import time

import esair


class Hoist(esair.Behavior):
    """Pulls for a second; or does not come back from a regular expression."""

    winch = esair.writes(float)
    stuck = False

    async def run(self) -> None:
        began = time.monotonic()
        while time.monotonic() - began < 1.0:
            await self.winch.write(0.5)
            await asyncio.sleep(0.05)
            if self.stuck:
                re.match(r"(a+)+$", "a" * 40 + "b")
