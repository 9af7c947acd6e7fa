"""The queue takes the user's commands one at a time."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest
from tests.supervisors.actors import seeds

import esair
from esair.supervisors._command_queue import LIMIT, CommandQueue

pytestmark = pytest.mark.virtual_clock


def opened() -> CommandQueue:
    queue = CommandQueue("queue")
    queue.initialized()
    return queue


def work(log: list[Any], number: int, seconds: float = 1.0) -> Any:
    async def do() -> int:
        log.append(("begin", number))
        await asyncio.sleep(seconds)
        log.append(("end", number))
        return number

    return do


async def begin(
    queue: CommandQueue, log: list[Any], number: int, **options: Any
) -> Any:
    task = asyncio.ensure_future(
        queue.run(work(log, number), name=f"work {number}", undo=False, **options)
    )
    await asyncio.sleep(0)
    return task


@pytest.mark.promise("SUP-1")
@pytest.mark.fault("L08")
async def test_commands_are_done_in_order_one_at_a_time() -> None:
    """A command that comes while another is handled waits, and is not lost."""
    queue, log = opened(), list[Any]()
    tasks = [await begin(queue, log, n) for n in range(3)]
    assert queue.phase.value == "handling a request"

    assert await asyncio.gather(*tasks) == [0, 1, 2]
    assert log == [(what, n) for n in range(3) for what in ("begin", "end")]
    assert queue.phase is esair.SupervisorPhase.WAIT_REQUEST


@pytest.mark.promise("SUP-1")
async def test_commands_wait_for_the_end_of_the_initialization() -> None:
    """Nothing is handled before the configuration list is deployed."""
    queue, log = CommandQueue("queue"), list[Any]()
    task = await begin(queue, log, 1)
    await asyncio.sleep(5.0)
    assert log == []
    assert queue.phase is esair.SupervisorPhase.INITIALIZING

    queue.initialized()
    assert await task == 1


@pytest.mark.promise("SUP-1")
async def test_waiting_commands_are_bounded() -> None:
    """One more than the bound is refused, those that wait are done."""
    queue, log = CommandQueue("queue"), list[Any]()
    tasks = [await begin(queue, log, n) for n in range(LIMIT)]
    with pytest.raises(esair.BusyError, match="256"):
        await queue.run(work(log, 999), name="one more", undo=False)

    queue.initialized()
    assert await asyncio.gather(*tasks) == list(range(LIMIT))


@pytest.mark.promise("SUP-1")
async def test_an_error_of_a_command_is_its_callers_only() -> None:
    """The next command is done as usual."""
    queue = opened()

    async def fails() -> None:
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        await queue.run(fails, name="fails", undo=False)
    assert await queue.run(work([], 2), name="works", undo=False) == 2


@pytest.mark.fault("X01", "X07")
@pytest.mark.parametrize("seed", seeds)
async def test_a_cancelled_waiting_command_is_never_done(seed: int) -> None:
    """Whoever waits behind it gets the turn."""
    queue, log = opened(), list[Any]()
    tasks = [await begin(queue, log, n) for n in range(3)]
    tasks[1].cancel()

    await asyncio.wait(tasks)
    assert (tasks[0].result(), tasks[2].result()) == (0, 2)
    assert tasks[1].cancelled()
    assert ("begin", 1) not in log


@pytest.mark.fault("X02", "X07")
async def test_a_turn_that_comes_in_the_tick_of_a_cancellation_is_passed_on() -> None:
    """The turn is not lost with the caller."""
    queue, log = CommandQueue("queue"), list[Any]()
    first, second = await begin(queue, log, 1), await begin(queue, log, 2)
    queue.initialized()
    first.cancel()

    assert await second == 2
    assert first.cancelled()
    assert ("begin", 1) not in log
    assert queue.phase is esair.SupervisorPhase.WAIT_REQUEST


@pytest.mark.fault("X01")
async def test_a_command_is_finished_without_its_caller() -> None:
    """Cancelling the caller does not leave a command half done."""
    queue, log = opened(), list[Any]()
    task = await begin(queue, log, 1)
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait({task})
    assert log == [("begin", 1)]
    assert task.cancelled()

    assert await queue.run(work(log, 2), name="next", undo=False) == 2
    assert log[:3] == [("begin", 1), ("end", 1), ("begin", 2)]


@pytest.mark.fault("X01", "X03")
async def test_a_cancelled_caller_undoes_what_can_be_undone() -> None:
    """The caller waits for the undoing; a second cancel lets it go on alone."""
    queue, log = opened(), list[Any]()

    async def undoable() -> None:
        try:
            await asyncio.sleep(1.0)
        finally:
            await asyncio.sleep(1.0)
            log.append("undone")

    for twice in (False, True):
        task = asyncio.ensure_future(queue.run(undoable, name="undoable", undo=True))
        await asyncio.sleep(0.5)
        task.cancel()
        await asyncio.sleep(0.1)
        if twice:
            task.cancel()
        await asyncio.wait({task})
        assert task.cancelled()
        assert len(log) == (1 if twice else twice + 1)
    await asyncio.sleep(2.0)
    assert log == ["undone", "undone"]


async def test_a_command_past_its_point_of_no_return_is_finished() -> None:
    """What can no longer be undone is done in spite of a cancelled caller."""
    queue, log = opened(), list[Any]()

    async def half() -> None:
        await asyncio.sleep(1.0)
        queue.no_return()
        await asyncio.sleep(1.0)
        log.append("done")

    task = asyncio.ensure_future(queue.run(half, name="half", undo=True))
    await asyncio.sleep(1.5)
    task.cancel()
    await asyncio.wait({task})
    await asyncio.sleep(1.0)

    assert task.cancelled()
    assert log == ["done"]


@pytest.mark.promise("SUP-1")
@pytest.mark.fault("M20")
async def test_closing_ends_what_runs_and_refuses_the_rest() -> None:
    """Every command, running or waiting, ends with StoppingError."""
    queue, log = opened(), list[Any]()
    tasks = [await begin(queue, log, n) for n in range(3)]
    await asyncio.sleep(0.1)
    await queue.close()

    results = await asyncio.gather(*tasks, return_exceptions=True)
    assert [type(result) for result in results] == [esair.StoppingError] * 3
    assert queue.phase is esair.SupervisorPhase.STOPPED
    with pytest.raises(esair.StoppingError, match="queue"):
        await queue.run(work(log, 4), name="late", undo=False)
    assert log == [("begin", 0)]


async def test_closing_in_the_tick_of_a_turn_does_not_begin_the_command() -> None:
    """A turn that was given is void once the queue is closed."""
    queue, log = CommandQueue("queue"), list[Any]()
    task = await begin(queue, log, 1)
    queue.initialized()
    await queue.close()
    with pytest.raises(esair.StoppingError):
        await task
    assert log == []


@pytest.mark.fault("X02")
async def test_closing_and_cancelling_at_once_is_a_cancellation() -> None:
    """A caller that was cancelled is told so, whatever else happens."""
    queue, log = opened(), list[Any]()
    task = await begin(queue, log, 1)
    await asyncio.sleep(0.1)
    closing = asyncio.ensure_future(queue.close())
    await asyncio.sleep(0)
    task.cancel()
    await closing
    await asyncio.wait({task})
    assert task.cancelled()


async def test_a_cancelled_wait_in_a_closed_desk_ends_cancelled() -> None:
    """Closing a queue and cancelling a waiting caller at once is no error."""
    queue, log = CommandQueue("queue"), list[Any]()
    task = await begin(queue, log, 1)
    await queue.close()
    task.cancel()
    await asyncio.wait({task})
    assert task.cancelled()


@pytest.mark.parametrize("closing", [True, False])
async def test_a_caller_cancelled_in_the_tick_of_its_turn_is_left_out(
    closing: bool,
) -> None:
    """Neither the next turn nor the end of the queue waits for it."""
    queue, log = CommandQueue("queue"), list[Any]()
    first, second = await begin(queue, log, 1), await begin(queue, log, 2)
    first.cancel()
    if closing:
        await queue.close()
        with pytest.raises(esair.StoppingError):
            await second
    else:
        queue.initialized()
        assert await second == 2
    assert first.cancelled()
    assert ("begin", 1) not in log


@pytest.mark.parametrize("seconds", [0.5, 2.0])
async def test_what_lasts_has_until_its_deadline(seconds: float) -> None:
    """What is taken away is waited for when all is closed, and then given up."""
    queue, log = opened(), list[Any]()
    do = work(log, 1, seconds)
    task = asyncio.ensure_future(queue.run(do, name="removal", undo=False, lasts=True))
    await asyncio.sleep(0.0)
    await queue.close()
    began = asyncio.get_running_loop().time()
    (left,) = queue.left(began + 1.0)
    await left
    assert asyncio.get_running_loop().time() == pytest.approx(began + min(seconds, 1.0))
    with contextlib.suppress(esair.StoppingError):
        assert await task == 1
    assert (("end", 1) in log) == (seconds < 1.0)
    assert queue.left(began + 1.0) == []


@pytest.mark.promise("SUP-1")
async def test_whoever_waits_behind_what_lasts_hears_of_the_end_at_once() -> None:
    """It is not kept waiting until that is over."""
    queue, log = opened(), list[Any]()
    lasts = await begin(queue, log, 1, lasts=True)
    waits = await begin(queue, log, 2)
    queue.refuse()
    async with asyncio.timeout(0.1):
        with pytest.raises(esair.StoppingError):
            await waits
    assert await lasts == 1
