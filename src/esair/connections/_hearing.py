"""How values come from the device of a sensor: it is asked, or it pushes."""

from __future__ import annotations

import asyncio
import contextvars
import math
from collections.abc import (
    AsyncGenerator,
    AsyncIterator,
    Awaitable,
    Callable,
    Iterator,
)
from typing import TYPE_CHECKING, Any

import attrs

from esair.connections._calls import Call, Calls, End, Method, stamped
from esair.exceptions import BusyError, DeviceLostError, EsairError
from esair.loop import (
    REACHED,
    Deadline,
    Deadlines,
    Door,
    InLine,
    Job,
    Order,
    Scheduler,
    TapeWriter,
    arrive,
)
from esair.messages import Reading, ResourceState
from esair.resources import Sensor

if TYPE_CHECKING:
    from esair.connections._sensor_channel import SensorChannel

READY = ResourceState.READY  # hot

WAITING_LIMIT = 1024  # how many readers may wait for one sensor at a time

AT_ONCE = 100
"""How many values of a stream that never waits come in before others go on."""

LISTEN_AGAIN = 0.1
"""The pause before a stream that raised is asked for again, in seconds."""


@attrs.define(eq=False)
class Asking:
    """Asks one device by one question at a time, whoever wants to know, or in time."""

    _device: SensorChannel
    _scheduler: Scheduler = attrs.field(init=False)
    _read: Method = attrs.field(init=False)
    _deadline: float = attrs.field(init=False)
    _awaiting: list[Callable[[], None]] = attrs.field(factory=list)
    _begun: float = attrs.field(init=False)
    old_before: float = 0.0
    """A question from before this moment gives an answer from before it; what the device
    has pushed since is newer."""
    _poll: Job | None = None
    _polled_in: int = 0
    _soon: asyncio.Handle | Deadline | None = None
    """Asks the device in the next turn, for all who have asked in this one."""
    waiting: WaitingReaders = attrs.field(init=False)
    busy: Call | bool = False
    """The question that waits for its answer, or the call of something else that keeps
    the device busy; True while one is in its first step."""
    transactions: int = 0  # how many times the device was asked
    missed: int = 0  # how many polls were left out: it had not answered yet
    awaited_in: int = 0  # the turn whose poll is not answered yet; or 0
    latency: float = 0.0  # how long it took lately at most, in s; what is past fades
    rate: float = 0.0  # how often it is polled, in Hz; 0 if it cannot be asked

    def __attrs_post_init__(self) -> None:
        self._scheduler = Scheduler.of(self._device.loop)
        self.waiting = WaitingReaders(self._device)

    def configured(self, sensor: Sensor[Any]) -> None:
        """Take over a changed deadline, or rate."""
        self._deadline = sensor.deadline
        self.rate = sensor.rate if sensor.can_be_asked else 0.0
        if sensor.can_be_asked:
            self._read = self._device.driver.method("read")

    def down(self, error: EsairError) -> None:
        """The device is gone; its calls are fenced."""
        if self._soon is not None:
            self._soon.cancel()
            self._soon = None
        self.busy = False
        self.awaited_in = 0
        self.waiting.answer(math.inf, error)

    def forget(self) -> None:
        """Take no answer to what has been asked until now."""
        self.old_before = self._device.time()

    # In time.

    def start_polling(self, *near: object) -> None:
        """Ask at the sensor's rate, if it can be asked and is ready."""
        device = self._device
        if self._poll is None and device.state is READY and self.rate:
            self._poll = poll = self._scheduler.every(
                1.0 / self.rate,
                self._turn,
                order=Order.POLL,
                name=device.name,
                phase=self._scheduler.phase(device.name),
            )
            calls, read = device.calls, self._read
            poll.near = (
                *(self, device, *near),
                *(calls, calls.alive, calls.caller, read, read.function),
            )
            poll.soon()

    def stop_polling(self) -> bool:
        """Ask in time no more; tells whether it did."""
        poll, self._poll = self._poll, None
        if poll is not None:
            poll.stop()
        return poll is not None

    def _turn(self, now: float) -> Awaitable[object] | None:
        turn = self._scheduler.turns
        if turn == self._polled_in:  # the first poll, and its moment on the grid
            return None
        if self.busy or self._device.state is not READY:
            self.missed += 1
            return None
        self._polled_in = turn
        self._begin()
        if self.busy:
            self.awaited_in = self._scheduler.polled_in = turn
            self._begun = now
        return None

    # On demand.

    def ask(self) -> None:
        """Ask the device in the next turn, for all who wait then."""
        device = self._device
        if self.rate and not self.busy and self._soon is None and device.state is READY:
            if self.waiting.behind:  # it would measure too early once more
                pause = min(max(self.waiting.behind, SOON), 1.0 / self.rate)
                self._soon = Deadlines.of(device.loop).after(pause, self._ask_now)
                return
            self._soon = device.loop.call_soon(
                self._ask_now, context=contextvars.Context()
            )

    def _ask_now(self) -> None:
        self._soon = None
        if self.waiting.readers and not self.busy:
            self._begin()

    def next_answer(self, *, fresh: bool) -> int:
        """Return the number of the transaction that answers a question of now."""
        return self.transactions + (0 if self.busy and not fresh else 1)

    # The one question.

    def _begin(self) -> None:
        self.busy = True
        number = self.transactions = self.transactions + 1
        calls = self._device.calls
        opening = calls.opening
        try:
            value = calls.begin("read", self._read, (), self._deadline)
        except Exception as error:
            self.busy = False
            if opening == calls.opening:
                self._device.fail(error, number)
        else:
            if type(value) is Call:
                value.apply = self._ended
                self.busy = value
                return
            self.busy = False
            if opening == calls.opening:
                self._device.publish(value, number)
            else:  # its device was lost by this very call
                calls.late += 1
        if self.waiting.readers:
            self.free()

    def _ended(self, call: Call, end: End) -> None:
        """Apply the outcome of a question that has waited for the device."""
        if call.ended is not None:  # else its driver still has the device
            self.busy = False
        polled, self.awaited_in = self.awaited_in, 0
        if polled:
            spent = self._device.time() - self._begun
            self.latency = max(spent, 0.75 * self.latency)
        if end.error is not None:
            self._device.fail(end.error, self.transactions)
        elif call.begun >= self.old_before:  # else who waits has it asked again
            self._device.publish(end.value, self.transactions)
        if polled:
            self.answered()
        self.free()

    def free(self) -> None:
        """The device may have become free: an operation first, then those who ask."""
        self._device.operations.look()
        if self.waiting.readers:
            self.ask()

    def ended(self, call: Call) -> None:
        """Some other call, or one that was given up, has ended, and frees the device."""
        if call is self.busy and call.ended is not None:
            self.busy = False

    def when_answered(self, function: Callable[[], None]) -> None:
        """Call a function when the poll of this turn has ended, whatever came of it."""
        self._awaiting.append(function)

    def answered(self) -> None:
        """The poll of this turn has ended."""
        awaiting, self._awaiting = self._awaiting, []
        for function in awaiting:
            function()


