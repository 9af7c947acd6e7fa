"""The sensor and the actuator connection, and the ports that they hand out."""

from __future__ import annotations

import asyncio
from collections.abc import (
    AsyncGenerator,
    AsyncIterator,
    Awaitable,
    Callable,
    Generator,
    Mapping,
)
from threading import get_ident
from typing import Any, ClassVar, Final, Generic, NamedTuple, TypeVar

from esair.abc import Connection
from esair.connections._actuator_channel import ActuatorChannel
from esair.connections._gate import Registration, refusal, run_ended
from esair.connections._protection import Protections
from esair.connections._sensor_channel import ANSWERS_WITHIN, SensorChannel
from esair.exceptions import (
    EsairError,
    UnknownNameError,
    WrongLoopError,
)
from esair.loop import (
    READ_COST,
    WRITE_COST,
    Budget,
    Order,
    current_owner,
    fail,
    speaks_for_nobody,
)
from esair.messages import Answer, Reading, Refused, ResourceState, Why, Written
from esair.resources import Operation
from esair.values import check_duration

running_loop = asyncio._get_running_loop  # noqa: SLF001 - it does not raise

T = TypeVar("T")
C = TypeVar("C", SensorChannel, ActuatorChannel)


class Control(NamedTuple):
    """The control path of a port, which the resource supervisor gives.

    Attributes:
        configure: Changes settings, by a right; they are given by their names.
        operate: Calls an operation, by a right and the name of the operation.
    """

    configure: Callable[..., Awaitable[None]]
    operate: Callable[..., Awaitable[Any]]


class Port(Generic[T]):
    """The way of one action to one device.

    Attributes:
        registration: The right to use it.
    """

    __slots__ = ("_budget", "_channel", "_control", "_home", "_loop", "registration")

    _channel: SensorChannel | ActuatorChannel

    def __init__(
        self,
        channel: SensorChannel | ActuatorChannel,
        registration: Registration,
        control: Control,
    ) -> None:
        self._channel = channel
        self.registration: Registration = registration
        self._control = control
        self._loop = channel.loop
        self._home = channel.home
        self._budget = Budget.of(channel.loop)

    def revive(self, channel: Any, registration: Registration) -> None:
        """Live again, with a device that has come back under the same name."""
        self._channel = channel
        self.registration = registration

    def _check_run(self) -> None:
        """Pass in the robot's event loop, while the run lasts that the port is of."""
        self._check_loop()
        if speaks_for_nobody():
            raise run_ended(self.registration.behavior, self.resource)

    def _check_loop(self) -> None:
        """Pass in the event loop of the robot, in no other one."""
        if running_loop() is not self._loop:
            raise WrongLoopError(self.registration.behavior, self.resource)

    @property
    def resource(self) -> str:
        """The name of the device."""
        return self.registration.resource

    async def configure(self, /, **settings: Any) -> None:
        """Change settings of the device: all of them, or none.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``.
            BadValueError: A setting is unknown, or a value is not allowed.
        """
        self._check_run()
        await self._control.configure(self.registration, **settings)

    async def operate(self, name: str, /, **parameters: Any) -> Any:
        """Call an operation of the device, such as ``home``, and wait for its outcome.

        Args:
            name: The name of the operation.
            **parameters: What it takes, by name; checked before anything is done.

        Returns:
            What the operation returns.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``, or
                somebody else holds the actuator.
            UnknownNameError: There is no such operation.
            BadValueError: A parameter is unknown, missing, or not allowed.
            HaltedError: The robot is halted.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
            DriverStuckError: It did not end within its deadline.
        """
        self._check_run()
        return await self._control.operate(self.registration, name, **parameters)

    @property
    def operations(self) -> Mapping[str, Operation]:
        """What can be called by `operate`, by name, with its parameters."""
        return self._channel.driver.resource.operations

    @property
    def settings(self) -> Mapping[str, Any]:
        """The current settings of the device."""
        return self._channel.driver.resource.settings

    @property
    def state(self) -> ResourceState:
        """What the device is doing."""
        return self._channel.state

    def __repr__(self) -> str:
        return f"<port of {self.registration!r}>"


