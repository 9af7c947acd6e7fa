"""One device, whatever it is: its driver, its state, and its operations."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs

from esair.connections._calls import (
    OPERATE,
    Call,
    Calls,
    Driver,
    End,
    Method,
    given_up,
    translate_call,
)
from esair.connections._gate import Registration, Registrations
from esair.exceptions import (
    DeviceLostError,
    DriverStuckError,
    EsairError,
    HaltedError,
    describe,
)
from esair.journal import Kind
from esair.loop import CallRefused, Deadlines, clock_of
from esair.messages import ResourceState

if TYPE_CHECKING:
    from esair.connections._actuator_channel import ActuatorChannel
    from esair.connections._sensor_channel import SensorChannel


class OfRobot(NamedTuple):
    """What a device needs of its robot."""

    registrations: Registrations
    on_error: Callable[[Exception], None]  # told what its calls meet
    left: set[Call]  # gets each abandoned call while it is alive


class Device:
    """One device, whatever it is: its driver, the calls of that, and its state."""

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_journal",
        "calls",
        "driver",
        "error",
        "home",
        "loop",
        "name",
        "operations",
        "registrations",
        "robot",
        "state",
        "time",
    )

    def __init__(self, name: str, robot: OfRobot) -> None:
        self.name: str = name
        self.state: ResourceState = ResourceState.CLOSED
        self.error: EsairError | None = None
        self.registrations: Registrations = robot.registrations
        self.robot: OfRobot = robot
        self._journal = self.registrations.journal
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self.home: int = threading.get_ident()  # the thread of that loop
        self.time: Callable[[], float] = clock_of(self.loop)

    def take(
        self,
        resource: Any,
        channel: ActuatorChannel | SensorChannel,
        on_late: Callable[[Call], None],
    ) -> None:
        """Ask or write this one from now on; it is not ready yet."""
        self.driver: Driver = Driver(resource)
        self.calls: Calls = Calls(
            self.driver,
            self.loop,
            on_late=on_late,
            on_stuck=lambda call: self.robot.on_error(given_up(call)),
            left=self.robot.left,
        )
        if not hasattr(self, "operations"):
            self.operations: Operations = Operations(channel)

    def absence(self) -> EsairError:
        """Return what whoever needs the device gets while it is not ready."""
        error = self.error or DeviceLostError(self.name, f"it is {self.state.value}")
        # Anew: else each who asks would leave its frames in the traceback.
        return error.with_traceback(None)


@attrs.define(eq=False)
class Operating:
    """One operation that was asked for: it waits for its turn, or runs."""

    registration: Registration
    name: str
    parameters: dict[str, Any]
    until: float
    limit: float
    outcome: asyncio.Future[Any]
    free: Callable[[], None]  # called when it is over: the device is for others then
    call: Call | None = None
    ended_by: EsairError | None = None  # why it was ended before its time

    def __repr__(self) -> str:
        given = ", ".join(f"{key}={value!r}" for key, value in self.parameters.items())
        return f"<operation {self.name}({given})>"


@attrs.define(eq=False)
class Errand:
    """A call of the driver that waits until the device does nothing else, or runs."""

    method: Method
    limit: float
    outcome: asyncio.Future[End]
    call: Call | bool = False  # true if it has begun

    def told(self, end: End) -> None:
        if not self.outcome.done():
            self.outcome.set_result(end)


class Operations:
    """Runs the operations and errands of a device; its caller lets one in at a time."""

    __slots__ = ("_device", "_loop", "current", "errand")

    def __init__(self, device: ActuatorChannel | SensorChannel) -> None:
        self._device = device
        self._loop = device.loop
        self.current: Operating | None = None  # what waits for its turn, or runs
        self.errand: Errand | None = None

    async def run(
        self,
        registration: Registration,
        name: str,
        parameters: dict[str, Any],
        until: float,
        limit: float,
        free: Callable[[], None],
    ) -> Any:
        """Call an operation when the device is free, and wait for its outcome.

        Whoever is cancelled here ends it; what it still does then is nobody's, but the
        device is *free* only when it is over.
        """
        outcome: asyncio.Future[Any] = self._loop.create_future()
        this = Operating(registration, name, parameters, until, limit, outcome, free)
        self.current = this
        stuck = DriverStuckError(self._device.name, f"{OPERATE} {name}", limit)
        deadline = Deadlines.of(self._loop).after(
            max(0.0, until - self._device.time()), self._expire, this, stuck
        )
        try:
            self.look()
            return await outcome
        except asyncio.CancelledError:
            if self.current is this:
                if this.call is None:
                    self._free(this)
                else:
                    this.call.cancel()
                    self._device.operated(this.call)
            raise
        finally:
            deadline.cancel()

    async def run_errand(self, method: Method, limit: float) -> Any:
        """Call the driver as soon as the device does nothing else; wait for its outcome.

        Raises:
            CallRefused: The device was not free within the limit, in seconds.
            Exception: What the driver has raised.
        """
        outcome: asyncio.Future[End] = self._loop.create_future()
        this = self.errand = Errand(method, limit, outcome)
        deadline = Deadlines.of(self._loop).after(limit, self._expire_errand, this)
        try:
            self.look()
            end = await outcome
        finally:
            deadline.cancel()
            self.errand = None
        if end.error is not None:
            raise end.error
        return end.value

    def look(self) -> None:
        """Begin with what waits, if the device is free."""
        this = self.current
        if this is None:
            errand = self.errand
            if errand is not None and not errand.call and not errand.outcome.done():
                device, limit = self._device, errand.limit
                errand.call = device.between(errand.method, errand.told, limit)
            return
        if this.call is not None or this.outcome.done():
            return
        device = self._device
        begun = False
        try:
            self.check(this.registration)
            if not device.ready_for(this):
                return
            self.check(this.registration)  # a guard that was asked may have halted all
            begun = True
            method = device.driver.method(this.name)
            if this.parameters:
                method = method.bound(**this.parameters)
            value = device.calls.begin(
                f"{OPERATE} {this.name}",
                method,
                (),
                this.until - device.time(),
                partial(self._may_begin, this.registration),
            )
        except Exception as error:
            if begun:
                error = self._translated(this, error)
            self._over(this, End(None, error))
            if begun:
                device.operated(None)
            return
        if type(value) is Call:
            value.apply = partial(self._ended, this)
            this.call = value
            device.operating(this, value)
        else:
            self._over(this, End(value, None))
            device.operated(None)

    def check(self, registration: Registration) -> None:
        """Pass if a registration is valid, the device is there, and nothing is halted."""
        device = self._device
        table = device.registrations
        if table.live.get(registration.number) is not registration:
            raise table.refusal(registration)
        if table.halt is not None:
            raise HaltedError(device.name, table.halt.reason)
        if device.state is not ResourceState.READY:
            raise device.absence()

    def _may_begin(self, right: Registration) -> bool:
        """Look once more, in a thread in whose line it has waited."""
        table = self._device.registrations
        return table.halt is None and table.live.get(right.number) is right

    def end(self, error: EsairError) -> None:
        """End what waits or runs, because it must not go on."""
        this = self.current
        assert this is not None
        this.ended_by = this.ended_by or error
        if this.call is None:
            self._over(this, End(None, error))
        elif not this.call.cancelled:
            this.call.cancel()

    @property
    def running(self) -> bool:
        return self.current is not None and self.current.call is not None

    def gone(self, error: EsairError) -> None:
        """The device is gone; its calls are fenced."""
        if self.current is not None:
            self._over(self.current, End(None, error))
        if self.errand is not None:
            self.errand.told(End(None, error))

    def drop(self, registration: Registration) -> None:
        """End what was begun by a right that is void."""
        if self.current is not None and self.current.registration is registration:
            self.end(self._device.registrations.refusal(registration))

    def _expire_errand(self, this: Errand) -> None:
        if not this.call:  # a call has its own deadline
            this.told(End(None, CallRefused()))

    def _expire(self, this: Operating, stuck: DriverStuckError) -> None:
        if self.current is this and this.call is None:  # a call has its own deadline
            self._over(this, End(None, stuck))

    def _ended(self, this: Operating, call: Call, end: End) -> None:
        if end.error is not None:
            end = End(None, self._translated(this, end.error))
        self._over(this, end)
        self._device.operated(call)

    def _free(self, this: Operating) -> None:
        self.current = None
        self._loop.call_soon(this.free)  # what is safe, and who reads, come first

    def _over(self, this: Operating, end: End) -> None:
        if self.current is not this:
            return  # its error was that of its device, which has ended it
        self._free(this)
        device = self._device
        error = this.ended_by or end.error
        device.registrations.journal.publish(
            Kind.OPERATED,
            device.name,
            this.registration.behavior,
            end.value if error is None else error,
            this.name if error is None else f"{this.name}: {describe(error)}",
        )
        if this.outcome.done():
            return  # who asked for it has gone
        if error is None:
            this.outcome.set_result(end.value)
        else:
            this.outcome.set_exception(error)

    def _translated(self, this: Operating, error: BaseException) -> EsairError:
        """Make what its caller gets of what the driver has raised."""
        if isinstance(error, CallRefused):  # it has not begun
            try:
                self.check(this.registration)
            except EsairError as refused:
                return refused
        translated = translate_call(self._device.name, this.name, this.limit, error)
        if isinstance(translated, DeviceLostError):
            self._device.robot.on_error(translated)
        return translated
