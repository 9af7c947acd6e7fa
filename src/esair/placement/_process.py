"""One child as the robot sees it: it is told something, and answers when it is idle again.

The two take turns. A message lets the child work until nothing in it is ready; then one
message comes back with all that it has done, and when it wants to go on. So what a child
does follows from its messages, and "silent, and not idle" is how a hang is seen.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import functools
import json
import logging
import os
import re
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, Final

from esair.codec import CodecError, Kinds
from esair.connections import stamped
from esair.exceptions import ProcessDiedError, printable
from esair.loop import (
    NEVER,
    REACHED,
    Caller,
    Deadlines,
    Door,
    First,
    FirstSteps,
    OneShot,
    Owner,
    Player,
    Scheduler,
    clock_beside,
    clock_of,
    settle,
    turn_of,
)
from esair.messages import Placement
from esair.placement._nursery import Nursery, end_group, told_end
from esair.placement._wire import RECORD, End, Exchange, Item, Op, Wire

STACK: Final = 0.05
"""How long a child that hangs has to say where, before it is killed, in seconds."""

START: Final = 30.0
"""How long a child may take to be there at all, in seconds."""

LARGE: Final = 1 << 14
"""What has more bytes is opened in a thread: it would hold up the loop for a millisecond."""

KEPT: Final = 1 << 15
"""How many characters of what a child has written last are kept."""

WORDS: Final = 2000
"""How many of them its error has, and how many of its stacks."""

FRAMES: Final = 12
"""How many lines its error has of the stack of each thread, where that is now first."""

_STACK: Final = re.compile(r"^(?:Current t|T)hread 0x.*\n(?:  .*\n)*", re.M)

_TEXT: Final = re.compile(rf'^{RECORD}.*"text": "(.*)"}}$', re.M)  # of a record

LINES: Final = 200
"""How many lines of a child are logged in a second."""

NAMES: Final = 64
"""How many loggers a child may name that nobody else has: they are kept for ever."""

_ENDS: Final = frozenset({Op.IDLE, Op.STILL, Op.TURN, Op.SYNC})  # what ends its work

_log = logging.getLogger("esair")


class Process(Exchange):
    """One child, from its start to its end.

    Args:
        name: Of its component.
        kinds: The classes that may cross.
        placement: How it is limited.
        nursery: Where it comes from.
        owner: Who owns what is done here for the child.
        repeats: Whether it runs in a replay, too; what drivers give comes from the tape.
        serve: Called with each call of the child, and its options and arguments.
        died: Called with the error, once, if it ends before it is closed.
    """

    def __init__(
        self,
        name: str,
        kinds: Kinds,
        placement: Placement,
        nursery: Nursery,
        owner: Owner,
        *,
        repeats: bool,
        serve: Callable[[Item, Any], object],
        died: Callable[[ProcessDiedError], object],
    ) -> None:
        super().__init__(name, kinds, asyncio.get_running_loop(), owner)
        self.pid: int | None = None
        self.error: ProcessDiedError | None = None
        """Why it is gone; None while it lives."""
        self.scopes: dict[int, contextvars.Context] = {}
        """For whom the child works, by the number of the call that it works for."""
        self.nobodys = owner.own(contextvars.Context())
        """For whom it works that works for no call."""
        self.is_still: bool = False
        """Whether nothing in it goes on before one of its calls ends."""
        self.sent = 0.0
        """When the message was sent that it works on."""
        self._serve, self._died = serve, died
        loop = self.loop
        self._time, self._clock = clock_of(loop), clock_beside(loop)
        self._door = Door.of(loop)
        self._tag = self._door.source(name) if repeats else ("driver", name)
        self._steps, self._caller = FirstSteps(loop), Caller(f"the process of {name}")
        self._lane = self._look
        self._told_to_end: set[int] = set()
        self.is_made: bool = False  # its component: its module is imported
        self._is_empty = False  # nothing could be made in it
        self._is_condemned = False
        self._work = 0  # the number that the door has given to what it works on
        self._idle = True
        self._ticks = 0
        self._wake: OneShot | None = None
        self._wanted = 0.0
        self._pidfd = -1
        self._stall = placement.stall
        self._hangs_at = NEVER
        """When what works since is a hang; a reply to what it waits for is no new time."""
        self._hangs_really_at = NEVER
        """The same on the computer's clock, where time does not pass while it works."""
        self._hang = Deadlines.beside(loop).idle(self._hung)
        self._nursery, ends = nursery, nursery.child()
        self._wire = Wire(ends.wire)
        self._words = Words(name, ends.words, loop)
        self._status = ends.status
        self._keeps = self._on_tape() if repeats else None
        if isinstance(self._door.tape, Player):
            # It waits for what is on its tape, and not in its selector.
            threading.Thread(target=self._read_on, daemon=True).start()
        else:
            turn_of(loop).listen(self._wire.fileno(), self._readable)
            loop.add_reader(self._status.fileno(), self._told)

    # What the robot asks of it.

    def call(self, verb: str, args: tuple[Any, ...], end: End, **options: Any) -> int:
        """Call something in the child; its end comes to a function.

        Returns:
            The number of the call.

        Raises:
            ProcessDiedError: It is gone.
            BadValueError: The arguments cannot cross.
            BusyError: Too many calls are in flight.
        """
        if self.error is not None:
            raise self.error.with_traceback(None)
        number = self.ask(end, verb, args, options)
        self.scopes[number] = self.owner.own(contextvars.copy_context())
        return number

    async def run(self, verb: str, *args: Any, **options: Any) -> Any:
        """Call something in the child and wait for its end.

        Who is cancelled here cancels it there, and waits for what it does then; who is
        cancelled again does not.
        """
        waiter: asyncio.Future[Any] = self.loop.create_future()
        number = self.call(verb, args, functools.partial(settle, waiter), **options)
        try:
            return await waiter
        except asyncio.CancelledError:
            if number not in self.calls:
                raise
            waiter = self.loop.create_future()
            self.calls[number] = functools.partial(settle, waiter)
            self._told_to_end.add(number)
            self.tell(Item(Op.CANCEL, number, "", b""))
            try:
                return await waiter
            finally:
                if not waiter.done() or waiter.cancelled():
                    self.calls.pop(number, None)

    def tell(self, item: Item) -> None:
        """Send something as soon as it is the child's turn to hear."""
        if self.error is None:
            self.queue.append(item)
            if self._idle:
                self._send()

    def begin(
        self,
        number: int,
        context: contextvars.Context,
        function: Callable[..., Coroutine[Any, Any, Any]],
        args: Iterable[Any],
        options: dict[str, Any],
    ) -> None:
        """Work on a call of the child, from the first step on."""
        steps, self._caller.context = self._steps, context
        light = self.tasks[number] = steps.spare
        self.owner.adopt(light, leaves=True)
        value: Any = None
        failed: BaseException | None = None
        try:
            value = steps.begin(function(*args, **options), self._caller)
        except BaseException as error:  # told to the child
            failed = error
        over = functools.partial(self.over, number, light)
        if value is light:
            light.then(over)
        else:
            over(value, failed)

    def cancel(self, number: int) -> None:
        """End the work on a call of the child, whose end tells so."""
        if (task := self.tasks.get(number)) is not None:
            task.cancel()

    def refuse(self, error: BaseException) -> None:
        """Let an error be the end of every call: there is no component."""
        self._is_empty = True
        self._end_calls(error)

    def _end_calls(self, error: BaseException) -> None:
        calls, self.calls = self.calls, {}
        for end in calls.values():
            end(None, error)

    @property
    def is_well(self) -> bool:
        """Whether it lives, and has ended what it was told to end."""
        return self.error is None and not (self._told_to_end or self._is_empty)

    def close(self) -> None:
        """Be done with it, without a wait: it is killed if it works, and else ends."""
        if self.error is None:
            self.error = ProcessDiedError(self.name, "was ended")
            if self._work:
                self._signal(signal.SIGKILL)
            self._let_go()
            self._end_calls(self.error)

    # Turns.

    def _send(self) -> None:
        if self._idle and self.error is None:
            self._idle = False
            self._forget_wake()
            self._door.give_out(self._begin, self._lane)  # type: ignore[arg-type]

    def _begin(self, work: int) -> None:
        self._work, self._ticks = work, 0
        self.is_still = False
        self.sent = now = self._time()
        if 0.0 < self._wanted - now < 1e-6:
            now = self._wanted  # a timer may ring a hair early
        if self._hangs_at == NEVER:
            self._hangs_at = self.sent + (self._stall if self.pid else START)
            if self._hang.when == NEVER:
                self._hang.start(self._hangs_at)
        if self.error is not None:  # it has died meanwhile
            self._end_work()
            return
        try:
            self._wire.send(Op.GO, now, self.message())
        except ConnectionError:
            return  # it is gone: its status tells more
        except OSError as error:
            self.condemn(f"could not be told: {error}")

    def _readable(self) -> None:
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
            turn_of(self.loop).forget(self._wire.fileno())
            return  # its status tells more
        self._arrived(*message)

    def _read_on(self) -> None:
        waits = select.poll()
        waits.register(self._wire.fileno(), select.POLLIN)
        with contextlib.suppress(OSError, CodecError):
            while self.error is None and waits.poll():
                if (message := self._wire.receive()) is None:
                    return
                self._arrived(*message)

    def _arrived(self, kind: bytes, wake: float, items: list[Item]) -> None:
        work = self._work
        if work and kind in _ENDS and wake > -NEVER:
            self._work = 0
            if self._wire.size <= LARGE:
                self._open(work, kind, wake, items)
            else:  # the loop goes on meanwhile
                args = work, kind, wake, items
                threading.Thread(target=self._open, args=args, daemon=True).start()
        elif kind == Op.TICK and not items and self._ticks < 2:
            self._ticks += 1
            self._door.post(0, self._tag, self._ticked)
        else:
            self.condemn("has spoken out of turn")

    def _open(self, work: int, kind: bytes, wake: float, items: list[Item]) -> None:
        opened = []
        for each in items:
            opened.append((each, *self.opened(each)))  # noqa: PERF401 - one call less
        self._door.post(work, self._tag, self._came, kind, wake, opened)

    def _ticked(self) -> None:
        """It has heard of something by a way of its own: tell it the time."""
        tape = self._door.tape
        is_driver = self._tag[0] == "driver"  # what it gives is kept, and not repeated
        if tape is not None and not is_driver and not isinstance(tape, Player):
            tape.spoil(
                f"the process of {self.name} has descriptors or threads of its own"
            )
        self._send()

    def _came(
        self,
        kind: bytes,
        wake: float,
        items: list[tuple[Item, Any, BaseException | None]],
    ) -> None:
        """A message of the child takes effect."""
        if self.error is not None:
            return
        if kind != Op.SYNC:  # else its loop does not go on: it may ask for ever
            self._hangs_at = self._hangs_really_at = NEVER
        self.is_still = kind == Op.STILL
        for item, value, error in items:
            op, number = item.op, item.number
            try:
                if op == Op.CALL and error is None:
                    self._serve(item, value)
                elif op == Op.CALL:
                    self.answer(number, None, error)
                elif op == Op.CANCEL:
                    self.cancel(number)
                elif op in {Op.DONE, Op.FAIL}:
                    if item.ended and not self._door.holds:
                        ended = self._clock() - (time.monotonic() - item.ended)
                        value = stamped(value, ended, self._time())
                    self._told_to_end.discard(number)
                    self.scopes.pop(number, None)
                    self.ended(number, value, error)
                else:
                    self.condemn("has sent what is no message")
            except Exception as failed:
                self.condemn(f"has sent what is no value: {failed}")
            if self.error is not None or self._is_condemned:
                return
        self._idle = True
        if self.queue or kind in {Op.TURN, Op.SYNC}:
            self._send()
        elif wake < NEVER:
            self._wanted = wake
            self._wake = Scheduler.of(self.loop).at(wake, self._woken)

    def _woken(self, _now: float) -> None:
        self._wake = None
        self._send()

    def _forget_wake(self) -> None:
        if self._wake is not None:
            Scheduler.of(self.loop).cancel(self._wake)
            self._wake = None

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
            self.pid = int(rest)
            (self._pidfd,) = files or [-1]  # there may be no room for one more
            if self._work:  # its time begins when it is there
                self._hangs_at = self._time() + self._stall
                self._hangs_really_at = NEVER
                self._hang.start(self._hangs_at)
            return
        self._readable()  # what it has done before
        code = int(rest) if what == b"over" else None
        if code is None and self.pid is not None:
            end_group(self.pid)  # who would have done so is gone
        how = told_end(code) if what != b"failed" else f"did not start: {rest.decode()}"
        self._gone(how if what or self.pid else self._nursery.told(), code)

    def _look(self) -> None:
        """Kill it if it hangs, where time does not pass before it has answered."""
        now = time.monotonic()
        if self._hangs_really_at == NEVER:
            self._hangs_really_at = now + (self._stall if self.pid else START)
        elif now > self._hangs_really_at:
            self._signal(signal.SIGUSR1)
            time.sleep(STACK)
            self.condemn(f"hung for {self._stall:g} s")

    def _hung(self) -> None:
        """It is silent, and not idle."""
        if self._hangs_at == NEVER or self.error is not None:
            return  # it is idle: it is looked at again when it works
        if self._hangs_at - self._time() > REACHED:  # that was an earlier work
            self._hang.start(self._hangs_at)
            return
        self._signal(signal.SIGUSR1)  # says where it is
        self.loop.call_later(STACK, self.condemn, f"hung for {self._stall:g} s")

    def condemn(self, how: str) -> None:
        """It cannot be used any more, whatever it does."""
        if self.error is None and not self._is_condemned:
            self._is_condemned = True
            self._signal(signal.SIGKILL)
            at = "" if self.is_made else " in its import: give it a longer `stall`"
            self._gone(f"{how}; it was killed{at}", -signal.SIGKILL)

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
        self._end_calls(error.with_traceback(None))
        self._died(error)

    def _on_tape(self) -> Callable[[ProcessDiedError], object] | None:
        """Return what keeps its end in a recording; in a replay it comes from there."""
        tag, tape = ("call", self.name, "process"), self._door.tape
        if isinstance(tape, Player):
            number, _ = tape.first(tag)
            tape.expect(tag, number, self._repeated_end)
        elif tape is not None:
            number = tape.first(tag, First(waits=True, value=None, error=None))
            return lambda error: tape.arrived(tag, (None, error), number=number)
        return None

    def _repeated_end(self, end: tuple[Any, BaseException | None]) -> None:
        if isinstance(end[1], ProcessDiedError):
            self._over(end[1])

    def _signal(self, number: int) -> None:
        if self._pidfd >= 0:
            with contextlib.suppress(OSError):
                signal.pidfd_send_signal(self._pidfd, number)

    def kill(self, number: int, within: float) -> None:
        """End it by a signal; wait until that is told here, for a clock that is not real."""
        self._signal(number)
        select.select((self._status,), (), (), within)

    def stop(self) -> None:
        """Let it stand still, and time pass meanwhile, on a clock that is not real."""
        self._signal(signal.SIGSTOP)
        self._door.rest(self._lane)  # type: ignore[arg-type]

    def go_on(self) -> None:
        """Let it go on where it was stopped."""
        self._hangs_really_at = NEVER
        self._door.go_on(self._lane)  # type: ignore[arg-type]
        self._signal(signal.SIGCONT)

    def _end_work(self) -> None:
        work, self._work = self._work, 0
        if work:
            self._door.post(work, self._tag, lambda: None)

    def _let_go(self) -> None:
        self._hang.cancel()
        self._forget_wake()
        self._end_work()
        for task in tuple(self.tasks.values()):
            task.cancel()
        self.tasks.clear()
        loop = self.loop
        if not loop.is_closed():
            turn_of(loop).forget(self._wire.fileno())
            loop.remove_reader(self._status.fileno())
        self._wire.close()
        self._status.close()
        self._words.close()
        if self._pidfd >= 0:
            os.close(self._pidfd)
            self._pidfd = -1


