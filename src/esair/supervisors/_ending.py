"""How the tasks of a component are ended that would rather not."""

from __future__ import annotations

import asyncio
from typing import Any

from esair.exceptions import BehaviorRemovedError, EsairError, NotRegisteredError
from esair.loop import Owner, look_at

_SECOND = 0.04
"""How long a task may take that has swallowed its cancellation, in seconds."""


def living(owner: Owner) -> list[asyncio.Task[Any]]:
    """Return the tasks of an owner that have not ended, without the one that asks."""
    me = asyncio.current_task()
    return [task for task in owner.living() if task is not me]


async def until_ended(tasks: list[asyncio.Task[Any]], grace: float) -> None:
    """Wait for tasks that were cancelled, if there are any."""
    if tasks:
        await asyncio.wait(tasks, timeout=grace if grace > 0 else 0.001)


def cancel(owner: Owner) -> None:
    """Cancel the tasks of an owner, without waiting; those that were, not again."""
    left = owner.living()
    for task in left:
        if task not in owner.told:
            task.cancel()
    owner.told = left


async def end(owner: Owner, grace: float) -> list[asyncio.Task[Any]]:
    """Cancel the tasks of an owner, twice if need be; returns those that would not end.

    What was cancelled before this is cleaning up: it is left alone until its grace is over.
    """
    told, left = owner.told, living(owner)
    for seconds in (grace, _SECOND):
        for task in left:
            if task not in told:
                task.cancel()
        owner.told, told = left, []
        await until_ended(left, seconds)
        left = living(owner)
    for task in left:
        task.add_done_callback(look_at)
    return left


class UserRemovedError(BehaviorRemovedError, NotRegisteredError):
    """A behavior that was removed uses a port of its: both is true."""

    def __init__(self, behavior: str) -> None:
        EsairError.__init__(
            self, f"behavior {behavior!r} was removed: it is registered for nothing"
        )
        self.behavior = behavior
        self.resource = ""
        self.data = None
