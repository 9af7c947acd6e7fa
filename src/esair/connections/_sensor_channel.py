"""The way of data from one sensor: newest reading, waiting readers, followers."""

from __future__ import annotations

import asyncio
import collections
import contextvars
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from typing import Any, Protocol

from esair.connections._call import Call, Calls, End
from esair.connections._driver import Driver, Method, translate
from esair.connections._measured import measured_at
from esair.connections._operations import Operating, Operations
from esair.connections._reading_check import ReadingCheck
from esair.connections._registrations import Registration, Registrations
from esair.exceptions import (
    BadValueError,
    BusyError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    ResourceRemovedError,
    StaleReadingError,
)
from esair.journal import Kind
from esair.loop import (
    Deadlines,
    Door,
    Job,
    Order,
    Player,
    Recorder,
    Scheduler,
    clock_of,
)
from esair.messages import Reading, ResourceState, Stamped, StampedReading
from esair.resources import Sensor
from esair.values import passes_as

WAITING_LIMIT = 1024
"""How many readers may wait for one sensor at a time."""

PERIODS = 3.0
"""How many periods old a reading of a device that is asked may be, if nobody says."""

LISTEN_AGAIN = 0.1
"""The pause before a stream that raised is asked for again, in seconds."""

READ_TIMEOUT = 1.0
"""How long a read waits for the device unless it says otherwise, in seconds."""


class Follower(Protocol):
    """Gets every new reading of a sensor, at once, in the loop."""

    @property
    def registration(self) -> Registration:
        """The right by which it follows."""

    def feed(self, reading: Reading[Any]) -> None:
        """Take a new reading; must not wait."""

    def changed(self, error: EsairError | None) -> None:
        """Learn that the sensor is gone for now (why), or back (None)."""

    def doubt(self, error: EsairError) -> None:
        """Learn that it has given a bad value, or an error instead of one."""