class SensorPort(Port[T]):
    """The way of one action to one sensor.

    Attributes:
        resource: The name of the sensor.
        registration: The right to read it.
        max_age: The greatest age of a reading unless a call says otherwise, in
            seconds; the sensor's own limit unless given, infinite if it has none.
    """

    __slots__ = ("_max_age",)

    _channel: SensorChannel

    def __init__(
        self,
        channel: SensorChannel,
        registration: Registration,
        max_age: float | None,
        control: Control,
    ) -> None:
        super().__init__(channel, registration, control)
        self._max_age = max_age

    @property
    def max_age(self) -> float:
        """The greatest age of a reading unless a call says otherwise, in seconds."""
        return self._channel.max_age if self._max_age is None else self._max_age

    async def read(
        self,
        *,
        fresh: bool = False,
        max_age: float | None = None,
        timeout: float | None = None,
    ) -> T:
        """Return a value: the newest one, or one that is newer than now.

        The device is asked when its newest reading is older than its period.

        Args:
            fresh: Only a value that was measured after this call.
            max_age: The greatest age, in seconds; the port's unless given.
            timeout: How long to wait for the device; 1 s unless given.

        Raises:
            StaleReadingError: There is no reading that is fresh enough.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
            ResourceRemovedError: The user took the sensor away.
            NotRegisteredError: The registration was revoked.
            WrongLoopError: It has to ask the device, or to wait, in another event loop
                than the robot's.
        """
        budget = self._budget
        budget.late -= READ_COST
        if budget.clock() > budget.late:
            await budget.give_way()
        if not fresh and max_age is None and timeout is None:
            # Most reads end here: the newest reading is good enough.
            channel = self._channel
            newest = channel.newest
            if newest is not None and self.registration.usable:
                limit = self._max_age
                if limit is None:
                    limit = channel.max_age
                if limit > channel.good_for:
                    limit = channel.good_for
                time = channel.time  # hot
                if time() - newest[1] <= limit:  # hot
                    return newest[0]  # type: ignore[no-any-return]
        return (await self.reading(fresh=fresh, max_age=max_age, timeout=timeout)).value

    async def reading(
        self,
        *,
        fresh: bool = False,
        max_age: float | None = None,
        timeout: float | None = None,
    ) -> Reading[T]:
        """Return what `read` does, with its time and sequence number."""
        self._check_loop()
        budget = self._budget
        budget.late -= READ_COST
        if budget.clock() > budget.late:
            await budget.give_way()
        channel = self._channel
        limit = (
            self.max_age
            if max_age is None
            else check_duration(self.resource, "max_age", max_age)
        )
        if timeout is not None:
            check_duration(self.resource, "timeout", timeout)
        if not fresh:
            reading = channel.cached(self.registration, min(limit, channel.good_for))
            if reading is not None:
                return reading
        return await channel.ask(
            self.registration,
            fresh=fresh,
            max_age=limit,
            timeout=ANSWERS_WITHIN if timeout is None else timeout,
        )

    def __aiter__(self) -> AsyncIterator[T]:
        """Yield each new value; a slow reader misses some and gets the newest.

        It waits while the device is lost and for a value that is not older than
        `max_age`, and raises when the sensor is removed.
        """
        return self._values()

    async def _values(self) -> AsyncGenerator[T, None]:
        self._check_loop()
        await Budget.spend()  # whoever begins again and again has lost its sensor
        stream = _Stream(self)
        self._channel.follow(stream)
        try:
            while True:
                reading = await stream.next()
                self._budget.late -= READ_COST
                if self._budget.clock() > self._budget.late:
                    await self._budget.give_way()
                yield reading.value
        finally:
            self._channel.unfollow(stream)

    @property
    def newest(self) -> Reading[T]:
        """The newest reading, without a wait, as a reaction sees it.

        Raises:
            StaleReadingError: There is none, or it is older than `max_age`.
            DeviceLostError: The device is not there.
            ResourceRemovedError: The user took the sensor away.
            NotRegisteredError: The registration was revoked.
        """
        return self._channel.known(self.registration, self.max_age)

    def history(self, count: int) -> list[Reading[T]]:
        """Return the last readings, the oldest first; at most `history_size` of them."""
        return self._channel.history(self.registration, count)


