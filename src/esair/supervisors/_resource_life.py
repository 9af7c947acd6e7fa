"""The life of one resource: opened, lost, opened again, closed."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from esair.connections import (
    ActuatorChannel,
    Call,
    End,
    GivenUpError,
    SensorChannel,
    is_loss,
    translate,
)
from esair.exceptions import (
    DeviceLostError,
    DriverStuckError,
    EsairError,
    NoTurnError,
    describe,
    in_short,
)
from esair.journal import Kind
from esair.loop import (
    Deadline,
    Deadlines,
    News,
    fail,
    spawn,
)
from esair.messages import ResourceState, ResourceStatus, Restart
from esair.resources import Resource, shown
from esair.supervisors._life import (
    AnotherDeviceError,
    Life,
    is_absence,
    is_silence,
    where,
)
from esair.supervisors._opening import Opener

if TYPE_CHECKING:
    from esair.buses import Bus
    from esair.placement import Seat

FIRST_DELAY = 0.1
"""The pause before a lost device is tried again, in seconds; it doubles each time."""

LAST_TRY = 0.5
"""How long a stop tries to reach an actuator that is not there, in seconds."""

SET_UP_AGAIN = 0.01
"""The pause before a busy device is asked again for its set-up, in seconds."""

MAX_DELAY = 5.0  # the longest pause between two tries, in seconds

_THERE = {ResourceState.OPENING, ResourceState.READY}

_log = logging.getLogger("esair")


class ResourceLife:
    """Owns one resource: its task opens it, waits for its loss, and opens it again."""

    def __init__(
        self,
        resource: Resource,
        channel: SensorChannel | ActuatorChannel,
        restart: Restart,
        opener: Opener,
    ) -> None:
        self.resource = resource
        self.name: str = resource.name
        self.life: Life = Life(resource.name, restart, channel.registrations.journal)
        self.channel = channel
        self.seat: Seat | None = None
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
            self._forget_bus = (
                bus.on_lost(self._told),
                bus.on_arrival(lambda: self._told(None)),
            )
        self._task = spawn(self._loop, self._live(), name=f"{self.name} life")

    def restart(self) -> None:
        """Close the device and open it again; its budget is full."""
        self.life.restarts.fill()
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
        method = self.device.driver.method("is_set_up")
        asked = self.channel.between(method, self._has_told)
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
            await self.device.call("apply", **changes)
        except Exception as error:
            self._check_ready(error)
            try:
                await self.device.call("apply", **before)
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
        if self._last_try is None:
            self._last_try = spawn(
                self._loop, self._try_once_more(until), name=f"{self.name} last try"
            )
        await asyncio.wait({self._last_try})

    async def _try_once_more(self, until: float) -> None:
        name, channel = self.name, self.channel
        assert isinstance(channel, ActuatorChannel)
        self._task.cancel()
        await asyncio.wait({self._task}, timeout=LAST_TRY)
        if self.is_over:
            return  # it was removed meanwhile: nobody would close it again
        trying = spawn(self._loop, self._open_once(), name=f"{name} opening")
        self._task = trying
        seconds = min(LAST_TRY, self._left(until))
        await Deadlines.of(self._loop).wait(trying, seconds)
        if not trying.done():
            trying.cancel()
            channel.not_told(DriverStuckError(name, "open", seconds))
        elif (error := trying.result()) is not None:
            channel.not_told(error)

    async def _open_once(self) -> BaseException | None:
        await self.device.close()
        return await self._try_to_open()

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

    def _left(self, until: float) -> float:
        return until - self._loop.time()

    def _opened_late(self, call: Call, end: End) -> None:
        """An opening has ended that was given up: the device must not stay open.

        One that ends after a newer one has begun may have set the device up anew, or
        half of it: whatever came of it, that is a device that has restarted.
        """
        device = self.device
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
            error = error or self._lost
            if error is None:
                up_since = self._loop.time()
                self._up()
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
                delay = min(delay * 2, MAX_DELAY)
            else:
                pause = self.life.pause_after(error, self._loop.time())
            if pause is None:
                self.channel.state = ResourceState.FAILED
                # A replug, or the user's restart, is the way out of it.
                if not self._arrived:
                    await self._wait_for_news(None)
                self.life.restarts.fill()
                delay = FIRST_DELAY
                continue
            await self._wait_for_news(
                min(pause, FIRST_DELAY) if self._arrived else pause
            )
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

    async def _try_to_open(self) -> BaseException | None:
        try:
            # A change of settings that the loss has interrupted has to be over.
            async with self.configuring:
                await self.device.open()
        except Exception as error:
            return error
        return None

    def _up(self) -> None:
        self._faults_in_row = 0
        self.channel.up()
        self._look_after(self.resource.set_up_period)
        self.life.tell(Kind.UP)
        if self.losses:
            _log.info("%s: back", self.name)

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
            _log.warning("%s: lost: %s", self.name, describe(error))
        elif type(error) is AnotherDeviceError and type(before) is not type(error):
            _log.warning("%s: still lost: %s", self.name, describe(error))

    def _cause(self, error: BaseException) -> EsairError:
        """Make what those meet who use the device after a loss."""
        cause = translate(self.name, error)
        if not isinstance(error, EsairError) and not isinstance(cause, DeviceLostError):
            # Whatever it was: the device is closed now, and nobody can use it.
            cause = DeviceLostError(self.name, describe(error))
            cause.__cause__ = error
        return cause
