"""Sensors: data flows from them to actions."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Awaitable, Iterator, Mapping
from typing import Any, ClassVar, Generic, TypeVar

import attrs

from esair.resources._resource import Resource, ResourceSettings
from esair.resources._setting import setting, settings_of
from esair.values import value_type

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
