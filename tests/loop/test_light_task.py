"""A coroutine that is driven by what it waits for, and the libraries that run in it."""

from __future__ import annotations

import asyncio
import contextvars
from collections.abc import Awaitable, Callable
from typing import Any

import anyio
import pytest

from esair.loop import WAITS, Caller, FirstSteps, LightTask

pytestmark = pytest.mark.virtual_clock

Work = Callable[[], Awaitable[Any]]


async def drive(work: Work, *, cancelled_after: float | None = None) -> Any:
    """Run some work in a light task, begun in the task that asks."""
    loop = asyncio.get_running_loop()
    outcome: asyncio.Future[Any] = loop.create_future()
    light = LightTask(loop, "driver")

    async def whole() -> Any:
        return await work()

    value = light.begin(whole())
    if value is not WAITS:
        return value
    light.then(
        lambda value, error: (
            outcome.set_result(value) if error is None else outcome.set_exception(error)
        )
    )
    if cancelled_after is not None:
        loop.call_later(cancelled_after, light.cancel)
    return await outcome


async def test_what_need_not_wait_ends_at_once() -> None:
    """Its result is there when `begin` returns, and the task can be used again."""

    async def quick() -> int:
        return 7

    light = LightTask(asyncio.get_running_loop(), "driver")
    assert [light.begin(quick()), light.begin(quick())] == [7, 7]


async def test_current_task_is_the_light_one_from_the_first_step_on() -> None:
    """And the caller's own again as soon as it has returned."""
    seen: list[object] = []
    me = asyncio.current_task()

    async def look() -> None:
        seen.append(asyncio.current_task())
        await asyncio.sleep(0.1)
        seen.append(asyncio.current_task())

    light = LightTask(asyncio.get_running_loop(), "driver")
    light.then(lambda _value, _error: None)
    assert light.begin(look()) is WAITS
    assert asyncio.current_task() is me
    await asyncio.sleep(0.2)
    assert seen == [light, light]


async def in_timeout() -> str:
    try:
        async with asyncio.timeout(0.1):
            await asyncio.sleep(10.0)
    except TimeoutError:
        await asyncio.sleep(0.0)
        return "timed out"
    return "done"


async def in_group() -> str:
    async def child(seconds: float) -> None:
        await asyncio.sleep(seconds)
        if seconds == 0.2:
            raise LookupError("child")

    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(child(0.2))
            group.create_task(child(5.0))
            await asyncio.sleep(10.0)
    except ExceptionGroup as error:
        return str(error.exceptions[0])
    return "done"


async def in_anyio() -> str:
    with anyio.move_on_after(0.1) as scope:
        async with anyio.create_task_group() as group:
            group.start_soon(anyio.sleep, 10.0)
            await anyio.sleep(10.0)
    await anyio.sleep(0.1)
    return f"cancelled: {scope.cancelled_caught}"


async def in_fail_after() -> str:
    try:
        with anyio.fail_after(0.1):
            await anyio.sleep_forever()
    except TimeoutError:
        return "timed out"
    return "done"


@pytest.mark.promise("CALL-1")
@pytest.mark.parametrize("work", [in_timeout, in_group, in_anyio, in_fail_after])
async def test_what_a_driver_may_use_works_in_it_as_in_a_task(work: Work) -> None:
    """Time-outs, task groups and scopes of anyio: the same as in a task of asyncio."""

    async def plain() -> Any:
        return await work()

    assert await drive(work) == await asyncio.create_task(plain())


@pytest.mark.promise("CALL-1")
@pytest.mark.parametrize("work", [in_timeout, in_group, in_anyio, in_fail_after])
async def test_a_cancellation_passes_through_what_a_driver_uses(work: Work) -> None:
    """It ends the work, as it would end a task."""
    with pytest.raises(asyncio.CancelledError):
        await drive(work, cancelled_after=0.05)


async def test_a_swallowed_cancellation_is_not_repeated() -> None:
    """The work goes on, as the work of a task would."""

    async def deaf() -> str:
        try:
            await asyncio.sleep(10.0)
        except asyncio.CancelledError:
            await asyncio.sleep(1.0)
        return "done"

    assert await drive(deaf, cancelled_after=0.1) == "done"


async def test_it_has_a_context_of_its_own() -> None:
    """What its caller has set is not seen; what it sets stays in it."""
    variable = contextvars.ContextVar("variable", default="nothing")
    variable.set("the caller's")

    async def work() -> list[str]:
        seen = [variable.get()]
        token = variable.set("its own")
        await asyncio.sleep(0.1)
        seen.append(variable.get())
        variable.reset(token)
        return seen

    assert await drive(work) == ["nothing", "its own"]
    assert variable.get() == "the caller's"


async def test_what_waits_for_something_strange_is_told() -> None:
    """As a task does it: the error is raised where it waits."""

    class Strange:
        def __await__(self) -> Any:
            yield "strange"

    async def work() -> None:
        await Strange()

    with pytest.raises(RuntimeError, match="nothing of asyncio"):
        await drive(work)


async def test_each_call_of_a_driver_finds_what_it_looks_at_in_slots() -> None:
    light = LightTask(asyncio.get_running_loop())
    assert not hasattr(light, "__dict__")  # to seek in one takes three times as long


async def test_a_cancellation_between_two_coroutines_is_that_of_neither() -> None:
    """Who has kept the task of a call that has ended cancels nothing by it."""
    kept: list[Any] = []
    caller = Caller("driver")

    async def ends_at_once() -> None:
        kept.append(asyncio.current_task())

    async def waits() -> int:
        await asyncio.sleep(0.1)
        return 7

    steps = FirstSteps.of(asyncio.get_running_loop())
    assert steps.begin(ends_at_once(), caller) is None
    assert not kept[0].cancel()
    outcome: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
    light = steps.begin(waits(), caller)
    assert light is kept[0]
    assert light.cancelling() == 0
    light.then(lambda *end: outcome.set_result(end))
    assert await outcome == (7, None)


async def test_a_light_task_has_the_name_that_it_is_given() -> None:
    """As any task has: a driver may call its own as it likes."""
    loop = asyncio.get_running_loop()

    async def work() -> str:
        task = asyncio.current_task()
        assert task is not None
        task.set_name("polls the bus")
        return task.get_name()

    light = LightTask(loop, "driver")
    light.then(lambda _value, _error: None)
    assert light.begin(work()) == "polls the bus"


async def test_who_ends_itself_is_interrupted_once() -> None:
    """What it awaits to clean up goes on, as in any task."""
    ends: list[str] = []

    async def work() -> str:
        await asyncio.sleep(0.1)
        asyncio.current_task().cancel()  # type: ignore[union-attr]
        try:
            await asyncio.sleep(0)
        except asyncio.CancelledError:
            ends.append("cancelled")
            await asyncio.sleep(0.1)
            await asyncio.sleep(0)
        return "clean"

    assert await drive(work) == "clean"
    assert ends == ["cancelled"]