Waiter = tuple[float, asyncio.Future[Reading[Any]], float, float, float]
"""Of which transaction the answer must be at least, what gets it, until when, for how
many seconds that was, and when it must have been measured at the earliest."""

SOON = 0.001
"""The shortest pause before a device is asked again that has measured too early, in s."""


@attrs.define(eq=False)
class WaitingReaders:
    """Keeps readers until the answer to a question that came after theirs."""

    _device: SensorChannel
    _deadline: Deadline = attrs.field(init=False)
    """That of the reader whose time is over first."""
    readers: list[Waiter] = attrs.field(factory=list)  # who waits
    behind: float = 0.0
    """By how much the last answer was measured too early for who waits still, in s."""
    turned_away: int = 0

    def __attrs_post_init__(self) -> None:
        self._deadline = Deadlines.of(self._device.loop).idle(self._expire)

    async def reading(self, need: float, timeout: float, since: float) -> Reading[Any]:
        """Wait for what transaction `need` gives, or a later one, measured since then."""
        if len(self.readers) >= WAITING_LIMIT:
            self.turned_away += 1
            raise BusyError(
                self._device.name, "number of waiting readers", WAITING_LIMIT
            )
        future: asyncio.Future[Reading[Any]] = self._device.loop.create_future()
        until = self._device.time() + timeout
        waiter = (need, future, until, timeout, since)
        self.readers.append(waiter)
        self._deadline.start_by(until)
        try:
            return await future
        finally:
            if waiter in self.readers:
                self.readers.remove(waiter)
                self._rest()

    def answer(self, number: float, answer: Reading[Any] | EsairError) -> None:
        """Tell what transaction `number` has given to those who wait for it."""
        waiters, self.readers = self.readers, []
        self.behind = 0.0
        for waiter in waiters:
            need, future, _, _, since = waiter
            if future.done():
                continue
            if need > number:
                self.readers.append(waiter)
            elif isinstance(answer, Reading):
                if since <= answer.time:
                    arrive(future, answer)
                else:
                    self.readers.append(waiter)
                    self.behind = max(self.behind, since - answer.time)
            else:
                future.set_exception(answer)
        self._rest()

    def _rest(self) -> None:
        if not self.readers:
            self.behind = 0.0
            self._deadline.cancel()

    def _expire(self) -> None:
        now = self._device.time()
        for _, future, until, timeout, _ in self.readers:
            if future.done():
                continue
            if now + REACHED < until:
                self._deadline.start_by(until)
            else:
                future.set_exception(self._device.silent(timeout))