class Words:
    """Reads the pipe that a child writes to, and logs its lines."""

    def __init__(self, name: str, pipe: int, loop: asyncio.AbstractEventLoop) -> None:
        self._name = name
        self._pipe = pipe
        self._loop = loop
        self._time = clock_of(loop)
        self._kept = ""
        self._begun = b""  # a line that has no end yet
        self._since, self._count = 0.0, 0
        self._names: set[str] = set()
        loop.add_reader(pipe, self._heard)

    def last(self) -> str:
        """Return what was written last, all that is there."""
        for _ in range(8):
            self._heard()
        told = f"{self._kept}{self._begun.decode(errors='replace')}\n"
        told = _TEXT.sub(r"\1", told)  # of what was too much to be shown
        words, stacks = _STACK.sub("", told), _STACK.findall(told)[::-1]
        # What crashed is first.
        stacks.sort(key=lambda stack: stack.startswith("Thread"))
        lines = [line for each in stacks for line in each.splitlines()[:FRAMES]]
        lines.insert(0, words.strip()[-WORDS:])
        return "\n".join(lines).strip()[: 2 * WORDS]

    def close(self) -> None:
        self._heard()
        if self._begun:
            self._say(self._begun.decode(errors="replace"))
        if not self._loop.is_closed():
            self._loop.remove_reader(self._pipe)
        os.close(self._pipe)

    def _heard(self) -> None:
        try:
            data = os.read(self._pipe, 1 << 14)
        except BlockingIOError:
            return
        if not data:
            self._loop.remove_reader(self._pipe)
            return
        *lines, rest = (self._begun + data).split(b"\n")
        self._begun = rest[-KEPT:]
        now = self._time()
        if now - self._since >= 1.0:
            self._since, self._count = now, 0
        room = max(0, LINES - self._count)
        for line in lines[:room]:
            self._say(line.decode(errors="replace"))
        is_first = self._count <= LINES
        self._count += len(lines)
        if self._count <= LINES:
            return
        if is_first:
            told = "%s: writes too much; the rest of this second is left out"
            _log.warning(told, self._name)
        self._keep(b"\n".join(lines[-KEPT:])[-KEPT:].decode(errors="replace"))

    def _say(self, line: str) -> None:
        level, name = logging.INFO, "esair"
        printed, is_record, told = line.partition(RECORD)
        if is_record and printed:  # such as a prompt, or a bar that tells of progress
            self._say(printed)
        if is_record:
            line = told
            with contextlib.suppress(Exception):  # whatever such a line leads to
                record = json.loads(told)
                level, name = int(record["level"]), self._logger(record["name"])
                line = str(record["text"])
        self._keep(line)
        text = f"{self._name}: {line}"
        logger = logging.getLogger(name)
        if not is_record and not logger.isEnabledFor(level):
            with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
                print(printable(text), file=sys.stderr)  # noqa: T201 - as a log is
        logger.log(level, "%s", printable(text))

    def _keep(self, line: str) -> None:
        self._kept = f"{self._kept}{line}\n"[-KEPT:]

    def _logger(self, name: object) -> str:
        """Return the name of a logger that a child may use."""
        found = printable(str(name))[:200]
        if found in logging.root.manager.loggerDict or found in self._names:
            return found
        if len(self._names) >= NAMES:
            return "esair"
        self._names.add(found)
        return found