class _Stream:
    """What one loop over a port has seen, and whether it waits for more."""

    order = Order.WAKE

    def __init__(self, port: SensorPort[Any]) -> None:
        self.registration = port.registration
        self._port = port
        self._channel = port._channel  # noqa: SLF001 - two halves of one
        self._seen = self._channel.sequence
        self._waiting: asyncio.Future[Reading[Any]] | None = None

    def feed(self, reading: Reading[Any]) -> None:
        waiting = self._waiting
        if waiting is None or waiting.done():
            return  # who is late gets what is current then
        if self._channel.time() - reading.time <= self._port.max_age:
            waiting.set_result(reading)

    def changed(self, error: EsairError | None) -> None:
        if error is not None and not self.registration.usable:
            fail(self._waiting, error)

    def limited(self) -> None:
        """Each loop decides by itself what is too old."""

    def doubt(self, error: EsairError) -> None:
        """Wait for the next good value."""

    async def next(self) -> Reading[Any]:
        """Return the newest reading that was not seen, as soon as it is current."""
        reading = self._channel.cached(self.registration, self._port.max_age)
        if reading is None or reading.sequence <= self._seen:
            self._waiting = asyncio.get_running_loop().create_future()
            reading = await self._waiting
        self._channel.dropped += reading.sequence - self._seen - 1
        self._seen = reading.sequence
        return reading


class ActuatorPort(Port[T]):
    """The way of one action to one actuator.

    Attributes:
        registration: The right to write it.
    """

    __slots__ = ()

    _channel: ActuatorChannel

    async def write(
        self,
        command: T,
        *,
        hold: float | None = None,
        expires: float | None = None,
    ) -> Written[T] | Refused:
        """Send a command, and hold the actuator for a while.

        Args:
            command: A command of the actuator's type, finite and within limits.
            hold: For how long nobody of the same or a lower priority gets through,
                in seconds; the actuator's command timeout unless given. Each write
                renews it.
            expires: A moment on the loop's clock (seconds): a command that still waits
                for its turn then is refused, and never sent; a motion that it has taken
                over by then ends.

        Returns:
            What was really sent; or a refusal, false in a condition, that says who
            holds the actuator.

        Raises:
            BadValueError: The command must not be sent; nothing was.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device did not take it.
            DriverStuckError: The driver did not return in time, or the turn of this
                command did not come in that time.
            ResourceRemovedError: The user took the actuator away.
            NotRegisteredError: The registration was revoked.
            WrongLoopError: It is called in another event loop than the robot's.
        """
        if get_ident() != self._home:  # hot
            self._check_loop()
        budget = self._budget
        budget.late -= WRITE_COST
        if budget.clock() > budget.late:
            await budget.give_way()
        if hold is not None:
            check_duration(self.resource, "hold", hold)
        owner = current_owner()
        if owner is not None and owner.over:
            raise run_ended(self.registration.behavior, self.resource)
        outcome = self._channel.begin(self.registration, command, hold, expires=expires)
        if type(outcome) is Written or isinstance(outcome, Answer):
            return outcome
        return await outcome

    def release(self) -> Awaitable[None]:
        """Give the actuator back at once: lower priorities get through.

        It is done when this returns; it may be awaited, like the other verbs of a port.
        """
        self._check_loop()
        self._channel.release(self.registration)
        return DONE

    async def _let_go(self) -> bool:
        """Give it back, and make it safe if what it does is this port's will.

        Tells, when that is done, whether the device has answered, if it was told so.
        """
        channel = self._channel
        channel.release(self.registration)
        channel.drop(self.registration)
        await channel.safe.settled()
        told = channel.told()
        return told.answered or not told.safe

    def why(self) -> Why:
        """Tell who holds the actuator, by which rule, and what would free it."""
        return self._channel.why()

    @property
    def command_timeout(self) -> float:
        """After how many seconds without a write the device gets its safe command."""
        return self._channel.wire.command_timeout


