"""What a step looks at is fetched before it, and is kept by nobody after it."""

from __future__ import annotations

import asyncio
import weakref

import pytest

from esair.loop import Scheduler, ignore


class Part:
    """Something that a step looks at."""


@pytest.mark.virtual_clock
async def test_a_stopped_job_keeps_nothing_that_its_step_looked_at() -> None:
    scheduler = Scheduler.of(asyncio.get_running_loop())
    stays = scheduler.every(0.01, ignore, name="stays")
    goes = scheduler.every(0.01, ignore, name="goes")
    part = Part()
    seen = weakref.ref(part)
    goes.near = (part,)
    del part
    await asyncio.sleep(0.05)
    assert seen() is not None

    goes.stop()

    assert seen() is None
    stays.stop()
