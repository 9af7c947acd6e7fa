"""Task groups and cancel scopes of anyio work in behaviors and beside a robot."""

from __future__ import annotations

import asyncio
import functools
import sys
from collections.abc import Callable
from typing import Any

import anyio
import anyio.abc
import pytest

import esair
from esair.loop import TurnLoop

HOW = (
    ["plain"] if sys.version_info < (3, 12) else ["plain", "eager", "eager of its own"]
)


def eager(how: str) -> Any:
    """Return a task factory; what a host does with eager tasks."""
    if how == "eager":
        return asyncio.eager_task_factory  # type: ignore[attr-defined]
    make_factory = asyncio.create_eager_task_factory  # type: ignore[attr-defined]
    return make_factory(functools.partial(asyncio.Task))


@pytest.fixture(params=HOW)
def new_loop(request: Any) -> Callable[[], asyncio.AbstractEventLoop]:
    """What makes the loop that ships, with eager tasks or without."""

    def make() -> asyncio.AbstractEventLoop:
        loop = TurnLoop()
        if request.param != "plain":
            loop.set_task_factory(eager(request.param))
        return loop

    return make


async def use_everything(log: list[str]) -> None:
    """What people do with anyio: scopes in tasks of a group, start, and an error."""

    async def scoped(name: str, seconds: float) -> None:
        with anyio.move_on_after(0.02) as scope:
            await anyio.sleep(seconds)
        log.append(f"{name} {'late' if scope.cancelled_caught else 'in time'}")

    async def serve(
        *, task_status: anyio.abc.TaskStatus[str] = anyio.TASK_STATUS_IGNORED
    ) -> None:
        try:
            task_status.started("serving")
            await anyio.sleep_forever()
        finally:
            log.append("served")

    async with anyio.create_task_group() as group:
        group.start_soon(scoped, "none", 0.0)
        group.start_soon(scoped, "some", 0.001)
        group.start_soon(scoped, "long", 10.0)
        log.append(await group.start(serve))
        await anyio.sleep(0.05)
        group.cancel_scope.cancel()
    try:
        async with anyio.create_task_group() as group:
            group.start_soon(anyio.sleep_forever)
            group.start_soon(anyio.sleep, -1.0)
            raise ValueError("the group's own")
    except* ValueError:
        log.append("ended by an error")


EXPECTED = ["ended by an error", "long late", "none in time", "served", "serving",
            "some in time"]  # fmt: skip


@pytest.mark.promise("ROB-5")
@pytest.mark.fault("X10")
def test_task_groups_work_in_a_behavior(new_loop: Any) -> None:
    """In its own task, and in a task that it has started."""
    logs: list[list[str]] = [[], []]

    class Groups(esair.Behavior):
        async def run(self) -> None:
            await use_everything(logs[0])
            await asyncio.ensure_future(use_everything(logs[1]))

    esair.run(esair.Robot(behaviors=[Groups()]), loop_factory=new_loop)
    assert [sorted(log) for log in logs] == [EXPECTED, EXPECTED]


@pytest.mark.promise("ROB-5")
@pytest.mark.fault("X10")
def test_task_groups_work_beside_a_robot(new_loop: Any) -> None:
    """In the code of the user that has started it, and in tasks of that."""
    logs: list[list[str]] = [[], []]

    async def main() -> None:
        async with esair.Robot():
            await use_everything(logs[0])
            async with asyncio.TaskGroup() as group:
                group.create_task(use_everything(logs[1]))

    with asyncio.Runner(loop_factory=new_loop) as runner:
        runner.run(main())
    assert [sorted(log) for log in logs] == [EXPECTED, EXPECTED]


@pytest.mark.promise("ROB-5", "SUP-3")
def test_tasks_of_a_group_end_with_their_behavior(new_loop: Any) -> None:
    """What anyio has started in a component belongs to it."""
    ended: list[str] = []

    async def child() -> None:
        try:
            await anyio.sleep_forever()
        finally:
            ended.append("child")

    class Groups(esair.Behavior):
        async def run(self) -> None:
            async with anyio.create_task_group() as group:
                group.start_soon(child)
                group.start_soon(child)

    async def main() -> None:
        async with esair.Robot(behaviors=[Groups()]) as robot:
            await asyncio.sleep(0.05)
            await robot.behaviors.remove("groups")
            assert ended == ["child", "child"]
            assert robot.behaviors.names() == []

    with asyncio.Runner(loop_factory=new_loop) as runner:
        runner.run(main())


@pytest.mark.promise("ROB-5")
def test_the_eager_factory_from_before_is_put_back(new_loop: Any) -> None:
    """The same object; tasks of the host are eager while a robot runs too."""

    async def main() -> None:
        loop = asyncio.get_running_loop()
        before, log = loop.get_task_factory(), list[str]()

        async def work() -> None:
            log.append("begun")

        async with esair.Robot():
            task = asyncio.ensure_future(work())
            log.append("made")
            await task
        assert log == (["made", "begun"] if before is None else ["begun", "made"])
        assert loop.get_task_factory() is before

    with asyncio.Runner(loop_factory=new_loop) as runner:
        runner.run(main())
