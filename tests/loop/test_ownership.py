"""Tasks belong to the component in whose context they were started."""

from __future__ import annotations

import asyncio
import sys
from typing import Any

import pytest

from esair.loop import OwnedTasks, Owner, spawn

pytestmark = pytest.mark.virtual_clock


async def for_ever() -> None:
    await asyncio.get_running_loop().create_future()


@pytest.mark.fault("B12")
async def test_an_owner_knows_the_tasks_of_its_tasks() -> None:
    """Also those that a task of a task has started."""
    loop = asyncio.get_running_loop()
    owned, owner = OwnedTasks.of(loop), Owner()
    owned.install()

    async def child() -> None:
        asyncio.ensure_future(for_ever()).set_name("grandchild")

    async def parent() -> None:
        asyncio.ensure_future(child()).set_name("child")
        await for_ever()

    spawn(loop, parent(), name="parent", owner=owner)
    stranger = spawn(loop, for_ever(), name="stranger")
    await asyncio.sleep(0.01)
    living = owner.living()
    assert [task.get_name() for task in living] == ["grandchild", "parent"]
    for task in (*living, stranger):
        task.cancel()
    await asyncio.wait([*living, stranger])
    assert owner.living() == []
    owned.uninstall()
    assert loop.get_task_factory() is None


async def test_the_factory_from_before_is_used_and_put_back() -> None:
    """A robot does not take the loop away from its host."""
    loop = asyncio.get_running_loop()
    made: list[str] = []

    def factory(loop: Any, coroutine: Any, **options: Any) -> Any:
        made.append("made")
        return asyncio.Task(coroutine, loop=loop, **options)

    loop.set_task_factory(factory)
    owned = OwnedTasks.of(loop)
    owned.install()
    await asyncio.ensure_future(asyncio.sleep(0))
    assert made == ["made"]
    owned.uninstall()
    assert loop.get_task_factory() is factory
    owned.install()
    loop.set_task_factory(None)
    owned.uninstall()
    assert loop.get_task_factory() is None


@pytest.mark.skipif(sys.version_info < (3, 12), reason="eager tasks came with 3.12")
@pytest.mark.fault("X10")
async def test_own_tasks_never_begin_before_they_are_known() -> None:
    """Even with eager tasks nothing runs before spawn has returned."""
    loop = asyncio.get_running_loop()
    loop.set_task_factory(asyncio.eager_task_factory)  # type: ignore[attr-defined]
    log: list[str] = []

    async def work() -> None:
        log.append("begun")

    task = spawn(loop, work(), name="work")
    log.append("spawned")
    await task
    assert log == ["spawned", "begun"]