class Listening:
    """Brings in what one sensor pushes, while the opening lasts that it belongs to."""

    def __init__(self, device: SensorChannel) -> None:
        self._device = device
        self._door = Door.of(device.loop)
        self._tag = (device.name, "pushed")
        if self._door.player is not None:
            self._door.player.listen(self._tag, lambda it: self._pushed(*it))

    def begin(self) -> None:
        """Listen to the opening that there is now; the call ends with it."""
        self._device.driver.uses_threads = True  # its stream may block
        self._device.calls.begin("stream", Method(self._listen, None), (), None)

    async def _listen(self) -> None:
        device = self._device
        sensor: Any = device.driver.resource
        calls = device.calls
        opening = calls.opening
        while True:
            error: BaseException
            try:
                stream = sensor.stream()
                if isinstance(stream, AsyncIterator):
                    if not await self._listen_to(stream, calls, opening):
                        return
                elif not await self._listen_blocking(iter(stream), calls, opening):
                    return
                error = DeviceLostError(device.name, "its stream has ended")
            except asyncio.CancelledError as cancelled:
                if opening != calls.opening:
                    raise
                error = cancelled  # the driver's own
            except BaseException as raised:  # a driver may raise anything
                error = raised
            if opening != calls.opening:
                return  # the device is gone; its next opening begins anew
            self._door.end(self._tag, self._pushed, None, error, opening, calls)
            if opening != calls.opening:
                return
            await asyncio.sleep(LISTEN_AGAIN)

    async def _listen_to(
        self, values: AsyncIterator[Any], calls: Calls, opening: int
    ) -> bool:
        left = AT_ONCE
        try:
            async for value in values:
                if not self._heard(value, calls, opening):
                    return False
                left -= 1
                if not left:  # it may always have one more, and never wait
                    await asyncio.sleep(0)
                    left = AT_ONCE
        finally:
            if isinstance(values, AsyncGenerator):
                # The collector would do it, at any moment.
                await values.aclose()
        return True

    async def _listen_blocking(
        self, values: Iterator[Any], calls: Calls, opening: int
    ) -> bool:
        # A thread of its own: waiting for the next value must not block the bus.
        executor = await self._device.driver.stream_executor()
        end = object()
        loop = asyncio.get_running_loop()
        while True:
            coming: InLine[Any] = InLine(loop=loop)
            executor.submit(loop, coming, next, values, end, outside=True)
            if (value := await coming) is end:
                return True
            value = stamped(value, coming.ended, self._device.time())
            if not self._heard(value, calls, opening):
                return False

    def _heard(self, value: Any, calls: Calls, opening: int) -> bool:
        """Bring in what the device has pushed; tell whether its opening goes on."""
        self._door.end(self._tag, self._pushed, value, None, opening, calls)
        return opening == calls.opening

    def _pushed(
        self,
        value: Any,
        error: BaseException | None,
        opening: int,
        calls: Calls | None = None,
    ) -> None:
        """Let what the device has pushed, or the error of its stream, take effect."""
        device = self._device
        if opening != (calls or device.calls).opening:
            device.calls.late += 1
            return
        if isinstance(self._door.tape, TapeWriter):
            self._door.tape.arrived(self._tag, (value, error, opening))
        if error is None:
            device.publish(value, math.inf)
            if device.asking.rate and device.newest is not None:
                device.asking.old_before = device.newest.time
        else:
            device.fail(error)
