"""The life of a sensor that is computed of others: there while its sources are."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from esair.actions import Derivation, Derived
from esair.connections import (
    DerivedChannel,
    Registration,
    Source,
    Terms,
)
from esair.exceptions import DeviceLostError, EsairError
from esair.loop import Owner, Stream
from esair.messages import Restart
from esair.plan import unmet
from esair.supervisors._resource_life import ResourceLife

if TYPE_CHECKING:
    from esair.supervisors._resource_deployment import ResourceDeployment


class DerivedLife(ResourceLife):
    """Owns one derived sensor: it is open while each of its sources is ready."""

    def __init__(
        self,
        derived: Derived[Any],
        channel: DerivedChannel,
        restart: Restart,
        deployment: ResourceDeployment,
    ) -> None:
        super().__init__(derived, channel, restart)
        self._derived = derived
        self._channel = channel
        self._deployment = deployment
        self._rights: list[Registration] = []
        self._derivation: Derivation | None = None
        self._missing: EsairError | None = None  # why it has not the right sources
        self._owner = Owner()
        self._owner.stream = Stream(f"{deployment.seed}/{self.name}")

    def start(self) -> None:
        self.bind()
        super().start()

    def reads(self, resource: str) -> bool:
        return any(each.provider == resource for each in self._derived.inputs.values())

    def bind(self) -> None:
        self._leave()
        try:
            sources = self._sources()
        except EsairError as error:
            self._missing = error
            self._hear(self._absence())
            return
        self._missing = None
        derivation = Derivation(
            self._derived,
            self._channel,
            self._hear,
            began=self._deployment.began,
            owner=self._owner,
        )
        derivation.follow(sources)
        self._derivation = derivation
        self._hear(None)

    def _sources(self) -> dict[str, Source]:
        found: dict[str, Source] = {}
        resources, plan = self._deployment, self._deployment.plan
        for attribute, need in self._derived.inputs.items():
            if need.optional and need.provider not in resources.lives:
                continue  # it gets None for it
            if misfit := unmet(plan, self._derived, attribute, need):
                raise misfit.error()
            right = resources.control.grant(
                Terms(self.name, need.resource, need.access)
            )
            self._rights.append(right)
            channel = resources.sensors.channel(need.resource)
            found[attribute] = Source(channel, right, need.max_age, need.optional)
            port = resources.sensors.port(right, max_age=need.max_age)
            self._derived.__dict__[attribute] = port
        return found

    def _leave(self) -> None:
        if self._derivation is not None:
            self._derivation.stop()
            self._derivation = None
        for right in self._rights:
            self._deployment.control.revoke(right)
        self._rights.clear()

    def _absence(self) -> DeviceLostError:
        lost = DeviceLostError(self.name, f"its source: {self._missing}")
        lost.__cause__ = self._missing
        return lost

    async def _open(self) -> None:
        for name in {need.provider for need in self._derived.inputs.values()}:
            source = self._deployment.lives.get(name)
            if source is not None and not source.tried.done():
                await asyncio.wait({source.tried})
        if self._derivation is None:
            raise self._absence()
        self._derivation.begin()

    async def stop(self, until: float) -> None:
        self._leave()
        await super().stop(until)
