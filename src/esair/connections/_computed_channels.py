"""The ways of data from sensors that have no device: applied, and computed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from esair.connections._checks import measured_at
from esair.connections._device import OfRobot
from esair.connections._registrations import Registrations
from esair.connections._sensor_channel import SensorChannel
from esair.messages import Reading, ResourceState, Stamped
from esair.resources import APPLIED, HOLD, Actuator, Sensor

if TYPE_CHECKING:
    from esair.connections._registrations import Registration


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


class DerivedChannel(SensorChannel):
    """Reads what is computed of other readings; it has no device that is asked."""

    sources: tuple[Source, ...] = ()
    """What it is computed of; empty until all of that is there."""

    is_current = False
    """Whether its newest reading is of the newest readings of its sources."""

    catch_up: Callable[[], None] | None = None
    """Computes at once what waits for its place in the turn."""

    def configured(self) -> None:
        """Take over changed settings: how long a reading is good is no setting."""
        self.good_for = math.inf
        self.max_age = getattr(self, "max_age", math.inf)

    def computed_of(self, sources: tuple[Source, ...]) -> None:
        """Be computed of these from now on; while it is there, who follows hears of it."""
        self.sources = sources
        if self.state is ResourceState.READY:
            for follower in self._followers:
                follower.changed(None)

    @property
    def sampled(self) -> tuple[SensorChannel, ...]:
        found = (each for source in self.sources for each in source.channel.sampled)
        return tuple(dict.fromkeys(found))

    @property
    def depth(self) -> int:
        """How many computations come before it, one of the other."""
        below = [
            source.channel.depth
            for source in self.sources
            if isinstance(source.channel, DerivedChannel)
        ]
        return 1 + max(below) if below else 0

    def publish_until(self, value: Any, oldest: float, stale_at: float) -> None:
        """Give a value to everybody who waits or follows."""
        time: float | str = oldest
        if type(value) is Stamped:
            time = measured_at(value, self.time())
        else:
            value = Stamped(value, oldest)
        before, self.is_current = (self.max_age, self.sequence), True
        if isinstance(time, float) and stale_at < math.inf:
            self.max_age = stale_at - time  # that of this very reading
        else:
            self.max_age = math.inf
        self.publish(value, math.inf)
        if self.sequence == before[1]:  # it was no good
            self.max_age, self.is_current = before[0], False

    async def ask(
        self, registration: Registration, *, fresh: bool, max_age: float, timeout: float
    ) -> Reading[Any]:
        """Return a reading that is good enough; a fresh one is of fresh readings."""
        until = self.time() + timeout
        if fresh and self.state is ResourceState.READY:
            self._check(registration)
            for each in self.sources:
                if each.optional:
                    continue
                limit = each.max_age
                await each.channel.ask(
                    each.registration,
                    fresh=True,
                    max_age=each.channel.max_age if limit is None else limit,
                    timeout=max(0.0, until - self.time()),
                )
            if self.catch_up is not None:
                self.catch_up()
            if self.is_current:
                return self.known(registration, max_age)
        return await super().ask(
            registration,
            fresh=fresh,
            max_age=max_age,
            timeout=max(0.0, until - self.time()),
        )
