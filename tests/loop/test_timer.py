"""The kernel's timer as the clock of a loop."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from esair.loop._timer import DescriptorTimer


@pytest.mark.real_clock
async def test_an_error_of_what_it_calls_is_told_whatever_its_class() -> None:
    """The timer itself meets the same error, when it was set again in the meantime."""
    loop = asyncio.get_running_loop()
    told: asyncio.Future[dict[str, Any]] = loop.create_future()
    loop.set_exception_handler(lambda _, context: told.set_result(context))

    def busy() -> None:
        raise BlockingIOError("a driver's")

    timer = DescriptorTimer(loop, busy)
    try:
        timer.set(1)
        context = await asyncio.wait_for(told, 10.0)
    finally:
        timer.close()
        loop.set_exception_handler(None)
    assert str(context["exception"]) == "a driver's"
