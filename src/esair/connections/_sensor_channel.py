"""The way of data from one sensor: newest reading, waiting readers, followers.

A sensor may have no device: what an actuator has applied last is read by the same way, and
what is computed of other readings.
"""

from __future__ import annotations

import collections
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from esair.connections._calls import Call, End, Method, translate_call
from esair.connections._device import Device, OfRobot, Operating
from esair.connections._gate import Registration, Registrations
from esair.connections._hearing import READY, Asking, Listening
from esair.connections._values import ReadingCheck, measured_at
from esair.exceptions import (
    BadValueError,
    DeviceFaultError,
    EsairError,
    NoTurnError,
    ResourceRemovedError,
    StaleReadingError,
)
from esair.flaws import owned, read_only
from esair.journal import Kind
from esair.loop import Order, Stepping
from esair.messages import (
    OpenReading,
    Reading,
    ResourceState,
    Stamped,
    StampedReading,
)
from esair.resources import APPLIED, HOLD, Actuator, Sensor
from esair.values import passes_as

PERIODS = 3.0
"""How many periods old a reading of a device that is asked may be, if nobody says."""

ANSWERS_WITHIN = 1.0
"""How long a read waits for the device unless it says otherwise, in seconds."""

GRACE = 1e-5
"""How many seconds what a step decides on may be older: timers are early."""


_new = tuple.__new__  # hot


class Follower(Protocol):
    """Gets every new reading of a sensor, at once, in the loop."""

    @property
    def registration(self) -> Registration | None:
        """The right by which it follows; None if it hands nothing on."""

    @property
    def order(self) -> Order:
        """When it is told of what happens in one moment: a guard is the last."""

    def feed(self, reading: Reading[Any]) -> None:
        """Take a new reading; must not wait."""

    def changed(self, error: EsairError | None) -> None:
        """Learn that the sensor is gone for now (why), or back (None)."""

    def limited(self) -> None:
        """Learn that the sensor's own greatest age of a reading has changed."""

    def doubt(self, error: EsairError) -> None:
        """Learn that it has given a bad value, or an error instead of one."""


