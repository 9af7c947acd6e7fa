"""What an action declares: what it reads, writes and guards, and what it owes."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Generic,
    Literal,
    NoReturn,
    Self,
    TypeVar,
    overload,
)

import attrs

from esair import abc
from esair.actions._blocking_ports import BlockingActuatorPort, BlockingSensorPort
from esair.connections import ActuatorPort, SensorPort
from esair.exceptions import ConfigError, NotRegisteredError
from esair.messages import Access
from esair.resources import APPLIED
from esair.values import check_name, is_positive

if TYPE_CHECKING:
    from esair.actions._behavior import ThreadBehavior


B = TypeVar("B")
P = TypeVar("P")
T = TypeVar("T")

Blind = Literal["safe", "release"]
"""What is done with the actuator of a component that cannot see."""


def not_bound(instance: object, resource: str) -> NotRegisteredError:
    """Make the error for the use of what only a running robot gives."""
    name = instance.name if isinstance(instance, abc.Component) else repr(instance)
    why = "it is not in a running robot"
    if hasattr(instance, "react"):
        why += "; a command is what react returns"
    return NotRegisteredError(name, resource, why)


def attributes_of(cls: type) -> dict[str, Any]:
    """Return what a class says under each name, or what its bases say."""
    classes = reversed(cls.__mro__)
    return {name: value for each in classes for name, value in vars(each).items()}


class Unbound:
    """An attribute that a running robot puts into the instance."""

    def __get__(self, instance: object | None, owner: type) -> Any:
        if instance is None:
            return self
        raise not_bound(instance, "robot")


class Becomes(Generic[P, B]):
    """A declaration that is a port in the running action: ``B`` in one with a thread."""

    __slots__ = ()

    resource: Any  # what it is a port to

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...
    @overload
    def __get__(self, instance: ThreadBehavior, owner: type) -> B: ...
    @overload
    def __get__(self, instance: object, owner: type) -> P: ...
    def __get__(self, instance: object | None, owner: type) -> Any:
        if instance is None:
            return self
        # A bound port lies in the instance and is found before this.
        raise not_bound(instance, self.resource)


class _Declared:
    """What is declared of any device: it is named like the attribute unless said."""

    __slots__ = ()

    # What one kind of declaration cannot say is as if it were not said.
    right: ClassVar[Access]
    name: str | None
    attribute: str
    configure: bool = False
    priority: int = 0
    hold: float | None = None
    optional: bool = False

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "attribute", name)

    @property
    def resource(self) -> str:
        """The name of the device."""
        return self.name or self.attribute

    @property
    def provider(self) -> str:
        """Who has to be there for it."""
        return self.resource

    @property
    def access(self) -> Access:
        """What the action wants to do."""
        return self.right | Access.CONFIGURE if self.configure else self.right


@attrs.frozen
class Reads(_Declared, Becomes[SensorPort[T], BlockingSensorPort[T]]):
    """An action reads a sensor; in the running action it is a `SensorPort`.

    Its attributes are what `reads` takes.
    """

    right: ClassVar[Access] = Access.READ

    type: Any
    name: str | None = None
    max_age: float | None = None
    configure: bool = False
    attribute: str = ""
    every: bool = attrs.field(default=False, kw_only=True)
    optional: bool = attrs.field(default=False, kw_only=True)

    @property
    def provider(self) -> str:
        """Who has to be there for it: the actuator, if it reads its last command."""
        return str(self.resource).removesuffix(APPLIED)  # a wrong name is told by it


@attrs.frozen
class Writes(_Declared, Becomes[ActuatorPort[T], BlockingActuatorPort[T]]):
    """An action writes an actuator; in the running action it is an `ActuatorPort`.

    Its attributes are what `writes` takes.
    """

    right: ClassVar[Access] = Access.WRITE

    type: Any
    name: str | None = None
    priority: int = 0
    hold: float | None = None
    configure: bool = False
    attribute: str = ""
    blind: Blind | None = attrs.field(default=None, kw_only=True)


@attrs.frozen
class Guards(_Declared, Generic[T]):
    """A reaction guards an actuator: every command of everybody passes it.

    Its attributes are what `guards` takes.
    """

    right: ClassVar[Access] = Access.GUARD

    type: Any
    name: str | None = None
    priority: int = 0
    latch: bool = False
    attribute: str = ""

    @overload
    def __get__(self, instance: None, owner: type) -> Guards[T]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> NoReturn: ...
    def __get__(self, instance: object | None, owner: type) -> Guards[T]:
        if instance is None:
            return self
        raise AttributeError(
            f"{self.attribute}: a guard gets the command as a parameter of react"
        )


Need = Reads[Any] | Writes[Any] | Guards[Any]


def reads(
    type: type[T],  # noqa: A002 - the contract's name
    *,
    name: str | None = None,
    max_age: float | None = None,
    every: bool = False,
    optional: bool = False,
    configure: bool = False,
) -> Reads[T]:
    """Declare, as a class attribute, that an action reads a sensor.

    Args:
        type: The type of the readings.
        name: The name of the sensor; that of the attribute unless given. The last
            command that an actuator has applied is read as ``"valve.applied"``.
        max_age: The greatest age of a reading, in seconds; the sensor's own limit
            unless given (three of its periods if it is polled). An older one is
            never passed off as current: a behavior gets `StaleReadingError`, a
            reaction is blind.
        every: A reaction runs on every single reading, not on the newest alone.
        optional: A reaction decides without it as well: while it is absent or
            stale, ``react`` gets None in its place.
        configure: Whether the action may change the sensor's settings.

    Example:
        >>> class Avoid(esair.Reaction):
        ...     sonar = esair.reads(float, max_age=0.5)
    """
    return Reads(type, name, max_age, configure, every=every, optional=optional)


def writes(
    type: type[T],  # noqa: A002 - the contract's name
    *,
    name: str | None = None,
    priority: int = 0,
    hold: float | None = None,
    blind: Blind | None = None,
    configure: bool = False,
) -> Writes[T]:
    """Declare, as a class attribute, that an action writes an actuator.

    Args:
        type: The type of the commands.
        name: The name of the actuator; that of the attribute unless given.
        priority: Who moves the actuator if several want to; higher wins.
        hold: For how long a write holds the actuator, in seconds; the actuator's
            command timeout unless given.
        blind: What is done with the actuator while the action cannot decide. With
            ``"safe"``, which is a reaction's default, the actuator is told safe at
            once unless a higher priority moves it, and writes of the same or a
            lower priority are refused. With ``"release"``, a behavior's default,
            the action just has no say, and lower priorities get through.
        configure: Whether the action may change the actuator's settings.

    Example:
        >>> class Wander(esair.Behavior):
        ...     wheels = esair.writes(Twist)
    """
    return Writes(type, name, priority, hold, configure, blind=blind)


def guards(
    type: type[T],  # noqa: A002 - the contract's name
    *,
    name: str | None = None,
    priority: int = 0,
    latch: bool = False,
) -> Guards[T]:
    """Declare, as a class attribute, that a reaction guards an actuator.

    Every command for the actuator, whoever writes it, passes the guard: ``react``
    gets it by the name of the port, and returns it, or a weaker one, or None to
    refuse it. While the guard cannot see, nothing passes.

    Args:
        type: The type of the commands.
        name: The name of the actuator; that of the attribute unless given.
        priority: Which guard is asked first if there are several; higher is earlier.
        latch: Once it has refused a command, or was blind while something moved,
            nothing passes until the user calls ``robot.behaviors.reset(name)``.

    Example:
        >>> class Bumpers(esair.Reaction):
        ...     bumper = esair.reads(bool)
        ...     wheels = esair.guards(Twist)
        ...
        ...     def react(self, bumper: bool, wheels: Twist) -> Twist | None:
        ...         return None if bumper else wheels
    """
    return Guards(type, name, priority, latch)


def _check_free(component: str, cls: type, ports: Mapping[str, Need]) -> None:
    """Refuse a port that would hide what an action has: its name, its ``put``."""
    own = [each for each in cls.__mro__ if each.__module__.startswith("esair.")]
    for attribute, each in itertools.product(sorted(ports), own):
        has = vars(each).get(attribute, ports[attribute])
        if not isinstance(has, Reads | Writes | Guards):
            told = f"an action has a {attribute!r} of its own: say "
            told += f"{type(ports[attribute]).__name__.lower()}(..., name=...)"
            told += ", and call the port otherwise"
            raise ConfigError(component, attribute, told)


class ProfiledAction(abc.Action):
    """An action with a profile: given by its class, or by the configuration.

    Args:
        name: The name; the class name in snake case unless given.
        reads: Sensors to read besides, or instead of, those of the class.
        writes: Actuators to write besides, or instead of, those of the class.
        guards: An actuator to guard instead of that of the class.
    """

    blind_unless_said: ClassVar[Blind] = "release"
    """What ``blind`` of its ports is, where they do not say."""

    if TYPE_CHECKING:  # else it were a key of each robot.toml
        needs: Mapping[str, Need]
        """What this action reads, writes and guards, by the name of its port."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.needs = {
            name: value
            for name, value in attributes_of(cls).items()
            if isinstance(value, Reads | Writes | Guards)
        }
        _check_free(cls.__name__, cls, cls.needs)

    def __init__(
        self,
        *,
        name: str | None = None,
        reads: Mapping[str, Reads[Any]] | None = None,
        writes: Mapping[str, Writes[Any]] | None = None,
        guards: Mapping[str, Guards[Any]] | None = None,
    ) -> None:
        super().__init__(name=name)
        given: dict[str, Need] = {**(reads or {}), **(writes or {}), **(guards or {})}
        if given:
            for attribute, need in given.items():
                if not isinstance(need, Reads | Writes | Guards):
                    told = f"expected esair.reads(...) or the like, not {need!r:.80}"
                    raise ConfigError(self.name, attribute, told)
            _check_free(self.name, type(self), given)
            own = {
                attribute: attrs.evolve(need, attribute=attribute)
                for attribute, need in given.items()
            }
            # Not of the instance: a file may give a profile after a script has.
            self.needs = {**type(self).needs, **own}

    def holds_when_blind(self, need: Need) -> bool:
        """Tell whether an actuator is kept safe while this action cannot decide."""
        if not isinstance(need, Writes):
            return isinstance(need, Guards)
        return (need.blind or self.blind_unless_said) == "safe"


