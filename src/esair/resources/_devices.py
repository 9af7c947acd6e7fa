"""Sensors and actuators: data flows from the first to actions, and from those to the others.

And those that were written for ESAIR MIN, in a robot of ESAIR STD.
"""

from __future__ import annotations

import enum
import math
from collections.abc import AsyncIterator, Awaitable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, overload

import attrs

from esair import minimal
from esair.resources._resource import Resource, ResourceSettings
from esair.resources._setting import setting, settings_of
from esair.values import snake_case, value_type

if TYPE_CHECKING:
    from esair.watchdog import SafeFrames


T = TypeVar("T")


class SensorSettings(ResourceSettings, total=False):
    """What every sensor takes as keywords, beside its own.

    A driver with a constructor says by it what its ``**settings`` are, so that editors
    and type checkers know them too.

    Example:
        >>> class Sonar(esair.Sensor[float]):
        ...     def __init__(self, *, pin: int, **settings: Unpack[SensorSettings]) -> None:
        ...         super().__init__(**settings)
        ...         self.pin = pin
    """

    rate: float


class Sensor(Resource, Generic[T]):
    """A device that gives values of type ``T``.

    Write ``read`` for a device that is asked, or ``stream`` for a device that
    pushes, or both. Write the type as ``class Sonar(esair.Sensor[float])``; values
    of another type are then a fault of the device.

    Example:
        >>> class Sonar(esair.Sensor[float]):
        ...     '''Distance in metres.'''
        ...
        ...     rate = esair.setting(20.0, unit="Hz", min=1.0, max=50.0)
        ...
        ...     async def read(self) -> float:
        ...         return await self.bus.ask(b"R?") / 1000
    """

    is_computed: ClassVar[bool] = False
    """Whether its values are computed of other readings, and of no device."""

    rate: float = setting(
        10.0, unit="Hz", min=0.001, max=100_000.0, doc="how often the device is asked"
    )
    """How often the device is asked while somebody follows it, in Hz."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        # Whatever limits a class gives its rate, it is one that can be kept.
        if cls.is_computed:
            return
        own, base = settings_of(cls)["rate"], settings_of(Sensor)["rate"]
        rate = attrs.evolve(
            own,
            default=base.check(f"class {cls.__name__}", own.default),
            min=base.min if own.min is None else max(own.min, base.min or 0.0),
            max=base.max if own.max is None else min(own.max, base.max or math.inf),
        )
        if rate != own:
            setattr(cls, "rate", rate)  # noqa: B010 - its type is that of its value

    period: float | None = None
    """Of a device that pushes: its greatest silence, in seconds; None if it may be silent.

    An older reading is no longer current, unless a port says another ``max_age``. A
    device that is asked is heard in each of its periods; its limit is three of them.
    """

    initial: T
    """Of a device that pushes: its value at each opening, if it cannot be asked.

    There is no default: without it, nobody knows the value before the first push.
    """

    limits: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None
    """Least and greatest value: of the reading, or of each of its fields by name.

    A reading outside them is a fault of the device, and reaches no action.
    """

    history_size: int = 64
    """How many readings are kept for ``port.history``."""

    max_repeat: int | None = None
    """How many equal values in a row it may give; None if there is no limit.

    With more of them the device counts as frozen, which is a fault: the values are
    not passed on, and after `fault_limit` of them it is closed and opened again.
    """

    def read(self) -> Awaitable[T] | T:
        """Ask the device for one value."""
        raise NotImplementedError

    def stream(self) -> AsyncIterator[T] | Iterator[T]:
        """Yield each value that the device pushes, until it is gone."""
        raise NotImplementedError

    @property
    def value_type(self) -> Any:
        """The type of the values; `typing.Any` if the class does not say."""
        return value_type(type(self), Sensor)

    @property
    def can_be_asked(self) -> bool:
        """Whether the class has a ``read``."""
        return getattr(self.read, "__func__", None) is not Sensor.read

    @property
    def pushes(self) -> bool:
        """Whether the class has a ``stream``."""
        return type(self).stream is not Sensor.stream


APPLIED = ".applied"
"""What follows the name of an actuator in that of its last command as a reading."""


class _Word(enum.Enum):
    """A command of its own kind: it has no numbers, and equals nothing else."""

    HOLD = "stay where you are"
    REFUSE = "nothing passes"

    def __repr__(self) -> str:
        return f"esair.{self.name}"


REFUSE: Any = _Word.REFUSE
"""What a guard returns that lets nothing pass; so does None, which a forgotten ``return``
gives, too."""

HOLD: Any = _Word.HOLD
"""The safe command of an actuator whose commands are places to go: stay where you are.