class SensorChannel(Device):
    """Reads one sensor for everybody who asks; one transaction serves them all."""

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_check",
        "_followers",
        "_history",
        "_listening",
        "asking",
        "bad",
        "dropped",
        "good_for",
        "max_age",
        "newest",
        "sequence",
    )

    def __init__(self, sensor: Sensor[Any], robot: OfRobot) -> None:
        super().__init__(sensor.name, robot)
        self.newest: Reading[Any] | None = None
        self.bad: int = 0
        """How many readings were of a wrong type, not finite, or outside the limits."""
        self.dropped: int = 0
        """How many readings a slow follower has not seen, or came after newer ones."""
        self.sequence: int = 0
        self._followers: tuple[Follower, ...] = ()
        self.asking: Asking = Asking(self)
        self._listening = Listening(self)
        self.attach(sensor)

    def attach(self, sensor: Sensor[Any]) -> None:
        """Read this sensor from now on; it is not ready yet."""
        self._history: collections.deque[Reading[Any]] = collections.deque(
            maxlen=sensor.history_size
        )
        self._check = ReadingCheck(sensor)
        self.take(sensor, self, self._late)
        self.configured()

    def configured(self) -> None:
        """Take over a changed rate, or deadline."""
        sensor = self.sensor
        self.asking.configured(sensor)
        if sensor.can_be_asked:
            self.good_for: float = 1.0 / sensor.rate
            self.max_age: float = PERIODS / sensor.rate
        else:
            self.good_for = math.inf
            self.max_age = math.inf if sensor.period is None else sensor.period
        if self.asking.stop_polling():
            self._start_polling()
        for follower in self._followers:
            follower.limited()

    @property
    def sensor(self) -> Sensor[Any]:
        """What is asked, or pushes."""
        sensor: Sensor[Any] = self.driver.resource  # type: ignore[assignment]
        return sensor

    @property
    def successes(self) -> int:
        """How many values the device has given."""
        return self.sequence

    @property
    def sampled(self) -> tuple[SensorChannel, ...]:
        """The sensors that are asked for its readings: itself, if it is asked."""
        return (self,) if self.sensor.can_be_asked else ()

    def counts(self) -> dict[str, int]:
        return {
            "readings": self.sequence,
            "transactions": self.asking.transactions,
            "missed": self.asking.missed,
            "bad": self.bad,
            "dropped": self.dropped,
            "turned_away": self.asking.waiting.turned_away,
            "abandoned": self.calls.abandoned,
            "late": self.calls.late,
        }

    # State, told by the supervisor.

    def up(self) -> None:
        """The device is ready: begin to listen, and to ask if somebody follows."""
        self.state = READY
        self.error = None
        if self._check.frozen is not None:
            self._check.frozen.begin_anew()
        if self.newest is None and hasattr(self.sensor, "initial"):
            self.publish(self.sensor.initial, -1)
        if self.sensor.pushes:
            self._listening.begin()
        self._start_polling()
        for follower in self._followers:
            follower.changed(None)

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: tell everybody who reads it."""
        self.state = state
        self.error = error
        self.newest = None
        self.asking.stop_polling()
        self.calls.next_opening(error)
        self.asking.down(error)
        for follower in self._followers:
            follower.changed(error)
        self.asking.answered()
        self.operations.gone(error)

    def removed(self) -> None:
        """The user took the device away."""
        self.down(ResourceState.REMOVED, ResourceRemovedError(self.name))

    def forget_age(self) -> None:
        """Make every reading stale, as after a suspend of the computer."""
        self.newest = None
        self.asking.forget()
        error = StaleReadingError(self.name, None, self.good_for)
        for follower in self._followers:
            follower.changed(error)

    # Readers.

    def cached(self, registration: Registration, limit: float) -> Reading[Any] | None:
        """Return the newest reading if it is good enough, without any wait."""
        if not registration.usable:
            raise self.registrations.refusal(registration)
        reading = self.newest
        if reading is not None and self.time() - reading.time <= limit:
            return reading
        return None

    def known(self, registration: Registration, limit: float) -> Reading[Any]:
        """Return the newest reading, or raise because there is none that is current."""
        self._check_right(registration)
        reading = self.newest
        age = None if reading is None else self.time() - reading.time
        deciding = Stepping.of(self.loop).runner is not None
        if reading is None or age is None or age > limit + GRACE * deciding:
            raise StaleReadingError(self.name, age, limit)
        return reading

    async def ask(
        self, registration: Registration, *, fresh: bool, max_age: float, timeout: float
    ) -> Reading[Any]:
        """Return a reading that is good enough, asking the device or waiting for it."""
        self._check_right(registration)
        if not fresh and not self.sensor.can_be_asked and self.newest is not None:
            # A device that pushes cannot be asked; it has been silent for too long.
            raise StaleReadingError(self.name, self.time() - self.newest.time, max_age)
        need = self.asking.next_answer(fresh=fresh)
        self.asking.ask()
        # What is computed is of readings that its sources were asked for since.
        measured = fresh and not self.sensor.is_computed
        since = self.time() if measured else -math.inf
        reading = await self.asking.waiting.reading(need, timeout, since)
        self._check_right(registration)
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
                self.name, "history", f"expected 0 or more, not {count!r:.80}"
            )
        return list(self._history)[-count:] if count > 0 else []

    def _check_right(self, registration: Registration) -> None:
        if not registration.usable:
            raise self.registrations.refusal(registration)
        if self.state is not READY:
            raise self.absence()

    def silent(self, timeout: float) -> StaleReadingError:
        """Make the error of a reader whom the device has not answered in time."""
        newest, now = self.newest, self.time()
        if newest is None:
            return StaleReadingError(self.name, None, timeout, silent=True)
        silent = newest.arrived + timeout <= now
        return StaleReadingError(self.name, now - newest.time, timeout, silent=silent)

    # Followers.

    def follow(self, follower: Follower) -> None:
        """Feed every new reading to a follower; polls the device meanwhile."""
        if follower not in self._followers:
            followers = (*self._followers, follower)
            self._followers = tuple(sorted(followers, key=lambda each: each.order))
            self._start_polling()

    def unfollow(self, follower: Follower) -> None:
        self._followers = tuple(f for f in self._followers if f is not follower)
        if not self._followers:
            self.asking.stop_polling()

    def _start_polling(self) -> None:
        if self._followers:
            self.asking.start_polling(self.sensor, self._check, self._history)

    # Operations, and calls between two questions.

    def ready_for(self, operation: Operating) -> bool:
        """Tell whether an operation may begin now."""
        return not self.asking.busy

    def operating(self, operation: Operating, call: Call) -> None:
        """The device has begun with an operation, and is busy."""
        self.asking.busy = call

    def operated(self, call: Call | None) -> None:
        """An operation has its outcome; the device is free if it has ended."""
        if call is not None:
            self.asking.ended(call)
        self.asking.free()

    def between(
        self, method: Method, told: Callable[[End], None], limit: float
    ) -> Call | bool:
        """Call the driver between two questions; returns what is false if it is not free."""
        asking = self.asking
        if asking.busy:
            return False

        def ended(call: Call, end: End) -> None:
            if call.ended is not None:
                asking.busy = False
            told(end)
            asking.free()

        waits = self.calls.attempt(method, limit, told, ended)
        if waits is not None:
            asking.busy = waits
        return waits or True

    def _late(self, call: Call) -> None:
        """A call has ended whose outcome was out before."""
        if call is self.asking.busy:
            self.asking.ended(call)
            self.asking.free()

    # Values.

    def publish(self, value: Any, number: float) -> None:
        """Give a new value to everybody who waits or follows."""
        clock, check = self.time, self._check  # hot
        now = clock()
        time: float | None = None
        wrong: str | None = None
        if type(value) is Stamped:
            if isinstance(measured := measured_at(value, now), str):
                wrong = measured
            else:
                time = measured
            value = value.value
        wrong = wrong or check.wrong(value)
        if wrong is not None:
            self.bad += 1
        else:
            if check.is_open:  # its driver may fill the same buffer again
                value = owned(read_only(value))
            if check.frozen is not None:
                wrong = check.frozen(value)
        if wrong is not None:
            self.fail(DeviceFaultError(self.name, wrong), number)
            return
        newer = self.newest
        if time is not None and newer is not None and self._overtaken(newer, time):
            self.dropped += 1
            self.asking.waiting.answer(number, newer)
            return
        sequence = self.sequence = self.sequence + 1
        reading: Reading[Any]
        if check.is_open:
            at = now if time is None else time
            reading = OpenReading.at(value, at, sequence, now)
            reading.is_stamped = time is not None
        elif time is None:
            reading = _new(Reading, (value, now, sequence))
        else:
            reading = StampedReading.at(value, time, sequence, now)
        self.newest = reading
        self._history.append(reading)
        if self._journal.heard.reading:
            self._journal.publish(Kind.READING, self.name, "", reading)
        waiting = self.asking.waiting
        if waiting.readers:
            waiting.answer(number, reading)
        for follower in self._followers:
            follower.feed(reading)

    def _overtaken(self, newer: Reading[Any], time: float) -> bool:
        """Tell whether a value was measured before the newest reading, and came late."""
        is_one = isinstance(newer, StampedReading) and newer.is_stamped
        return is_one and not self.sensor.is_computed and time < newer.time

    def fail(self, error: BaseException, number: float = math.inf) -> None:
        """Take note of what came instead of a value; those who wait are told."""
        deadline = self.sensor.deadline
        translated = translate_call(self.name, "read", deadline, error)
        self.asking.waiting.answer(number, translated)
        if type(translated) is not NoTurnError:  # it is late, and stale in its time
            for follower in self._followers:
                follower.doubt(translated)
        self.robot.on_error(translated)

    def drop(self, registration: Registration) -> None:
        error = self.registrations.refusal(registration)
        self.operations.drop(registration)
        for follower in self._followers:
            if follower.registration is registration:
                self.unfollow(follower)
                follower.changed(error)


class Applied(Sensor[Any]):
    """What an actuator has applied last: ``valve.applied``."""

    def __init__(self, actuator: Actuator[Any]) -> None:
        super().__init__()
        self._name = actuator.name + APPLIED
        self._type = actuator.value_type

    @property
    def value_type(self) -> Any:
        return self._type


class AppliedChannel(SensorChannel):
    """Reads what an actuator has applied last; the actuator's own channel fills it."""

    def __init__(self, actuator: Actuator[Any], registrations: Registrations) -> None:
        robot = OfRobot(registrations, lambda _error: None, set())
        super().__init__(Applied(actuator), robot)

    def took(self, command: Any) -> None:
        """Give a command that was applied; nobody knows where it is if that is HOLD."""
        if self.state is not ResourceState.READY:
            return
        if command is None or command is HOLD:
            self.forget_age()
        else:
            self.publish(command, float("inf"))


