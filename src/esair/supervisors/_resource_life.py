"""The life of one resource: opened, lost, opened again, closed.

A device is opened on its bus, asked who it is, given the settings that it does not have by
itself, and made safe. A sensor that is computed of others is open while each of its sources
is ready.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from esair.actions import Derivation, Derived
from esair.connections import (
    ActuatorChannel,
    Call,
    DerivedChannel,
    Driver,
    End,
    GivenUpError,
    Method,
    Registration,
    SensorChannel,
    Source,
    Terms,
    is_loss,
    translate,
)
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    NoTurnError,
    describe,
    in_short,
)
from esair.journal import Kind
from esair.loop import (
    OPENING,
    CallRefused,
    Deadline,
    Deadlines,
    News,
    Owner,
    ask_outside,
    fail,
    ignore,
    outside,
    spawn,
)
from esair.messages import ResourceState, ResourceStatus, Restart
from esair.plan import unmet
from esair.resources import Resource, settings_of, shown
from esair.supervisors._life import (
    AnotherDeviceError,
    Life,
    is_absence,
    is_silence,
    where,
)
from esair.supervisors._watching import Armory, Watch

if TYPE_CHECKING:
    from esair.buses import Bus
    from esair.placement import Seat
    from esair.supervisors._resource_deployment import ResourceDeployment

_log = logging.getLogger("esair")

Hear = Callable[[EsairError | None], None]
"""Is told that a device is lost, and why, or that it is there again (None)."""

LAST_CLOSE = 0.05
"""How long a close may take at least, when nothing is left of its deadline, in s."""


class Opener:
    """Opens one device, sets it up, and closes it."""

    def __init__(
        self,
        resource: Resource,
        channel: SensorChannel | ActuatorChannel,
        armory: Armory | None = None,
        seat: Seat | None = None,
    ) -> None:
        self.resource, self._seat = resource, seat
        self._channel = channel
        # Its own: the channel goes on with those of a successor.
        self.driver: Driver = channel.driver
        self.calls = channel.calls
        self.is_open: bool = False
        self.newest: int = 0  # the number of the driver's newest call of ``open``
        self._identity: Any = resource.identity
        """What the device answered when it was asked for the first time who it is."""
        self.watch: Watch | None = None
        """The watchdog's eye on it, if it is an actuator and there is a watchdog."""
        if isinstance(channel, ActuatorChannel) and armory is not None:
            self.watch = Watch(channel.actuator, armory)

    def start(self, hear: Hear) -> None:
        """It is opened for the first time soon; who opens it hears of a loss here."""

    def leave(self) -> None:
        """It is not opened any more."""

    async def open(self, patience: float = math.inf) -> None:
        """Open it and set it up; motions from before have so many seconds to end."""
        resource, calls = self.resource, self.calls
        calls.next_opening(DeviceLostError(resource.name, "it is opened again"))
        # What a call from before a loss still sends must not come after the safe command.
        now, most = asyncio.get_running_loop().time(), resource.deadline + 0.1
        await calls.quiet(now + min(patience, most))
        kinds = {call.kind for call in calls.alive.values() if not call.may_move}
        if self.driver.uses_threads or (kinds if patience > most else "open" in kinds):
            await calls.quiet(now + most)  # else nothing would get past them
        if resource.bus is not None:
            await self._run("open the bus", Method(resource.bus.open, None))
        await self.close()  # what has opened late meanwhile
        self.is_open = True
        if self._seat is not None:  # an import may take longer than a call of a driver
            await calls.run("make", Method(self._seat.make, None), limit=None)
        self.newest = calls.number + 1
        await self.call("open")
        if resource.identifies:
            self._identify(await self.call("identify"))
        changes = {
            name: value
            for name, value in resource.settings.items()
            if value != settings_of(type(resource))[name].default
        }
        if changes:
            await self.apply(changes)
        if isinstance(self._channel, ActuatorChannel):
            await self._channel.safe.at_opening()
            self._channel.wire.watch = self.watch

    def _identify(self, answer: Any) -> None:
        """Remember who the device is, or refuse another one in its place."""
        if self._identity is None:
            self._identity = answer
        elif answer != self._identity:
            raise AnotherDeviceError(
                self.resource.name,
                f"identity: expected {self._identity!r:.80}, {answer!r:.80} is there; "
                "plug in the right device, or replace the resource",
            )

    async def call(self, kind: str) -> Any:
        return await self._run(kind, self.driver.method(kind))

    async def apply(self, settings: dict[str, Any], *, in_turn: bool = False) -> None:
        """Tell the device its settings; in turn: as soon as it does nothing else.

        Raises:
            CallRefused: Its turn did not come: the device was not asked.
        """
        method = self.driver.method("apply").bound(**settings)
        await self._run("apply", method, in_turn=in_turn)

    @property
    def patience(self) -> float:
        """How long a call may take that nobody has limited, in seconds."""
        return max(self.resource.deadline, 1.0)

    async def _run(
        self,
        kind: str,
        method: Method,
        limit: float | None = None,
        *,
        in_turn: bool = False,
    ) -> Any:
        limit = self.patience if limit is None else limit
        try:
            if in_turn:
                return await self._channel.operations.run_errand(method, limit)
            return await self.calls.run(kind, method, limit=limit)
        except EsairError:
            raise
        except TimeoutError as error:
            raise DriverStuckError(self.resource.name, kind, limit) from error

    async def close(self, limit: float | None = None) -> None:
        if not self.is_open:
            return
        self.is_open = False
        if self.watch is not None:
            await self.watch.drop(limit)
        try:
            await self._run("close", self.driver.method("close"), limit)
        except Exception as error:
            _log.debug("%s: close: %s", self.resource.name, describe(error))

    def is_stuck(self) -> bool:
        """Tell whether nothing gets past its thread."""
        tag, driver = (self.resource.name, "stuck"), self.driver
        return driver.uses_threads and ask_outside(tag, lambda: driver.is_stuck)

    async def end(self, until: float) -> None:
        """Close the device for good, whatever it is doing, and let its threads go."""
        if self.is_open:
            if self.calls.alive and not self.is_stuck():
                await self.calls.quiet(until - LAST_CLOSE)
            left = until - asyncio.get_running_loop().time()
            if isinstance(self._channel, ActuatorChannel):
                await self._channel.safe.at_last(max(LAST_CLOSE, left))
                left = until - asyncio.get_running_loop().time()
            await self.close(LAST_CLOSE if self.is_stuck() else max(LAST_CLOSE, left))
        if self.driver.uses_threads:
            name = self.resource.name
            ending = partial(self.driver.end_executors, timeout=LAST_CLOSE)
            if not await outside((name, "threads"), ending):
                _log.warning("%s: a driver call is stuck; its thread is left", name)


