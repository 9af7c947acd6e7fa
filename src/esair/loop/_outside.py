"""What a robot asks of the world beside its drivers: kept, and answered from the tape."""

from __future__ import annotations

import asyncio
import contextvars
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from esair.loop._door import Door
from esair.loop._futures import settle
from esair.loop._ownership import Contained
from esair.loop._tape import WAITS, First, Player, Tag, TapeWriter

T = TypeVar("T")


def ask_outside(tag: Tag, look: Callable[[], T]) -> T:
    """Look at something outside of the robot, now; a replay does not look."""
    tape = Door.of(asyncio.get_running_loop()).tape
    if isinstance(tape, Player):
        _, first = tape.first(tag)
        if not tape.is_over:
            value: T = first.value
            return value
    value = look()
    if isinstance(tape, TapeWriter):
        tape.first(tag, First(waits=False, value=value, error=None))
    return value


async def outside(tag: Tag, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
    """Await work outside of the robot; in a replay only its outcome comes again.

    The outcome takes effect at the border of a turn.
    """
    loop = asyncio.get_running_loop()
    door = Door.of(loop)
    tape = door.tape
    outcome: asyncio.Future[T] = loop.create_future()
    number = 0

    def over(end: tuple[Any, BaseException | None]) -> None:
        if isinstance(tape, TapeWriter):
            tape.arrived(tag, end, number=number)
        value, error = end
        is_over = isinstance(tape, Player) and tape.is_over
        settle(outcome, value, None if is_over else error)

    if isinstance(tape, Player):
        if tape.is_over:  # the robot stops: nothing outside is left that could fail
            await asyncio.sleep(0)
            return None  # type: ignore[return-value]
        number, _ = tape.first(tag)
        tape.expect(tag, number, over)
        return await outcome
    if isinstance(tape, TapeWriter):
        number = tape.first(tag, WAITS)
    # A context of nobody: what it starts is no part of the robot.
    task = asyncio.Task(
        Contained(work()), loop=loop, name=" ".join(tag), context=contextvars.Context()
    )
    task.add_done_callback(lambda done: door.end(tag, over, _end_of(done)))
    try:
        return await outcome
    except asyncio.CancelledError:
        task.cancel()
        raise


def _end_of(task: asyncio.Task[Any]) -> tuple[Any, BaseException | None]:
    if task.cancelled():
        return None, asyncio.CancelledError()
    error = task.exception()
    return (None, error) if error is not None else (task.result(), None)


class News:
    """What is told from outside, in the loop or in a thread: kept, and told again."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, tag: Tag, function: Callable[..., object]
    ) -> None:
        self._home = threading.get_ident()
        self._door = Door.of(loop)
        self._tag = tag
        self._function = function
        if self._door.player is not None:
            self._door.player.listen(tag, lambda told: function(*told))

    def tell(self, *told: Any) -> None:
        """Tell it, in any thread; it takes effect at the border of a turn."""
        in_loop = threading.get_ident() == self._home
        bring = self._door.end if in_loop else self._door.tell
        bring(self._tag, self._take, told)

    def _take(self, told: tuple[Any, ...]) -> None:
        if isinstance(self._door.tape, TapeWriter):
            self._door.tape.arrived(self._tag, told)
        self._function(*told)
