"""A device while it is opened, set up and closed; and a sensor that has none.

A device is opened on its bus, asked who it is, given the settings that it does not have by
itself, and made safe. A sensor that is computed of others is open while each of its sources
is ready.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from esair.actions import Derivation, Derived
from esair.connections import (
    ActuatorChannel,
    DerivedChannel,
    Driver,
    Method,
    Registration,
    SensorChannel,
    Source,
    Terms,
)
from esair.exceptions import DeviceLostError, DriverStuckError, EsairError, describe
from esair.loop import Owner, Stream, ask_outside, ignore, outside
from esair.plan import unmet
from esair.resources import Resource, settings_of
from esair.supervisors._life import AnotherDeviceError
from esair.supervisors._watching import Armory, Watch

if TYPE_CHECKING:
    from esair.supervisors._resource_deployment import ResourceDeployment

Hear = Callable[[EsairError | None], None]
"""Is told that a device is lost, and why, or that it is there again (None)."""

LAST_CLOSE = 0.05
"""How long a close may take at least, when nothing is left of its deadline, in s."""

_log = logging.getLogger("esair")


class Opener:
    """Opens one device, sets it up, and closes it."""

    def __init__(
        self,
        resource: Resource,
        channel: SensorChannel | ActuatorChannel,
        armory: Armory | None = None,
    ) -> None:
        self.resource = resource
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

    async def open(self) -> None:
        resource, calls = self.resource, self.calls
        calls.next_opening(DeviceLostError(resource.name, "it is opened again"))
        # What a call from before a loss still sends must not come after the safe command.
        await calls.quiet(asyncio.get_running_loop().time() + resource.deadline + 0.1)
        if resource.bus is not None:
            await self._run("open the bus", Method(resource.bus.open, None))
        await self.close()  # what has opened late meanwhile
        self.is_open = True
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
            await self.call("apply", **changes)
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

    async def call(self, kind: str, **options: Any) -> Any:
        return await self._run(kind, self.driver.method(kind), **options)

    async def _run(
        self, kind: str, method: Method, limit: float | None = None, **options: Any
    ) -> Any:
        limit = max(self.resource.deadline, 1.0) if limit is None else limit
        if options:
            method = method.bound(**options)
        try:
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

    async def end(self, until: float) -> None:
        """Close the device for good, whatever it is doing, and let its threads go."""
        driver = self.driver
        if self.is_open:
            if self.calls.alive:
                await self.calls.quiet(until - LAST_CLOSE)
            left = until - asyncio.get_running_loop().time()
            if driver.uses_threads:
                tag = self.resource.name, "stuck"
                left = 0.0 if ask_outside(tag, lambda: driver.is_stuck) else left
            await self.close(max(LAST_CLOSE, left))
        if driver.uses_threads:
            name = self.resource.name
            ending = partial(driver.end_executors, timeout=LAST_CLOSE)
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
        self._owner.stream = Stream(f"{deployment.seed}/{derived.name}")

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

    async def open(self) -> None:
        for name in {need.provider for need in self._derived.inputs.values()}:
            source = self._deployment.lives.get(name)
            if source is not None and not source.tried.done():
                await asyncio.wait({source.tried})
        if self._derivation is None:
            raise self._absence()
        self._derivation.begin()