class Source(NamedTuple):
    """One sensor that another one is computed of."""

    channel: SensorChannel
    registration: Registration
    max_age: float | None = None  # in seconds; its own limit if it is None
    optional: bool = False  # whether the other one is computed without it as well


class Computation(NamedTuple):
    """How a sensor is computed of others."""

    sources: tuple[Source, ...] = ()  # empty until all of that is there
    catch_up: Callable[[], bool] = bool
    """Computes at once what waits for its place in the turn; tells whether the newest
    reading is of the newest readings of the sources then."""


class DerivedChannel(SensorChannel):
    """Reads what is computed of other readings; it has no device that is asked."""

    computation: Computation = Computation()

    def configured(self) -> None:
        """Take over changed settings: how long a reading is good is no setting."""
        self.good_for = math.inf
        self.max_age = getattr(self, "max_age", math.inf)

    def computed_by(self, computation: Computation) -> None:
        """Be computed so from now on; while it is there, who follows hears of it."""
        self.computation = computation
        if self.state is ResourceState.READY:
            for follower in self._followers:
                follower.changed(None)

    @property
    def sampled(self) -> tuple[SensorChannel, ...]:
        sources = self.computation.sources
        found = (each for source in sources for each in source.channel.sampled)
        return tuple(dict.fromkeys(found))

    @property
    def depth(self) -> int:
        """How many computations come before it, one of the other."""
        channels = [source.channel for source in self.computation.sources]
        below = [each.depth for each in channels if isinstance(each, DerivedChannel)]
        return 1 + max(below) if below else 0

    def publish_until(self, value: Any, oldest: float, stale_at: float) -> bool:
        """Give a value to everybody who waits or follows; tells whether it was good."""
        time: float | str = oldest
        if type(value) is Stamped:
            time = measured_at(value, self.time())
        else:
            value = Stamped(value, oldest)
        before = self.max_age, self.sequence
        if isinstance(time, float):
            self.max_age = stale_at - time  # that of this very reading
        self.publish(value, math.inf)
        if self.sequence != before[1]:
            return True
        self.max_age = before[0]
        return False

    async def ask(
        self, registration: Registration, *, fresh: bool, max_age: float, timeout: float
    ) -> Reading[Any]:
        """Return a reading that is good enough; a fresh one is of fresh readings."""
        until = self.time() + timeout
        if fresh and self.state is ResourceState.READY:
            self._check_right(registration)
            for each in self.computation.sources:
                if each.optional:
                    continue
                limit = each.max_age
                await each.channel.ask(
                    each.registration,
                    fresh=True,
                    max_age=each.channel.max_age if limit is None else limit,
                    timeout=max(0.0, until - self.time()),
                )
            if self.computation.catch_up():
                return self.known(registration, max_age)
        return await super().ask(
            registration,
            fresh=fresh,
            max_age=max_age,
            timeout=max(0.0, until - self.time()),
        )