Its driver gets it in ``write``, as any other command, and stops where it is.
"""


class ActuatorSettings(ResourceSettings, total=False):
    """What every actuator takes as keywords, beside its own; as `SensorSettings`."""


class Actuator(Resource, Generic[T]):
    """A device that takes commands of type ``T``.

    Every actuator declares ``safe``: the command that it gets when nobody has
    written for ``command_timeout``, when its user is removed or crashes, after
    each opening, and last of all at every exit.

    Example:
        >>> class Wheels(esair.Actuator[Twist]):
        ...     safe = Twist(0.0, 0.0)
        ...     command_timeout = 0.2
        ...     limits = {"linear": (-1.0, 1.0), "angular": (-2.0, 2.0)}
        ...
        ...     async def write(self, command: Twist) -> None:
        ...         await self.bus.send(pack(command))
    """

    safe: T
    """The command that makes the device safe. There is no default.

    It must not move: for commands that are positions it is `esair.HOLD`, or what
    releases the power.
    """

    safe_moves: bool = False
    """Whether ``safe`` is a place to go. Protection then uses `esair.HOLD` instead."""

    command_timeout: float = 0.2
    """After this many seconds without a write the device gets ``safe``; never 0."""

    moves: bool | None = None
    """Whether it can hurt somebody; a lamp says False. None: if it has a
    ``command_timeout`` of its own. `esair check` warns of what moves unprotected."""

    limits: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None
    """Least and greatest value: of the command, or of each of its fields by name."""

    clamp: bool = False
    """Move a value to the nearest limit, instead of refusing it."""

    slew: float | Mapping[str, float] | None = None
    """The fastest change, in units per second: of the command, or of its fields.

    Where ``safe`` is `esair.HOLD` it begins where the device stays, which `write` returns
    when it is told that; the first command to one that does not is not bounded.
    """

    own_timeout: float | None = None
    """After how many seconds the *device itself* stops when it hears nothing.

    None if it would go on for ever when this computer dies. ``esair check``
    prints it; nothing in this process can replace it.
    """

    own_guards: tuple[str, ...] = ()
    """What guards it *in the device itself*, or outranks whoever writes; by name.

    The reactions of a linked board are such. ``esair check`` prints them.
    """

    def write(self, command: T) -> Awaitable[T | None] | T | None:
        """Send a command to the device; it is checked already.

        Returns:
            What was really applied, if that is not the command itself.
        """
        raise NotImplementedError

    def check(self, command: T) -> None:
        """Refuse a command that the device cannot take, beyond type and limits.

        Called for each command before it may leave, the safe one included, when its
        type is right, its numbers are finite, and those with limits are within them.
        It must not wait, nor change anything; `esair.HOLD` is not shown to it.

        Raises:
            BadValueError: The device cannot take it; names the field.
        """

    def safe_frames(self) -> SafeFrames | None:
        """Return the safe command as bytes, for the watchdog process.

        Asked after each opening and each change of settings. They are sent without any
        code of the driver, when this process is dead or stuck, so they must be right
        whatever was sent before.

        Returns:
            The frames; None if nobody can say them before. Then it is UNWATCHED.
        """
        return None

    @property
    def last_will(self) -> float | None:
        """After how many seconds of silence a broker sends ``safe`` in its stead.

        At once when the connection breaks. None if there is nobody; ``esair check`` and
        ``why`` tell it.
        """
        return None

    @property
    def value_type(self) -> Any:
        """The type of the commands, from the class or else from ``safe``."""
        declared = value_type(type(self), Actuator)
        if declared is Any and hasattr(self, "safe") and self.safe is not HOLD:
            return type(self.safe)
        return declared


_OF_STD = ("deadline", "fault_limit", "required", "placement")
"""What a class of MIN may say about itself for STD alone, beside its own words."""


class MinimalSensor(Sensor[Any]):
    """Reads a sensor that was written for `esair.minimal`, on a worker thread.

    Attributes:
        device: What is read.
    """

    def __init__(self, device: minimal.Sensor) -> None:
        rate: dict[str, Any] = {} if device.rate is None else {"rate": device.rate}
        super().__init__(name=_name_of(device), **rate)
        self.device = device
        _take_over(self, device, "max_repeat", "limits", *_OF_STD)
        _hand_on(self, device, minimal.Sensor, "open", "close", "read")


class MinimalActuator(Actuator[Any]):
    """Writes an actuator that was written for `esair.minimal`, on a worker thread.

    Attributes:
        device: What is written.
    """

    def __init__(self, device: minimal.Actuator) -> None:
        super().__init__(name=_name_of(device))
        self.device = device
        _take_over(self, device, "safe", "command_timeout", "limits", "clamp")
        _take_over(self, device, "slew", "own_timeout", *_OF_STD)
        _hand_on(self, device, minimal.Actuator, "open", "close", "write")


@overload
def adapt_resource(resource: minimal.Sensor) -> MinimalSensor: ...
@overload
def adapt_resource(resource: minimal.Actuator) -> MinimalActuator: ...
@overload
def adapt_resource(resource: T) -> T: ...
def adapt_resource(resource: Any) -> Any:
    """Return what runs in STD: a device of MIN in its adapter, all else as it is."""
    if isinstance(resource, minimal.Sensor):
        return MinimalSensor(resource)
    if isinstance(resource, minimal.Actuator):
        return MinimalActuator(resource)
    return resource


def _name_of(device: minimal.Sensor | minimal.Actuator) -> str:
    device.name = device.name or snake_case(type(device).__name__)
    return device.name


def _take_over(to: Resource, device: object, *names: str) -> None:
    for name in names:
        if hasattr(device, name):
            setattr(to, name, getattr(device, name))


def _hand_on(to: Resource, device: object, base: type, *methods: str) -> None:
    """Let the methods of an adapter be those of the device, if its class has them."""
    for name in methods:
        if getattr(type(device), name) is not getattr(base, name):
            setattr(to, name, getattr(device, name))