class SensorChannel:
    """Reads one sensor for everybody who asks; one transaction serves them all."""

    def __init__(
        self,
        sensor: Sensor[Any],
        registrations: Registrations,
        loop: asyncio.AbstractEventLoop,
        on_error: Callable[[Exception], None],
        left: set[Call] | None = None,
    ) -> None:
        self.name = sensor.name
        self.state = ResourceState.CLOSED
        self.error: EsairError | None = None
        self.newest: Reading[Any] | None = None
        self.transactions = 0
        """How many times the device was asked."""
        self.bad = 0
        """How many readings were of a wrong type, not finite, or outside the limits."""
        self.missed = 0
        """How many polls were left out because the device had not answered yet."""
        self.dropped = 0
        """How many readings a slow follower has not seen."""
        self.sequence = 0
        self.registrations = registrations
        self._journal = registrations.journal
        self._loop = loop
        self.time = clock_of(loop)
        self._deadlines = Deadlines.of(loop)
        self._on_error = on_error
        self._followers: tuple[Follower, ...] = ()
        self._waiters: list[tuple[float, asyncio.Future[Reading[Any]]]] = []
        self._poll: Job | None = None
        self._scheduler = Scheduler.of(loop)
        self._polled_in = 0
        self.awaited_in = 0
        """The turn in which it was polled, while that poll is not answered; or 0."""
        self.latency = 0.0
        """How long the device took lately at most, in seconds; what is past fades."""
        self._begun = 0.0
        self._awaiting: list[Callable[[], None]] = []
        self._door = Door.of(loop)
        if isinstance(self._door.tape, Player):
            self._door.tape.listen((self.name, "pushed"), lambda it: self._pushed(*it))
        self._last: Any = None
        self._repeats = 0
        """How many times in a row the device has given the last value."""
        self._left: set[Call] = set() if left is None else left
        self._asking: Call | bool = False
        """The question that waits for its answer: there is one at a time."""
        self._asks: asyncio.Handle | None = None
        """Asks the device in the next turn, for all who have asked in this one."""
        self.operations = Operations(self, loop, on_error)
        self.attach(sensor)

    def attach(self, sensor: Sensor[Any]) -> None:
        """Read this sensor from now on; it is not ready yet."""
        self.sensor = sensor
        self.driver = Driver(sensor)
        self.calls = Calls(
            self.driver,
            self._loop,
            on_late=self._late,
            on_stuck=self._stuck,
            left=self._left,
        )
        self._history: collections.deque[Reading[Any]] = collections.deque(
            maxlen=sensor.history_size
        )
        self._check_value = ReadingCheck(sensor).__call__
        self._max_repeat = sensor.max_repeat
        if sensor.can_be_asked:
            self._read = self.driver.method("read")
        self.configured()

    def configured(self) -> None:
        """Take over a changed rate."""
        sensor = self.sensor
        self.good_for = 1.0 / sensor.rate if sensor.can_be_asked else math.inf
        if sensor.can_be_asked:
            self.max_age = PERIODS / sensor.rate
        else:
            self.max_age = math.inf if sensor.period is None else sensor.period
        if self._poll is not None:
            self._stop_polling()
            self._start_polling()

    @property
    def successes(self) -> int:
        """How many values the device has given."""
        return self.sequence

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "readings": self.sequence,
            "transactions": self.transactions,
            "missed": self.missed,
            "bad": self.bad,
            "dropped": self.dropped,
            "abandoned": self.calls.abandoned,
            "late": self.calls.late,
        }

    # State, told by the supervisor.

    def up(self) -> None:
        """The device is ready: begin to listen, and to ask if somebody follows."""
        self.state = ResourceState.READY
        self.error = None
        self._repeats = 0
        if self.newest is None and hasattr(self.sensor, "initial"):
            self.publish(self.sensor.initial, -1)
        if self.sensor.pushes:
            self.calls.begin("stream", Method(self._listen, None), (), None)
        self._start_polling()
        for follower in self._followers:
            follower.changed(None)

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: tell everybody who reads it."""
        self.state = state
        self.error = error
        self.newest = None
        self._stop_polling()
        self.calls.next_opening(error)
        if self._asks is not None:
            self._asks.cancel()
            self._asks = None
        self._asking = False
        self.awaited_in = 0
        waiters, self._waiters = self._waiters, []
        for _, future in waiters:
            if not future.done():
                future.set_exception(error)
        for follower in self._followers:
            follower.changed(error)
        self._answered()
        self.operations.gone(error)

    def forget_age(self) -> None:
        """Make every reading stale, as after a suspend of the computer."""
        self.newest = None
        error = StaleReadingError(self.name, None, self.good_for)
        for follower in self._followers:
            follower.changed(error)

    # Readers.

    def cached(self, registration: Registration, limit: float) -> Reading[Any] | None:
        """Return the newest reading if it is good enough, without any wait.

        Args:
            registration: The right to read.
            limit: The greatest age in seconds.
        """
        if not registration.usable:
            raise self.registrations.refusal(registration)
        reading = self.newest
        if reading is not None and self.time() - reading.time <= limit:
            return reading
        return None

    def known(self, registration: Registration, limit: float) -> Reading[Any]:
        """Return the newest reading, or raise because there is none that is current.

        Raises:
            StaleReadingError: There is none, or it is older than the limit.
            DeviceLostError: The device is not there.
        """
        self._check(registration)
        reading = self.newest
        age = None if reading is None else self.time() - reading.time
        if reading is None or age is None or age > limit:
            raise StaleReadingError(self.name, age, limit)
        return reading

    async def ask(
        self, registration: Registration, *, fresh: bool, max_age: float, timeout: float
    ) -> Reading[Any]:
        """Return a reading that is good enough, asking the device or waiting for it.

        Raises:
            StaleReadingError: There is none in time.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
            BusyError: Too many readers wait.
        """
        self._check(registration)
        if not fresh and not self.sensor.can_be_asked and self.newest is not None:
            # A device that pushes cannot be asked; it has been silent for too long.
            raise StaleReadingError(self.name, self.time() - self.newest.time, max_age)
        if len(self._waiters) >= WAITING_LIMIT:
            raise BusyError(self.name, "number of waiting readers", WAITING_LIMIT)
        need = (
            self.transactions if self._asking and not fresh else self.transactions + 1
        )
        future: asyncio.Future[Reading[Any]] = self._loop.create_future()
        waiter = (need, future)
        self._waiters.append(waiter)
        self._ask()
        deadline = self._deadlines.after(timeout, self._expire, future, timeout)
        try:
            reading = await future
        finally:
            deadline.cancel()
            if waiter in self._waiters:
                self._waiters.remove(waiter)
        self._check(registration)
        age = self.time() - reading.time
        if age > max_age:
            raise StaleReadingError(self.name, age, max_age)
        return reading

    def history(self, registration: Registration, count: int) -> list[Reading[Any]]:
        """Return the last readings, the oldest first."""
        if not registration.usable:
            raise self.registrations.refusal(registration)
        if not passes_as(count, int) or count < 0:
            raise BadValueError(
                self.name, "history", f"expected a whole number, not {count!r:.80}"
            )
        return list(self._history)[-count:] if count > 0 else []

    def _check(self, registration: Registration) -> None:
        if not registration.usable:
            raise self.registrations.refusal(registration)
        if self.state is not ResourceState.READY:
            error = self.error or DeviceLostError(
                self.name, f"it is {self.state.value}"
            )
            # Anew: else each who asks would leave its frames in the traceback.
            raise error.with_traceback(None)

    def _expire(self, future: asyncio.Future[Reading[Any]], timeout: float) -> None:
        if not future.done():
            newest = self.newest
            age = None if newest is None else self.time() - newest.time
            stale = StaleReadingError(self.name, age, timeout, silent=True)
            future.set_exception(stale)

    # Followers.

    def follow(self, follower: Follower) -> None:
        """Feed every new reading to a follower; polls the device meanwhile."""
        if follower not in self._followers:
            self._followers = (*self._followers, follower)
            self._start_polling()

    def unfollow(self, follower: Follower) -> None:
        """Stop feeding a follower."""
        self._followers = tuple(f for f in self._followers if f is not follower)
        if not self._followers:
            self._stop_polling()

    def _start_polling(self) -> None:
        if (
            self._poll is None
            and self._followers
            and self.state is ResourceState.READY
            and self.sensor.can_be_asked
        ):
            self._poll = self._scheduler.every(
                1.0 / self.sensor.rate,
                self._turn,
                order=Order.POLL,
                name=self.name,
                phase=self._scheduler.phase(self.name),
            )
            self._poll.soon()

    def _stop_polling(self) -> None:
        if self._poll is not None:
            self._poll.stop()
            self._poll = None

    # Transactions.

    def _turn(self, now: float) -> Awaitable[object] | None:
        turn = self._scheduler.turns
        if turn == self._polled_in:  # the first poll, and its moment on the grid
            return None
        if self._asking or self.state is not ResourceState.READY:
            self.missed += 1
            return None
        self._polled_in = turn
        self._begin()
        if self._asking:
            self.awaited_in = self._scheduler.polled_in = turn
            self._begun = now
        return None

    def _ask(self) -> None:
        if (
            self.sensor.can_be_asked
            and not self._asking
            and self._asks is None
            and self.state is ResourceState.READY
        ):
            self._asks = self._loop.call_soon(
                self._ask_now, context=contextvars.Context()
            )

    def _ask_now(self) -> None:
        self._asks = None
        if self._waiters and not self._asking:
            self._begin()

    def _begin(self) -> None:
        self._asking = True
        self.transactions += 1
        number = self.transactions
        opening = self.calls.opening
        try:
            value = self.calls.begin(
                "read", self._read, (), self.sensor.deadline, self._read_ended
            )
        except Exception as error:
            self._asking = False
            if opening == self.calls.opening:
                self._fail(error, number)
        else:
            if type(value) is Call:
                self._asking = value
                return
            self._asking = False
            if opening == self.calls.opening:
                self.publish(value, number)
            else:  # its device was lost by this very call
                self.calls.late += 1
        self._free()

    def _read_ended(self, call: Call, end: End) -> None:
        """Apply the outcome of a question that has waited for the device."""
        if call.ended is not None:  # else its driver still has the device
            self._asking = False
        polled, self.awaited_in = self.awaited_in, 0
        if polled:
            self.latency = max(self.time() - self._begun, 0.75 * self.latency)
        if end.error is None:
            self.publish(end.value, self.transactions)
        else:
            self._fail(end.error, self.transactions)
        if polled:
            self._answered()
        self._free()

    def _free(self) -> None:
        """The device may have become free: an operation first, then those who ask."""
        self.operations.look()
        if self._waiters:
            self._ask()

    def ready_for(self, operation: Operating) -> bool:
        """Tell whether an operation may begin now."""
        return not self._asking

    def operating(self, operation: Operating, call: Call) -> None:
        """The device has begun with an operation."""
        self._asking = call

    def operated(self, call: Call | None) -> None:
        """An operation has its outcome; the device is free if it has ended."""
        if call is not None and call is self._asking and call.ended is not None:
            self._asking = False
        self._free()

    def when_answered(self, function: Callable[[], None]) -> None:
        """Call a function when the poll of this turn has ended, whatever came of it."""
        self._awaiting.append(function)

    def _answered(self) -> None:
        awaiting, self._awaiting = self._awaiting, []
        for function in awaiting:
            function()

    def between(self, method: Method, told: Callable[[End], None]) -> bool:
        """Call the driver between two questions; tells whether the device was free."""
        if self._asking:
            return False

        def ended(call: Call, end: End) -> None:
            if call.ended is not None:
                self._asking = False
            told(end)
            self._free()

        try:
            value = self.calls.begin(
                method.name, method, (), self.sensor.deadline, ended
            )
        except Exception as error:
            told(End(None, error))
        else:
            if type(value) is Call:
                self._asking = value
            else:
                told(End(value, None))
        return True

    def _late(self, call: Call) -> None:
        if call is self._asking:
            self._asking = False
            self._free()

    def _stuck(self, call: Call) -> None:
        self._on_error(
            DeviceLostError(self.name, f"{call} was given up and does not end")
        )

    async def _listen(self) -> None:
        sensor, opening = self.sensor, self.calls.opening
        while True:
            try:
                stream = sensor.stream()
                if isinstance(stream, AsyncIterator):
                    async for value in stream:
                        if not self._heard(value, opening):
                            return
                elif not await self._listen_blocking(iter(stream), opening):
                    return
            except asyncio.CancelledError as error:
                if opening != self.calls.opening:
                    raise
                self._stream_failed(error, opening)  # the driver's own
            except BaseException as error:  # a driver may raise anything
                if opening != self.calls.opening:
                    return
                self._stream_failed(error, opening)
            else:
                ended = DeviceLostError(self.name, "its stream has ended")
                self._stream_failed(ended, opening)
            if opening != self.calls.opening:
                return  # the device is gone; its next opening begins anew
            await asyncio.sleep(LISTEN_AGAIN)

    async def _listen_blocking(self, values: Iterator[Any], opening: int) -> bool:
        # A thread of its own: waiting for the next value must not block the bus.
        executor = await self.driver.stream_executor()
        end = object()
        while (
            value := await executor.call(next, values, end, timeout=math.inf)
        ) is not end:
            if not self._heard(value, opening):
                return False
        return True

    def _heard(self, value: Any, opening: int) -> bool:
        """Bring in what the device has pushed, unless its opening is over."""
        if opening == self.calls.opening:
            self._door.end((self.name, "pushed"), self._pushed, value, None, opening)
            return opening == self.calls.opening
        self.calls.late += 1
        return False

    def _pushed(self, value: Any, error: BaseException | None, opening: int) -> None:
        """Publish what the device has pushed, or the error of its stream."""
        if opening != self.calls.opening:
            self.calls.late += 1
            return
        if isinstance(self._door.tape, Recorder):
            self._door.tape.arrived((self.name, "pushed"), (value, error, opening))
        if error is None:
            self.publish(value, math.inf)
        else:
            self._fail(error, math.inf)

    def _stream_failed(self, error: BaseException, opening: int) -> None:
        self._door.end((self.name, "pushed"), self._pushed, None, error, opening)

    def publish(self, value: Any, number: float) -> None:
        """Give a new value to everybody who waits or follows."""
        now = time = self.time()
        wrong: str | None = None
        if type(value) is Stamped:
            measured = measured_at(value, now)
            if isinstance(measured, str):
                wrong = measured
            else:
                time = measured
            value = value.value
        wrong = wrong or self._check_value(value)
        if wrong is not None:
            self.bad += 1
            self._fail(DeviceFaultError(self.name, wrong), number)
            return
        if self._max_repeat is not None and self._repeated(value) > self._max_repeat:
            frozen = f"frozen: it gave {value!r:.80} {self._repeats} times in a row"
            self._fail(DeviceFaultError(self.name, frozen), number)
            return
        self.sequence += 1
        reading: Reading[Any]
        if time == now:
            reading = Reading(value, now, self.sequence)
        else:
            reading = StampedReading.at(value, time, self.sequence, now)
        self.newest = reading
        self._history.append(reading)
        if self._journal.heard:
            self._journal.publish(Kind.READING, self.name, "", reading)
        if self._waiters:
            self._resolve(reading, number)
        for follower in self._followers:
            follower.feed(reading)

    def _repeated(self, value: Any) -> int:
        if self._repeats == 0 or not _equal(value, self._last):
            self._last, self._repeats = value, 0
        self._repeats += 1
        return self._repeats

    def _resolve(self, reading: Reading[Any], number: float) -> None:
        waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            need, future = waiter
            if future.done():
                continue
            if need <= number:
                future.set_result(reading)
            else:
                self._waiters.append(waiter)

    def _fail(self, error: BaseException, number: float) -> None:
        if isinstance(error, TimeoutError) and not isinstance(error, EsairError):
            stuck = DriverStuckError(self.name, "read", self.sensor.deadline)
            stuck.__cause__ = error
            error = stuck
        translated = translate(self.name, error)
        waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            need, future = waiter
            if future.done():
                continue
            if need <= number:
                future.set_exception(translated)
            else:
                self._waiters.append(waiter)
        for follower in self._followers:
            follower.doubt(translated)
        self._on_error(translated)

    def drop(self, registration: Registration) -> None:
        """Feed nothing more to the followers with this registration."""
        error = self.registrations.refusal(registration)
        self.operations.drop(registration)
        for follower in self._followers:
            if follower.registration is registration:
                self.unfollow(follower)
                follower.changed(error)

    def removed(self) -> None:
        """Tell everybody that the user took the sensor away."""
        self.down(ResourceState.REMOVED, ResourceRemovedError(self.name))


def _equal(one: Any, other: Any) -> bool:
    try:
        same = one == other
        return bool(same.all()) if hasattr(same, "all") else bool(same)
    except Exception:  # a value may be an object of any class
        return False