class DerivedOpener(Opener):
    """Opens a sensor that is computed of others: there is no device."""

    def __init__(
        self,
        derived: Derived[Any],
        channel: DerivedChannel,
        deployment: ResourceDeployment,
    ) -> None:
        super().__init__(derived, channel)
        self._derived = derived
        self._computed = channel
        self._deployment = deployment
        self._hear: Hear = ignore
        self._rights: list[Registration] = []
        self._derivation: Derivation | None = None
        self._missing: EsairError | None = None  # why it has not the right sources
        self._owner = Owner()
        self._owner.stream = f"{deployment.seed}/{derived.name}"

    def start(self, hear: Hear) -> None:
        self._hear = hear
        self.bind()

    def reads(self, resource: str) -> bool:
        return any(each.provider == resource for each in self._derived.inputs.values())

    def bind(self) -> None:
        """Be computed of the sources that there are now."""
        self.leave()
        try:
            sources = self._sources()
        except EsairError as error:
            self._missing = error
            self._hear(self._absence())
            return
        self._missing = None
        began, owner = self._deployment.began, self._owner
        self._derivation = Derivation(
            self._derived, self._computed, self._hear, began=began, owner=owner
        )
        self._derivation.follow(sources)
        self._hear(None)

    def _sources(self) -> dict[str, Source]:
        found: dict[str, Source] = {}
        resources, name = self._deployment, self._derived.name
        for attribute, need in self._derived.inputs.items():
            if need.optional and need.provider not in resources.lives:
                continue  # it gets None for it
            if misfit := unmet(resources.plan, self._derived, attribute, need):
                raise misfit.error()
            right = resources.control.grant(Terms(name, need.resource, need.access))
            self._rights.append(right)
            channel = resources.sensors.channel(need.resource)
            found[attribute] = Source(channel, right, need.max_age, need.optional)
            port = resources.sensors.port(right, max_age=need.max_age)
            self._derived.__dict__[attribute] = port
        return found

    def leave(self) -> None:
        if self._derivation is not None:
            self._derivation.stop()
            self._derivation = None
        for right in self._rights:
            self._deployment.control.revoke(right)
        self._rights.clear()

    def _absence(self) -> DeviceLostError:
        lost = DeviceLostError(self._derived.name, f"its source: {self._missing}")
        lost.__cause__ = self._missing
        return lost

    async def open(self, patience: float = math.inf) -> None:
        for name in {need.provider for need in self._derived.inputs.values()}:
            source = self._deployment.lives.get(name)
            if source is not None and not source.tried.done():
                await asyncio.wait({source.tried})
        if self._derivation is None:
            raise self._absence()
        self._derivation.begin()


