"""The event loops on which a turn means the same."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import uvloop

import esair
from esair.testing import VirtualLoop

T = TypeVar("T")

Make = Callable[[], asyncio.AbstractEventLoop]

LOOPS: dict[str, Make] = {
    "asyncio": asyncio.new_event_loop,
    "esair.run": esair.new_event_loop,
    "virtual": VirtualLoop,
    "uvloop": uvloop.new_event_loop,
}


def run(make: Make, main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine on a loop of a kind."""
    with asyncio.Runner(loop_factory=make) as runner:
        return runner.run(main)
