"""Requests on a wire, and whose answer is what comes."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Awaitable, Callable, Hashable
from typing import Self

from esair.buses._bus import TURN_LIMIT, Bus
from esair.buses._inbox import within
from esair.exceptions import BusyError, DeviceLostError, DriverStuckError, NoTurnError
from esair.loop import (
    Deadline,
    Deadlines,
    InLine,
    Turns,
    Urgency,
    arrive,
    fail,
    had_turn,
    urgency,
)

LATE_LIMIT = 0.4
"""How long after it was due an answer may still come, in seconds."""

REQUEST_LIMIT = 256
"""How many requests may wait on one wire."""


class Exchanges:
    """One request at a time on a wire, each with the answer that belongs to it.

    A request that was sent and given up, because its time was up or its requester was
    cancelled, is still owed an answer. When that comes it is counted in
    ``bus.stats.late`` and is nobody's. Until it has come, or *late_limit* is over, a
    request whose answer it could be taken for is not sent; the others are. What is owed
    when the bus is lost may come as soon as it is there again, however long that takes:
    from then on it is owed for *late_limit*.

    A bus has one, offers it each message that comes, and asks through it::

        answer = await self.exchanges.ask(send, timeout=0.5)

    Args:
        bus: The bus, whose name is in the errors and whose ``stats`` count.
        late_limit: How long after it was due an answer may still come, in seconds; it is
            due when the time of its request would be over that begins as it is sent.
            What comes even later is taken for another's: choose it for the device.
        limit: How many requests may wait.
    """

    def __init__(
        self, bus: Bus, *, late_limit: float = LATE_LIMIT, limit: int = REQUEST_LIMIT
    ) -> None:
        self.bus = bus
        self._late_limit = late_limit
        self._limit = limit
        self.now: Exchange | None = None
        """The one that was sent and waits for its answer."""
        self._line: list[Exchange] = []
        """Who waits for the turn, in the order in which they asked."""
        self._turns = Turns()
        """Says who has it next: an actuator that is made safe, then one that is opened."""
        self.unanswered: dict[Exchange, Deadline | None] = {}
        """Whose answers may still come, the oldest first, and until when; None if the
        bus was lost, and nobody has asked since."""
        self._deadline: Deadline | None = None
        """That of the answer: one for all of them, as one at a time is waited for."""
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def waiting(self) -> int:
        """How many requests wait for their turn, or for their answer."""
        return len(self._line) + (self.now is not None)

    async def ask(
        self,
        send: Callable[[float], Awaitable[object]],
        *kinds: Hashable,
        timeout: float,
        answers: Callable[[bytes], bool] | None = None,
        patience: float | None = None,
    ) -> bytes:
        """Send a request in its turn, and return the message that answers it.

        Args:
            send: Sends it; gets how many seconds are left.
            *kinds: What the answer begins with; anything if none is given.
            timeout: How long to wait, for the sending and the answer together, in
                seconds; for its turn it waits as long, and `TURN_LIMIT` at least.
            answers: Tells its answer from those to all other requests, by a sequence
                number, say; then late ones need not be waited for.
            patience: How long after it was sent its answer is due, in seconds;
                ``timeout`` if None.

        Raises:
            BusyError: Too many requests wait; it was not sent.
            NoTurnError: Others had the wire all the time; it was not sent.
            DriverStuckError: There was no answer in time.
        """
        async with self.request(*kinds, timeout=timeout, answers=answers) as exchange:
            exchange.begin()
            await send(exchange.left)
            return await exchange.answer(patience=patience)

    def request(
        self,
        *kinds: Hashable,
        timeout: float,
        answers: Callable[[bytes], bool] | None = None,
    ) -> Exchange:
        """Return an exchange, for ``async with``: its turn begins there.

        For a package that finds the answer by itself: call `Exchange.begin` before
        the request leaves and `Exchange.end` when its answer is there. Args and errors
        are those of `ask`; a kind can be anything then, such as an address.
        """
        return Exchange(self, kinds, timeout, answers)

    def offer(self, message: bytes) -> bool:
        """Take a message that came; tells whether somebody waited for it."""
        now = self.now
        mine = now is not None and now.takes(message)
        if self.unanswered:
            # Oldest first, as a device answers; but by its number it is no other's.
            owed = [each for each in self.unanswered if each.takes(message)]
            numbered = [each for each in owed if each.answers is not None]
            if mine and now is not None and now.answers is not None:
                owed = numbered
                if owed:  # they cannot be told apart
                    now.answers = None
            if owed:
                self.bus.stats.late += 1
                self._forget((numbered or owed)[0])
                return False
        if mine and now is not None:
            now.settle(message)
        return mine

    def put_off(self, message: bytes, seconds: float) -> None:
        """Wait for so many seconds more for the answer that a message announces."""
        now = self.now
        if now is not None and now.takes(message):
            now.until = now.due = now.loop.time() + seconds
            self.limit_wait(now)
        for owed in [each for each in self.unanswered if each.takes(message)]:
            self._hold(owed)
            self._owe(owed, seconds + self._late_limit)

    def fail(self, error: BaseException) -> None:
        """Let the request that waits for its answer fail; after a loss all that wait."""
        if self.now is not None:
            self.now.fail(error)
        if isinstance(error, DeviceLostError):
            for waiting in self._line:
                waiting.fail(error)
            for owed in self.unanswered:
                self._hold(owed)

    async def silence(self) -> None:
        """Wait until nothing is owed that could be taken for the answer to another.

        A bus does so as it is opened again after a loss: then nobody's time is spent.

        Raises:
            DriverStuckError: More is owed a ``late_limit`` after all of it was to come.
        """
        if self.unanswered:
            left = (
                max(each.due for each in self.unanswered)
                - asyncio.get_running_loop().time()
            )
            async with self.request(timeout=max(0.0, left) + 2 * self._late_limit):
                pass

    def clear(self) -> None:
        """Owe nothing any more: what was at the other end has started anew."""
        for owed in tuple(self.unanswered):
            self._forget(owed)

    # For the exchanges.

    async def take_turn(self, exchange: Exchange) -> None:
        """Wait until an exchange may leave."""
        for owed, deadline in self.unanswered.items():
            if deadline is None or owed.loop is not exchange.loop:  # that one has ended
                owed.loop = exchange.loop
                self._owe(owed, self._late_limit)
        if self.now is None and not self.is_owed_to(exchange):
            self.now = exchange
            return
        if not self._turns.has_room(len(self._line), self._limit, exchange.urgency):
            self.bus.stats.refused += 1
            raise BusyError(f"bus {self.bus.name}", "number of requests", self._limit)
        self._line.append(exchange)
        try:
            await exchange.wait()
        except BaseException:
            if self.now is exchange:  # it came at the same moment
                self.end_turn(exchange)
            else:
                self._line.remove(exchange)
            raise

    def end_turn(self, exchange: Exchange) -> None:
        """Let the next one leave, and remember what is owed."""
        self.now = None
        if self._deadline is not None:
            self._deadline.cancel()
        if exchange.is_owed:
            left = exchange.due - asyncio.get_running_loop().time()
            self._owe(exchange, max(0.0, left) + self._late_limit)
            if isinstance(exchange.error, DeviceLostError):
                self._hold(exchange)
            if len(self.unanswered) > self._limit:
                self._forget(next(iter(self.unanswered)))
        if self._line:
            self._let_leave()

    def limit_wait(self, exchange: Exchange) -> None:
        """Let the one that waits for its answer wait no longer than its time lasts."""
        if self._deadline is None or exchange.loop is not self._loop:
            self._loop = loop = exchange.loop
            self._deadline = Deadlines.beside(loop).idle(self._expire)
        self._deadline.start(exchange.until)

    def _expire(self) -> None:
        if self.now is not None:
            self.now.expire()

    def is_owed_to(self, exchange: Exchange) -> bool:
        """Tell whether an answer is owed that could be taken for that of another."""
        return bool(self.unanswered) and any(map(exchange.is_like, self.unanswered))

    def _owe(self, exchange: Exchange, seconds: float) -> None:
        deadlines = Deadlines.beside(asyncio.get_running_loop())
        self.unanswered[exchange] = deadlines.after(seconds, self._forget, exchange)

    def _hold(self, owed: Exchange) -> None:
        deadline, self.unanswered[owed] = self.unanswered[owed], None
        if deadline is not None:
            deadline.cancel()

    def _forget(self, owed: Exchange) -> None:
        self._hold(owed)
        del self.unanswered[owed]
        self._let_leave()

    def _let_leave(self) -> None:
        """Give the turn to the first whose answer can be taken for none that is owed."""
        if self.now is None:
            for exchange in sorted(self._line, key=self._turns.rank):
                if not self.is_owed_to(exchange):
                    self._line.remove(exchange)
                    self._turns.taken(exchange)
                    self.now = exchange
                    exchange.begin_turn()
                    return


class Exchange:
    """A request and its answer, from its turn to its end.

    Attributes:
        name: What it is called in errors; the request itself, if that tells it.
        answers: What tells its answer from all others; None if nothing does.
        due: When its answer is due, on the loop's clock, once it was sent: it may be given
            up much earlier, or begin late.
        error: Why it gets no answer; None if it may.
        loop: The event loop of who asks.
        until: When its time is over, on the loop's clock.
    """

    name: str | bytes = "answer"
    due: float = 0.0
    _is_sent = False
    _is_answered = False
    _message: bytes | None = None
    error: BaseException | None = None
    _waiter: asyncio.Future[bytes] | None = None

    def __init__(
        self,
        exchanges: Exchanges,
        kinds: tuple[Hashable, ...],
        seconds: float,
        answers: Callable[[bytes], bool] | None,
    ) -> None:
        self.answers = answers
        self._exchanges = exchanges
        self._kinds = kinds
        self._seconds = seconds
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self.until: float = self.loop.time() + seconds
        self.urgency: Urgency = urgency.get()

    @property
    def left(self) -> float:
        """How many seconds are left of its time."""
        return self.until - self.loop.time()

    @property
    def is_owed(self) -> bool:
        """Whether it was sent and not answered."""
        return self._is_sent and not self._is_answered

    def begin(self) -> None:
        """The request leaves now: what comes from now on can be its answer."""
        self._is_sent = True

    def end(self) -> None:
        """Its answer is there, or it was not sent: nothing is owed."""
        self._is_answered = True

    def owe(self, *kinds: Hashable) -> None:
        """No answers are owed any more but those that begin so."""
        self._kinds = kinds

    def answer(self, *, patience: float | None = None) -> asyncio.Future[bytes]:
        """Return the answer, to be awaited at once; the request has been sent."""
        self.due = self.loop.time() + (self._seconds if patience is None else patience)
        self._waiter = waiter = self.loop.create_future()
        if self._message is not None:
            waiter.set_result(self._message)
        elif self.error is not None:
            waiter.set_exception(self.error)
        else:
            self._exchanges.limit_wait(self)
        return waiter

    async def wait(self) -> None:
        """Wait for its turn, with which its time begins.

        Unless it waits for what its own device owes: that is silence of the device.
        """
        if self._exchanges.is_owed_to(self):
            self._waiter = self.loop.create_future()
            await within(self._waiter, max(0.0, self.left))
            return
        self._waiter = InLine(loop=self.loop)
        since = self.loop.time()
        await within(self._waiter, max(self._seconds, TURN_LIMIT))
        now = self.loop.time()
        had_turn(now - since)
        self.until = now + self._seconds

    def takes(self, message: bytes) -> bool:
        """Tell whether a message can be its answer."""
        if not self._is_sent or self._is_answered:
            return False
        fits = message.startswith(_prefixes(self._kinds))
        return fits and (self.answers is None or self.answers(message))

    def is_like(self, other: Exchange) -> bool:
        """Tell whether its answer could be taken for that of another."""
        if self.answers is not None or other.answers is not None:
            return False
        if not self._kinds or not other._kinds:
            return True
        return any(
            _begin_alike(one, another)
            for one in self._kinds
            for another in other._kinds
        )

    def begin_turn(self) -> None:
        """Have the turn that it waits for."""
        waiter, self._waiter = self._waiter, None
        if waiter is not None and not waiter.done():
            waiter.set_result(b"")

    def settle(self, message: bytes) -> None:
        """Be answered."""
        self._is_answered = True
        self._message = message
        if self._waiter is not None:
            arrive(self._waiter, message)

    def fail(self, error: BaseException) -> None:
        """Have no answer, and an error instead."""
        self.error = error
        if self._waiter is not None:
            fail(self._waiter, error)

    def expire(self) -> None:
        """Wait no more, if it does: its time is over."""
        if self._waiter is not None:
            fail(self._waiter, TimeoutError())

    async def __aenter__(self) -> Self:
        exchanges = self._exchanges
        if exchanges.now is None and not exchanges.unanswered:
            exchanges.now = self
            return self
        bus = exchanges.bus
        try:
            await exchanges.take_turn(self)
        except DriverStuckError:
            raise
        except TimeoutError:
            if exchanges.is_owed_to(self):  # its own device has not answered
                raise self._stuck() from None
            bus.stats.no_turn += 1
            seconds = max(self._seconds, TURN_LIMIT)
            raise bus.failed(NoTurnError(bus.name, self._what(), seconds)) from None
        if self.left <= 0.0:  # its turn came with the end of its time
            exchanges.end_turn(self)
            raise self._stuck()
        return self

    async def __aexit__(
        self, _: object, error: BaseException | None, *__: object
    ) -> None:
        if isinstance(error, BusyError):  # nothing has left
            self.end()
        self._exchanges.end_turn(self)
        if isinstance(error, TimeoutError) and not isinstance(error, DriverStuckError):
            raise self._stuck() from None

    def _what(self) -> str:
        what = self.name
        return what if isinstance(what, str) else f"answer to {what!r:.40}"

    def _stuck(self) -> DriverStuckError:
        bus = self._exchanges.bus
        return bus.failed(DriverStuckError(bus.name, self._what(), self._seconds))


@functools.lru_cache
def _prefixes(kinds: tuple[Hashable, ...]) -> tuple[bytes, ...]:
    return tuple(each for each in kinds or (b"",) if isinstance(each, bytes))


def _begin_alike(one: Hashable, other: Hashable) -> bool:
    if isinstance(one, bytes) and isinstance(other, bytes):
        return one.startswith(other) or other.startswith(one)
    return one == other
