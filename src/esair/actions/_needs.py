"""What an action declares to read and write: class attributes that become ports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Generic, TypeVar, overload

import attrs

from esair import abc
from esair.actions._ports import ActuatorPort, SensorPort
from esair.exceptions import ConfigError, NotRegisteredError
from esair.messages import Access
from esair.values import check_name, is_positive

T = TypeVar("T")


@attrs.frozen
class Reads(Generic[T]):
    """An action reads a sensor; in the running action it is a `SensorPort`.

    Attributes:
        type: The type of the readings.
        name: The name of the sensor; that of the attribute unless given.
        max_age: The greatest age of a reading, in seconds; None for any.
        configure: Whether the action may change the sensor's settings.
    """

    type: Any
    name: str | None = None
    max_age: float | None = None
    configure: bool = False
    attribute: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "attribute", name)

    @overload
    def __get__(self, instance: None, owner: type) -> Reads[T]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> SensorPort[T]: ...
    def __get__(self, instance: object | None, owner: type) -> Reads[T] | SensorPort[T]:
        if instance is None:
            return self
        # A bound port lies in the instance and is found before this.
        raise _not_bound(instance, self.resource)

    @property
    def resource(self) -> str:
        """The name of the sensor."""
        return self.name or self.attribute

    @property
    def access(self) -> Access:
        """What the action wants to do."""
        return Access.READ | Access.CONFIGURE if self.configure else Access.READ


@attrs.frozen
class Writes(Generic[T]):
    """An action writes an actuator; in the running action it is an `ActuatorPort`.

    Attributes:
        type: The type of the commands.
        name: The name of the actuator; that of the attribute unless given.
        priority: Who moves the actuator if several want to; higher wins.
        hold: For how long a write holds the actuator, in seconds; the actuator's
            command timeout unless given.
        configure: Whether the action may change the actuator's settings.
    """

    type: Any
    name: str | None = None
    priority: int = 0
    hold: float | None = None
    configure: bool = False
    attribute: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "attribute", name)

    @overload
    def __get__(self, instance: None, owner: type) -> Writes[T]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> ActuatorPort[T]: ...
    def __get__(
        self, instance: object | None, owner: type
    ) -> Writes[T] | ActuatorPort[T]:
        if instance is None:
            return self
        raise _not_bound(instance, self.resource)

    @property
    def resource(self) -> str:
        """The name of the actuator."""
        return self.name or self.attribute

    @property
    def access(self) -> Access:
        """What the action wants to do."""
        return Access.WRITE | Access.CONFIGURE if self.configure else Access.WRITE


Need = Reads[Any] | Writes[Any]


def reads(
    type: type[T],  # noqa: A002 - the contract's name
    *,
    name: str | None = None,
    max_age: float | None = None,
    configure: bool = False,
) -> Reads[T]:
    """Declare, as a class attribute, that an action reads a sensor.

    Args:
        type: The type of the readings.
        name: The name of the sensor; that of the attribute unless given.
        max_age: The greatest age of a reading, in seconds. An older one is never
            passed off as current: a behavior gets `StaleReadingError`, a reaction
            is parked.
        configure: Whether the action may change the sensor's settings.

    Example:
        >>> class Avoid(esair.Reaction):
        ...     sonar = esair.reads(float, max_age=0.5)
    """
    return Reads(type, name, max_age, configure)


def writes(
    type: type[T],  # noqa: A002 - the contract's name
    *,
    name: str | None = None,
    priority: int = 0,
    hold: float | None = None,
    configure: bool = False,
) -> Writes[T]:
    """Declare, as a class attribute, that an action writes an actuator.

    Args:
        type: The type of the commands.
        name: The name of the actuator; that of the attribute unless given.
        priority: Who moves the actuator if several want to; higher wins.
        hold: For how long a write holds the actuator, in seconds; the actuator's
            command timeout unless given.
        configure: Whether the action may change the actuator's settings.

    Example:
        >>> class Wander(esair.Behavior):
        ...     wheels = esair.writes(Twist)
    """
    return Writes(type, name, priority, hold, configure)


class ProfiledAction(abc.Action):
    """An action with a profile: given by its class, or by the configuration.

    Args:
        name: The name; the class name in snake case unless given.
        reads: Sensors to read besides, or instead of, those of the class.
        writes: Actuators to write besides, or instead of, those of the class.
    """

    _declared: Mapping[str, Need] = {}
    _profile: Mapping[str, Need] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        found: dict[str, Need] = {}
        for each in reversed(cls.__mro__):
            for attribute, value in vars(each).items():
                if isinstance(value, Reads | Writes):
                    found[attribute] = value
                else:
                    found.pop(attribute, None)
        cls._declared = found

    def __init__(
        self,
        *,
        name: str | None = None,
        reads: Mapping[str, Reads[Any]] | None = None,
        writes: Mapping[str, Writes[Any]] | None = None,
    ) -> None:
        super().__init__(name=name)
        given: dict[str, Need] = {**(reads or {}), **(writes or {})}
        if given:
            self._profile = {
                attribute: attrs.evolve(need, attribute=attribute)
                for attribute, need in given.items()
            }

    @property
    def needs(self) -> dict[str, Need]:
        """What this action reads and writes, by the name of its port."""
        return {**self._declared, **self._profile}


def mistakes_in_needs(action: ProfiledAction) -> list[ConfigError]:
    """Return what is wrong with what an action declares, whatever the robot."""
    found: list[ConfigError] = []
    for attribute, need in action.needs.items():
        try:
            check_name("resource", need.resource)
        except ConfigError as error:
            found.append(ConfigError(action.name, attribute, str(error)))
        if need.type is None or isinstance(need.type, str | bytes | int | float):
            found.append(
                ConfigError(
                    action.name,
                    attribute,
                    f"expected a type such as float, not {need.type!r:.80} "
                    "(a name is given by name=)",
                )
            )
        seconds = need.max_age if isinstance(need, Reads) else need.hold
        field = "max_age" if isinstance(need, Reads) else "hold"
        if seconds is not None and not is_positive(seconds):
            found.append(
                ConfigError(
                    action.name,
                    f"{attribute}.{field}",
                    f"expected seconds > 0, not {seconds!r:.80}",
                )
            )
        if isinstance(need, Writes) and type(need.priority) is not int:
            found.append(
                ConfigError(
                    action.name,
                    f"{attribute}.priority",
                    f"expected a whole number, not {need.priority!r:.80}",
                )
            )
    return found


def _not_bound(instance: object, resource: str) -> NotRegisteredError:
    name = instance.name if isinstance(instance, abc.Component) else repr(instance)
    return NotRegisteredError(name, resource, "it is not in a running robot")