class _Done:
    """What is over: awaiting it only counts."""

    def __await__(self) -> Generator[Any, None, None]:
        return Budget.spend().__await__()


DONE: Final = _Done()
"""What a verb returns that is done when it returns, and that may be awaited."""


class Ways(Connection, Generic[C]):
    """The ways to all devices of one kind, and the ports that lead there."""

    kind: ClassVar[str]

    def __init__(self) -> None:
        self.channels: dict[str, C] = {}
        """The way to each device; the resource supervisor fills it."""
        self.control: Control
        """The control path of the ports; the resource supervisor gives it."""

    def names(self) -> list[str]:
        """Return the names of the devices."""
        return list(self.channels)

    def channel(self, name: str) -> C:
        """Return the way to one device.

        Raises:
            UnknownNameError: No device of the kind has the name.
        """
        try:
            return self.channels[name]
        except KeyError:
            raise UnknownNameError(self.kind, name, self.channels) from None

    def way_of(self, registration: object) -> C:
        """Return the way that a registration gives a right to."""
        channel = self.channels.get(getattr(registration, "resource", ""))
        if channel is not None:
            channel.registrations.check(registration)  # type: ignore[arg-type]
            return channel
        if not isinstance(registration, Registration) or registration.reason:
            raise refusal(registration)
        raise UnknownNameError(self.kind, registration.resource, self.channels)


class SensorConnection(Ways[SensorChannel]):
    """Reads sensors for whoever is registered, whatever bus is behind them."""

    kind = "sensor"

    def port(
        self, registration: Registration, *, max_age: float | None = None
    ) -> SensorPort[Any]:
        """Hand out a port to whoever is registered.

        Args:
            registration: The right to read.
            max_age: The greatest age of its readings, in seconds; the sensor's own
                limit unless given.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
        """
        channel = self.way_of(registration)
        if max_age is not None:
            check_duration(channel.name, "max_age", max_age)
        return SensorPort(channel, registration, max_age, self.control)

    async def read(
        self,
        registration: Registration,
        *,
        fresh: bool = False,
        max_age: float | None = None,
        timeout: float | None = None,
    ) -> Reading[Any]:
        """Return a reading: the newest one, or one that is newer than now.

        The device is asked when the newest reading is older than its period; one
        transaction serves all who ask at the same moment.

        Args:
            registration: The right to read.
            fresh: Only a value that was measured after this call.
            max_age: The greatest age of the reading, in seconds; the sensor's own limit
                unless given.
            timeout: How long to wait for the device, in seconds.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
            StaleReadingError: There is no reading that is fresh enough.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
        """
        port = self.port(registration)
        return await port.reading(fresh=fresh, max_age=max_age, timeout=timeout)


class ActuatorConnection(Ways[ActuatorChannel]):
    """Writes actuators for whoever is registered; priority decides who moves one."""

    kind = "actuator"

    def __init__(self) -> None:
        super().__init__()
        self.protections: Protections = Protections(self.channels)
        """Who keeps an actuator still, by component and name of the actuator."""

    def port(self, registration: Registration) -> ActuatorPort[Any]:
        """Hand out a port to whoever is registered.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
        """
        return ActuatorPort(self.way_of(registration), registration, self.control)

    async def write(
        self, registration: Registration, command: Any, *, hold: float | None = None
    ) -> Written[Any] | Refused:
        """Send a command, or say who holds the actuator.

        Args:
            registration: The right to write.
            command: A command of the actuator's type, finite and within limits.
            hold: For how long it holds the actuator, in seconds; the actuator's
                command timeout unless given.

        Returns:
            What was really sent, or a refusal, which is false in a condition.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
            BadValueError: The command must not be sent.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device did not take it.
        """
        return await self.port(registration).write(command, hold=hold)
