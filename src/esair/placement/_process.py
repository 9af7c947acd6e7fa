"""One child as the robot sees it: it is told something, and answers when it is idle again.

The two take turns. A message lets the child work until nothing in it is ready; then one
message comes back with all that it has done, and when it wants to go on. So what a child
does follows from its messages, and "silent, and not idle" is how a hang is seen.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import math
import os
import select
import signal
import socket
import threading
from collections.abc import Callable
from typing import Any, Final

from esair.codec import CodecError
from esair.exceptions import BadValueError, BusyError, ProcessDiedError
from esair.loop import Deadlines, Door, First, OneShot, Player, Scheduler, clock_of
from esair.messages import Placement
from esair.placement._nursery import Nursery, told_end
from esair.placement._wire import CALLS, Item, Values, Wire
from esair.placement._words import Words

STACK: Final = 0.05
"""How long a child that hangs has to say where, before it is killed, in seconds."""

End = Callable[[Any, BaseException | None], object]


class Process:
    """One child, from its start to its end.

    Args:
        values: How its values are coded.
        placement: How it is limited.
        nursery: Where it comes from.
        repeats: Whether it runs in a replay, too; what drivers give comes from the tape.
        serve: Called with each call of the child: its number, verb and arguments.
        withdraw: Called with the number of a call that the child wants no more.
        died: Called with the error, once, if it ends before it is closed.
    """

    def __init__(
        self,
        values: Values,
        placement: Placement,
        nursery: Nursery,
        *,
        repeats: bool,
        serve: Callable[[int, str, Any], object],
        withdraw: Callable[[int], object],
        died: Callable[[ProcessDiedError], object],
    ) -> None:
        self.values = values
        self.name: str = values.name
        self.pid: int | None = None
        self.error: ProcessDiedError | None = None
        """Why it is gone; None while it lives."""
        self.scopes: dict[int, contextvars.Context] = {}
        """For whom the child works, by the number of the call that it works for."""
        self.sent: float = 0.0  # when the message was sent that it works on
        self._serve, self._withdraw, self._died = serve, withdraw, died
        self._loop = loop = asyncio.get_running_loop()
        self._time = clock_of(loop)
        self._door = Door.of(loop)
        self._repeats = repeats
        self._tag = ("thread" if repeats else "driver", self.name)
        self._lane = object()
        self._calls: dict[int, End] = {}
        self._told_to_end: set[int] = set()
        self._is_empty = False  # nothing could be made in it
        self._number = 0
        self._queue: list[Item] = []
        self._work = 0  # the number that the door has given to what it works on
        self._idle = True
        self._ticks = 0
        self._wake: OneShot | None = None
        self._wanted: float | None = None
        self._pidfd = -1
        self._stall = placement.stall
        self._hang = Deadlines.beside(loop).idle(self._hung)
        ends = nursery.child()
        self._wire = Wire(ends.wire)
        self._words = Words(self.name, ends.words, loop)
        self._status = ends.status
        self._tape(loop)
        tape = self._door.tape
        self._is_repeated = isinstance(tape, Player)
        if not self._is_repeated:
            loop.add_reader(self._wire.fileno(), self._readable)
            loop.add_reader(self._status.fileno(), self._told)
        else:  # it waits for what is on its tape, and not in its selector
            threading.Thread(target=self._read_on, daemon=True).start()

    # What the robot asks of it.

    def call(self, verb: str, args: tuple[Any, ...], end: End, **options: Any) -> int:
        """Call something in the child; its end comes to a function.

        Returns:
            The number of the call, for `cancel`.

        Raises:
            ProcessDiedError: It is gone.
            BadValueError: The arguments cannot cross.
            BusyError: Too many calls are in flight.
        """
        if self.error is not None:
            raise self.error.with_traceback(None)
        if len(self._calls) >= CALLS:
            raise BusyError(self.name, "number of calls of its process", CALLS)
        data = self.values.pack(verb, (args, options))
        self._number += 1
        self._calls[self._number] = end
        self.scopes[self._number] = contextvars.copy_context()
        self.tell(Item("call", self._number, verb, data))
        return self._number

    async def run(self, verb: str, *args: Any, **options: Any) -> Any:
        """Call something in the child and wait for its end.

        Who is cancelled here cancels it there, and waits for what it does then; who is
        cancelled again does not.
        """
        waiter: asyncio.Future[Any] = self._loop.create_future()

        def end(value: Any, error: BaseException | None) -> None:
            if waiter.done():
                return
            if error is None:
                waiter.set_result(value)
            elif isinstance(error, asyncio.CancelledError):
                waiter.cancel()
            else:
                waiter.set_exception(error)

        number = self.call(verb, args, end, **options)
        try:
            return await waiter
        except asyncio.CancelledError:
            if number not in self._calls:
                raise
            waiter = self._loop.create_future()
            self._told_to_end.add(number)
            self.tell(Item("cancel", number, "", b""))
            try:
                return await waiter
            finally:
                if not waiter.done() or waiter.cancelled():
                    self._calls.pop(number, None)

    def answer(self, number: int, value: Any, error: BaseException | None) -> None:
        """Tell the child the end of a call of its own."""
        if error is None:
            try:
                self.tell(Item("done", number, "", self.values.pack("answer", value)))
                return
            except Exception as unfit:
                error = unfit
        self.tell(Item("fail", number, "", self.values.pack_error(error)))

    def tell(self, item: Item) -> None:
        """Send something as soon as it is the child's turn to hear."""
        if self.error is None:
            self._queue.append(item)
            self._send()

    def refuse(self, error: BaseException) -> None:
        """Let an error be the end of every call: there is no component."""
        self._is_empty = True
        calls, self._calls = self._calls, {}
        for end in calls.values():
            end(None, error)

    def lateness(self, busy: float) -> float:
        """Return how long ago the child has done what takes effect now, in seconds."""
        return self._time() - self.sent - busy

    @property
    def is_well(self) -> bool:
        """Whether it lives, and has ended what it was told to end."""
        return self.error is None and not (self._told_to_end or self._is_empty)

    def close(self) -> None:
        """Be done with it, without a wait: it is killed if it works, and else ends."""
        if self.error is None:
            self.error = ProcessDiedError(self.name, "was ended")
            if self._work:
                self._kill()
            self._let_go()

    # Turns.

    def _send(self) -> None:
        if self._idle and self.error is None:
            self._idle = False
            if self._wake is not None:
                Scheduler.of(self._loop).cancel(self._wake)
                self._wake = None
            self._door.give_out(self._begin, self._lane)  # type: ignore[arg-type]

    def _begin(self, work: int) -> None:
        self._work, self._ticks = work, 0
        items, self._queue = self._queue, []
        self.sent = now = self._time()
        if self._wanted is not None and self._wanted - now < 1e-4:
            now = max(now, self._wanted)  # a timer may ring a hair early
        self._hang.start_by(self._time() + self._stall)
        if self.error is not None:  # it has died meanwhile
            self._end_work()
            return
        try:
            self._wire.send(now, items)
        except OSError:  # it is gone: its status tells more
            return

    def _readable(self) -> None:
        while self.error is None:
            try:
                message = self._wire.receive()
            except BlockingIOError:
                return
            except ConnectionError:  # it died with something unread
                message = None
            except Exception as error:
                self.condemn(f"has sent what is no message: {error}")
                return
            if message is None:
                self._loop.remove_reader(self._wire.fileno())
                return  # its status tells more
            self._arrived(message)

    def _read_on(self) -> None:
        waits = select.poll()
        waits.register(self._wire.fileno(), select.POLLIN)
        while self.error is None and waits.poll():
            try:
                message = self._wire.receive()
            except (OSError, CodecError):
                return
            if message is None:
                return
            self._arrived(message)

    def _arrived(self, message: tuple[Any, list[Item]]) -> None:
        match message:
            case ("tick", _), []:
                self._ticks += 1
                if self._ticks > 2:
                    self.condemn("has spoken out of turn")
                else:
                    self._door.post(0, self._tag, self._ticked)
                return
            case (("idle" | "sync"), (None | float() as wake)), _ if self._work and (
                wake is None or math.isfinite(wake)
            ):
                work, self._work = self._work, 0
                self._door.post(work, self._tag, self._came, *message)
                return
        self.condemn("has spoken out of turn")

    def _ticked(self) -> None:
        """It has heard of something by a way of its own: tell it the time."""
        tape = self._door.tape
        if tape is not None and not isinstance(tape, Player):
            tape.spoil(
                f"the process of {self.name} has descriptors or threads of its own"
            )
        self._send()

    def _came(self, head: Any, items: list[Item]) -> None:
        """A message of the child takes effect."""
        if self.error is not None:
            return
        self._hang.cancel()
        wake = head[1]
        for item in items:
            try:
                self._apply(item)
            except Exception as error:
                self.condemn(f"has sent what is no value: {error}")
            if self.error is not None:
                return
        self._idle = True
        if self._queue or head[0] == "sync":
            self._send()
        elif wake is not None:
            self._wanted = wake
            self._wake = Scheduler.of(self._loop).at(wake, self._woken)

    def _woken(self, _now: float) -> None:
        self._wake = None
        self._send()

    def _apply(self, item: Item) -> None:
        op, number, verb, data = item
        if op == "call":
            try:
                args = self.values.unpack(data)
            except CodecError as error:
                self.answer(number, None, BadValueError(self.name, verb, str(error)))
            else:
                self._serve(number, verb, args)
        elif op == "cancel":
            self._withdraw(number)
        elif op not in {"done", "fail"}:
            self.condemn("has sent what is no message")
        else:
            end = self._calls.pop(number, None)
            self._told_to_end.discard(number)
            self.scopes.pop(number, None)
            value: Any = None
            failed: BaseException | None = None
            try:
                if op == "done":
                    value = self.values.unpack(data)
                else:
                    failed = self.values.unpack_error(data)
            except CodecError as error:
                failed = BadValueError(self.name, verb or "answer", str(error))
            if end is not None:
                end(value, failed)

    # Its end.

    def _told(self) -> None:
        try:
            data, files, _, _ = socket.recv_fds(self._status, 256, 1)
        except BlockingIOError:
            return
        except OSError:
            data, files = b"", []
        what, _, rest = data.partition(b" ")
        if what == b"pid":
            self.pid, self._pidfd = int(rest), files[0]
            return
        self._readable()  # what it has done before
        code = int(rest) if what == b"over" else None
        how = told_end(code) if what != b"failed" else f"did not start: {rest.decode()}"
        self._gone(how, code)

    def _hung(self) -> None:
        """It is silent, and not idle."""
        if self._idle or self.error is not None:
            return
        self._signal(signal.SIGUSR1)  # says where it is
        self._loop.call_later(STACK, self.condemn, f"hung for {self._stall:g} s")

    def condemn(self, how: str) -> None:
        """It cannot be used any more, whatever it does."""
        if self.error is None:
            self._kill()
            self._gone(f"{how}; it was killed", -signal.SIGKILL)

    def _gone(self, how: str, code: int | None) -> None:
        error = ProcessDiedError(self.name, how, code, self._words.last())
        self._door.post(0, ("process", self.name), self._over, error)

    def _over(self, error: ProcessDiedError) -> None:
        if self.error is not None:
            return
        if self._keeps is not None:
            self._keeps(error)
        self.error = error
        self._let_go()
        calls, self._calls = self._calls, {}
        for end in calls.values():
            end(None, error.with_traceback(None))
        self._died(error)

    def _tape(self, loop: asyncio.AbstractEventLoop) -> None:
        """Keep its end where a run is kept; in a replay it comes from the tape."""
        tag, tape = ("call", self.name, "process"), self._door.tape
        self._keeps: Callable[[ProcessDiedError], object] | None = None
        if not self._repeats:
            return
        if isinstance(tape, Player):
            number, _ = tape.first(tag)
            tape.expect(tag, number, self._repeated_end)
        elif tape is not None:
            number = tape.first(tag, First(waits=True, value=None, error=None))
            self._keeps = lambda error: tape.arrived(tag, (None, error), number=number)

    def _repeated_end(self, end: tuple[Any, BaseException | None]) -> None:
        if isinstance(end[1], ProcessDiedError):
            self._over(end[1])

    def _signal(self, number: int) -> None:
        if self._pidfd >= 0:
            with contextlib.suppress(OSError):
                signal.pidfd_send_signal(self._pidfd, number)

    def _kill(self) -> None:
        self._signal(signal.SIGKILL)

    def _end_work(self) -> None:
        work, self._work = self._work, 0
        if work:
            self._door.post(work, self._tag, _nothing)

    def _let_go(self) -> None:
        self._hang.cancel()
        if self._wake is not None:
            Scheduler.of(self._loop).cancel(self._wake)
            self._wake = None
        self._end_work()
        loop = self._loop
        if not loop.is_closed():
            loop.remove_reader(self._wire.fileno())
            loop.remove_reader(self._status.fileno())
        self._wire.close()
        self._status.close()
        self._words.close()
        if self._pidfd >= 0:
            os.close(self._pidfd)
            self._pidfd = -1


def _nothing() -> None:
    """Come after what was done before."""