FIRST_DELAY = 0.1
"""The pause before a lost device is tried again, in seconds; it doubles each time."""

LAST_TRY = 0.5
"""How long a stop tries to reach an actuator that is not there, in seconds."""

SET_UP_AGAIN = 0.01
"""The pause before a busy device is asked again for its set-up, in seconds."""

MAX_DELAY = 5.0  # the longest pause between two tries, in seconds

_THERE = {ResourceState.OPENING, ResourceState.READY}


class ResourceLife:
    """Owns one resource: its task opens it, waits for its loss, and opens it again."""

    def __init__(
        self,
        resource: Resource,
        channel: SensorChannel | ActuatorChannel,
        opener: Opener,
        seat: Seat | None,
    ) -> None:
        self.resource = resource
        self.name: str = resource.name
        restart = getattr(resource, "restart", None)
        policy = restart if isinstance(restart, Restart) else Restart()
        self.life: Life = Life(resource.name, policy, channel.registrations.journal)
        self.channel = channel
        self.seat: Seat | None = seat
        """Its place if its driver runs in a process of its own."""
        self.losses: int = 0
        self.faults: int = 0
        self.no_turns: int = 0
        """How many calls its bus had no time for."""
        self.tried: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        """Done when the device was tried for the first time."""
        self.configuring: asyncio.Lock = asyncio.Lock()
        """Held while settings are applied: one change at a time, none in an opening."""
        self.operations = 0  # how many operations wait or run
        self._loop = asyncio.get_running_loop()
        self._told_of = News(self._loop, (resource.name, "news"), self._hear_of)
        self._news: asyncio.Future[BaseException | None] | None = None
        self._lost: BaseException | None = None
        """A loss that was reported while the device was being opened."""
        self._arrived = False  # somebody said meanwhile that the device is there
        self._faults_in_row = 0
        self._successes = 0
        self.is_over: bool = False
        """The resource was removed, or another one has its place."""
        self.device = opener
        self.device.calls.on_late_open = self._opened_late
        self._task: asyncio.Task[object]
        self._last_try: asyncio.Task[None] | None = None
        self._looks: Deadline | None = None
        """When it is asked next whether the set-up of the device is still there."""
        self._forget_bus: tuple[Callable[[], None], ...] = ()

    def start(self) -> None:
        self.device.start(self.hear)
        self.resource._listener = self._told  # noqa: SLF001 - the resource's own supervisor
        if self.resource.bus is not None:
            bus: Bus = self.resource.bus
            arrived = bus.on_arrival(lambda: self._told(None))
            self._forget_bus = bus.on_lost(self._told), arrived
        self._task = spawn(self._loop, self._live(), name=f"{self.name} life")

    def restart(self) -> None:
        """Close the device and open it again; its budget is full."""
        self.life.fill()
        if self.tried.done():  # else somebody waits for it: one trial is for all
            self.tried = self._loop.create_future()
        if self.channel.state is ResourceState.READY:
            self.hear(GivenUpError(self.name, "it is restarted"))
            self._arrived = True
        else:
            self.hear(None)

    def on_error(self, error: Exception) -> None:
        if isinstance(error, DeviceLostError):
            self.hear(error)
            return
        if isinstance(error, NoTurnError):  # nobody has asked the device
            self.no_turns += 1
            return
        self.faults += 1
        successes = self.channel.successes
        if successes != self._successes:  # a call went well since the last fault
            self._successes = successes
            self._faults_in_row = 0
        self._faults_in_row += 1
        if isinstance(error, DriverStuckError):
            self._look_after(0.0)  # it was silent: it may have restarted
        if self._faults_in_row >= self.resource.fault_limit:
            self.hear(error)
        elif self.faults == 1:
            self._warn("first fault", error)

    # Whether its set-up is still there.

    def _look_after(self, seconds: float) -> None:
        if not self.resource.can_tell_set_up:
            return
        if self._looks is not None:
            self._looks.cancel()
        self._looks = Deadlines.of(self._loop).after(seconds, self._look)

    def _look(self) -> None:
        """Ask the device whether it has restarted, unless it is busy."""
        self._looks = None
        if self.is_over or self.channel.state is not ResourceState.READY:
            return
        method, limit = self.device.driver.method("is_set_up"), self.resource.deadline
        asked = self.channel.between(method, self._has_told, limit)
        self._look_after(self.resource.set_up_period if asked else SET_UP_AGAIN)

    def _has_told(self, end: End) -> None:
        name = self.name
        if end.error is not None:
            self.on_error(translate(name, end.error))
        elif not end.value:
            self.hear(DeviceLostError(name, "it has restarted: its set-up is gone"))
            self._arrived = True

    async def configure(self, changes: dict[str, Any]) -> None:
        """Apply changed settings, all of them or none; ``configuring`` is held."""
        resource = self.resource
        before = {name: resource.settings[name] for name in changes}
        try:
            await self.device.apply(changes, in_turn=True)
        except CallRefused:  # nobody has asked the device
            raise NoTurnError(self.name, "apply", self.device.patience) from None
        except Exception as error:
            self._check_ready(error)
            try:
                await self.device.apply(before, in_turn=True)
            except Exception as second:
                # Nobody knows its settings now: close it and begin anew.
                unknown = f"its settings are unknown: {describe(second)}"
                self.hear(GivenUpError(resource.name, unknown))
            told = translate(resource.name, error)
            raise told from (error.__cause__ if told is error else error)
        self._check_ready(None)  # what opens it again does not know these changes
        for name, value in changes.items():
            setattr(resource, name, value)
        self.channel.configured()
        if self.device.watch is not None:
            await self.device.watch.arm()

    def status(self) -> ResourceStatus:
        channel = self.channel
        users = (r.behavior for r in channel.registrations.of_resource(self.name))
        return ResourceStatus(
            self.name,
            channel.state,
            channel.error,
            self.losses,
            self.faults,
            tuple(dict.fromkeys(users)),
            shown(self.resource, self.resource.settings),
            *where(self.seat),
        )

    def _check_ready(self, cause: BaseException | None) -> None:
        if self.is_over or self.channel.state is not ResourceState.READY:
            lost = self.channel.error or DeviceLostError(self.name, "it was replaced")
            raise lost from cause

    async def last_try(self, until: float) -> None:
        """Open a device that is not there once more, for its safe command alone.

        Its removal and the stop may both ask for it: then they share one.
        """
        if self.device.is_stuck():  # safe comes after what its thread still does
            await self.device.calls.quiet(min(until, self._loop.time() + LAST_TRY))
        if self.device.calls.alive and self.device.is_stuck():
            return
        if self._last_try is None:
            trying = self._try_once_more(until)
            self._last_try = spawn(self._loop, trying, name=f"{self.name} last try")
        await asyncio.wait({self._last_try})

    async def _try_once_more(self, until: float) -> None:
        name, channel = self.name, self.channel
        assert isinstance(channel, ActuatorChannel)
        self._task.cancel()
        await asyncio.wait({self._task}, timeout=LAST_TRY)
        if self.is_over:
            return  # it was removed meanwhile: nobody would close it again
        seconds = min(LAST_TRY, until - self._loop.time())
        # A motion may live longer than that: better safe before its end than never.
        opening = self._try_to_open(patience=seconds / 2)
        trying = spawn(self._loop, opening, name=f"{name} opening")
        self._task = trying
        await Deadlines.of(self._loop).wait(trying, seconds)
        if not trying.done():
            trying.cancel()
            channel.not_told(DriverStuckError(name, "open", seconds))
        elif (error := trying.result()) is not None:
            channel.not_told(error)
        else:
            await self.device.calls.quiet(until)
            await channel.safe.at_last(until - self._loop.time())

    async def stop(self, until: float) -> None:
        """Close the device, whatever it is doing."""
        self.device.leave()
        self.is_over = True
        if self._looks is not None:
            self._looks.cancel()
        for forget in self._forget_bus:
            forget()
        self.resource._listener = None  # noqa: SLF001 - the resource's own supervisor
        self._task.cancel()
        if self._news is None:  # else it only waits: there is nothing to wait for
            await asyncio.wait({self._task}, timeout=LAST_TRY)
        if not self.tried.done():
            fail(self.tried, self.channel.error or DeviceLostError(self.name, "closed"))
        await self.device.end(until)

    def _opened_late(self, call: Call, end: End) -> None:
        """An opening has ended that was given up: the device must not stay open.

        One that ends after a newer one has begun may have set the device up anew, or
        half of it: whatever came of it, that is a device that has restarted.
        """
        device = self.device
        if isinstance(end.error, CallRefused):
            return  # its turn on a thread came too late: it was not begun
        device.is_open = device.is_open or end.error is None
        if self.is_over:
            spawn(self._loop, self.device.close(), name=f"{self.name} close")
        elif call.number < device.newest and self.channel.state in _THERE:
            told = "an earlier open has ended late: its set-up is unknown"
            self.hear(DeviceLostError(self.name, told))
            self._arrived = True

    def _told(self, error: BaseException | None) -> None:
        """Hear from a driver or a bus, on any thread.

        It takes effect at the border of a turn; until then no call reaches the driver.
        """
        calls = self.device.calls
        opening = calls.opening
        if error is not None and self.channel.state is not ResourceState.LOST:
            calls.lost = self._cause(error)
        self._told_of.tell(opening, error)

    def _hear_of(self, opening: int, error: BaseException | None) -> None:
        if error is None:
            self.hear(None)
        elif opening == self.device.calls.opening:
            self.hear(error)  # the loss of an earlier opening is no news
            self.device.calls.lost = None

    def hear(self, error: BaseException | None) -> None:
        if self.is_over:
            return
        if self._news is None or self._news.done():
            if error is None:
                self._arrived = True
            elif self.channel.state is not ResourceState.LOST:
                self._lost = error
            return
        if (error is None) == (self.channel.state is ResourceState.READY):
            return  # an arrival of what is there, or a loss of what is not
        self._arrived = error is None
        self._news.set_result(error)
        if error is not None:
            self._down(error)

    async def _live(self) -> None:
        delay = FIRST_DELAY
        while True:
            self.channel.state = ResourceState.OPENING
            await self.device.close()  # what was opened late
            self._lost, self._arrived = None, False
            error = await self._try_to_open()
            if error is None and self.device.watch is not None:
                await self.device.watch.open()  # nothing moves before it has answered
            absent = is_absence(error)
            error = error or self._lost or self._up()
            if error is None:
                up_since = self._loop.time()
                self._first_try()
                error = self._lost or await self._wait_for_news(None)
                assert error is not None
                if self._loop.time() - up_since >= MAX_DELAY:
                    delay = FIRST_DELAY  # a flapping device is tried ever less often
            else:
                self._first_try(error)
            self._down(error)
            is_there = isinstance(error, GivenUpError) or not is_loss(error)
            if is_there and isinstance(self.channel, ActuatorChannel):
                await self.channel.safe.at_closing()
            await self.device.close()
            # A driver that has held the loop would be asked again in the same turn, whose
            # clock stood still, and before the robot could hear that it shall end.
            await asyncio.sleep(0)
            if absent or is_loss(error) or is_silence(error):
                pause: float | None = delay
                if type(error) is not NoTurnError:  # else it was not asked
                    delay = min(delay * 2, MAX_DELAY)
            else:
                pause = self.life.pause_after(error, self._loop.time())
            if pause is None:
                self.channel.state = ResourceState.FAILED
                # A replug, or the user's restart, is the way out of it.
                if not self._arrived:
                    await self._wait_for_news(None)
                self.life.fill()
                delay = FIRST_DELAY
                continue
            pause = min(pause, FIRST_DELAY) if self._arrived else pause
            await self._wait_for_news(pause)
            if self._arrived:
                delay = FIRST_DELAY  # one that is back is not waited for long again

    def _first_try(self, error: BaseException | None = None) -> None:
        if not self.tried.done():
            if error is None or not self.resource.required:
                self.tried.set_result(None)
            else:
                self.tried.set_exception(translate(self.name, error))

    async def _wait_for_news(self, timeout: float | None) -> BaseException | None:
        news: asyncio.Future[BaseException | None] = self._loop.create_future()
        self._news = news
        try:
            await asyncio.wait({news}, timeout=timeout)
        finally:
            self._news = None
        return news.result() if news.done() else None

    async def _try_to_open(self, patience: float = math.inf) -> BaseException | None:
        try:
            # A change of settings that the loss has interrupted has to be over.
            async with self.configuring:
                moves = isinstance(self.channel, ActuatorChannel)
                with self.device.driver.urgency.raised(OPENING if moves else 0):
                    await self.device.open(patience)
        except Exception as error:
            return error
        return None

    def _up(self) -> Exception | None:
        """Have it used, unless what its driver says of itself raises: return that."""
        self._faults_in_row = 0
        try:
            self.channel.up()
            self._look_after(self.resource.set_up_period)
        except Exception as error:
            return error
        self.life.tell(Kind.UP)
        if self.losses:
            _log.info("%s: back", self.name)
        return None

    def _down(self, error: BaseException) -> None:
        if self.channel.state is ResourceState.LOST:
            return
        before = self.channel.error
        first = before is None
        cause = self._cause(error)
        self.channel.down(ResourceState.LOST, cause)
        if first:
            self.losses += 1
            self.life.tell(Kind.DOWN, cause, in_short(cause))
            self._warn("lost", error)
        elif type(error) is AnotherDeviceError and type(before) is not type(error):
            self._warn("still lost", error)

    def _warn(self, of: str, error: BaseException) -> None:
        """Log what is wrong with the device; where, if it is the code of its driver."""
        raised = error.__cause__ if isinstance(error, DeviceFaultError) else error
        bug = None if isinstance(raised, OSError | EsairError) else raised
        _log.warning("%s: %s: %s", self.name, of, describe(error), exc_info=bug)

    def _cause(self, error: BaseException) -> EsairError:
        """Make what those meet who use the device after a loss."""
        cause = translate(self.name, error)
        if not isinstance(error, EsairError) and not isinstance(cause, DeviceLostError):
            # Whatever it was: the device is closed now, and nobody can use it.
            cause = DeviceLostError(self.name, describe(error))
            cause.__cause__ = error
        return cause