@attrs.frozen
class Works:
    """What an action does for as long as nothing is wrong; made by `works`.

    Attributes:
        partners: The actuators that it commands, and the behaviors that it puts to, gets
            from or asks; all of them if there is none here.
        within: The longest pause between two times, in seconds; None if it owes nothing.
    """

    partners: tuple[str, ...] = ()
    within: float | None = None


def works(*partners: str, within: float = 4.0, idle: bool = False) -> Works:
    """Declare, as a class attribute, what an action does while nothing is wrong.

    A robot takes no notice of it. `esair torture` expects it again soon after the last
    fault, beside what the robot did steadily when nothing was done to it.

    Args:
        partners: The names of the actuators that it commands, or of the behaviors that
            it puts to, gets from or asks. Without any it is to do anything at all.
        within: Its longest pause, in seconds.
        idle: It owes nothing: it may rest, or end, whenever it likes. With partners, it
            owes nothing to those.

    Raises:
        ConfigError: A name, or the time, is none.

    Example:
        >>> class Patrol(esair.Behavior):
        ...     wheels = esair.writes(Twist)
        ...     rounds = esair.works("wheels", within=30.0)
    """
    for name in partners:
        check_name("works", name)
    if not idle and not is_positive(within):
        raise ConfigError(
            "works", "within", f"expected seconds > 0, not {within!r:.80}"
        )
    return Works(partners, None if idle else float(within))


def declared_works(action: Any) -> list[Works]:
    """Return what an action says that it does, or need not do."""
    values = attributes_of(type(action)).values()
    return [each for each in values if isinstance(each, Works)]
