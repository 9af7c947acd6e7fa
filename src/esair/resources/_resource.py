"""What sensors and actuators have in common: a life, settings, and a bus."""

from __future__ import annotations

import contextlib
import functools
import inspect
import itertools
import typing
from collections.abc import Awaitable, Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypedDict

import attrs

from esair import abc
from esair.exceptions import ConfigError, EsairError, describe
from esair.resources._setting import (
    Operation,
    Setting,
    check_settings,
    operations_of,
    settings_of,
)
from esair.values import once_for_class

if TYPE_CHECKING:
    from esair.buses import Bus
    from esair.watchdog import Outlet


class ResourceSettings(TypedDict, total=False):
    """What every resource takes as keywords, beside its own; see `Resource`."""

    name: str | None
    bus: Bus | None
    required: bool | None
    identity: Any


class Resource(abc.Resource):
    """A piece of hardware: a sensor or an actuator.

    Any of the methods below may be ``async def`` (it runs in the event loop) or a
    plain, blocking ``def`` (it runs on the worker thread of its bus, or on one of
    its own; in the event loop if the class says ``blocking = False``).

    A driver tells what happened to its device by raising: `DeviceLostError` or any
    other `ConnectionError` when the device is gone, or any `OSError` from `open` when
    it cannot be had yet (it is then reopened with a growing delay), any other exception
    when the device is there but answered wrongly (after `fault_limit` in a row it is
    closed and opened again).

    What the errors of a package mean is said once in the class::

        errors = {package.NotThereError: esair.DeviceLostError}

    One that a method raises becomes the other, with the device's name and the package's
    words. The first that fits counts; the errors of esair stay what they are.

    Args:
        name: The name; the class name in snake case unless given.
        bus: The bus that the device is on, if several devices share it.
        required: Whether the robot refuses to start without the device.
        identity: What `identify` has to answer, if the class has one.
        **settings: First values of the settings that the class declares.
    """

    counted: ClassVar[tuple[str, ...]] = ()
    """The attributes that the driver counts with; see `counts`."""

    required: bool = False
    """Whether the robot refuses to start while the device is not there."""

    deadline: float = 1.0
    """How long one call of the driver may take, in seconds."""

    blocking: bool = True
    """Whether its plain methods may wait for the device: they run on a thread then.

    False for a driver that only touches memory, a register, or a socket that never
    blocks: its plain methods are called in the event loop, without a thread, and nobody
    can end one that takes long. That costs a fraction of an ``async def``. A plain
    ``stream`` has its thread all the same.
    """

    fault_limit: int = 3
    """How many faults in a row before the device is closed and opened again."""

    identity: Any = None
    """What `identify` has to answer; None for whatever it answers first."""

    set_up_period: float = 1.0
    """How often `is_set_up` is asked, in seconds, if the class has one."""

    bus: Any = None
    """The `Bus` that the device is on, if it is on one; a driver narrows the type."""

    traffic: int = 8
    """How many bytes one reading or command moves on its bus: `esair check` adds up what
    all devices ask of it."""

    claim: str | None = None
    """What it needs on its bus for itself alone: ``"node 3"``, say; None if nothing.

    Two resources of a robot that claim the same are a mistake: two actuators of one
    motor would each have priorities and a time-out of their own.
    """

    _listener: Callable[[BaseException | None], None] | None = None

    def __init__(
        self,
        *,
        name: str | None = None,
        bus: Bus | None = None,
        required: bool | None = None,
        identity: Any = None,
        **settings: Any,
    ) -> None:
        super().__init__(name=name)
        if bus is not None:
            self.bus = bus
        if required is not None:
            self.required = required
        if identity is not None:
            self.identity = identity
        keywords = _keywords(type(self))
        for key, value in check_settings(self, settings, keywords).items():
            setattr(self, key, value)

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name, described in settings_of(cls).items():
            plain = vars(cls).get(name, described)
            if not isinstance(plain, Setting):  # ``rate = 50.0`` in a subclass
                value = described.check(f"class {cls.__name__}", plain)
                setattr(cls, name, attrs.evolve(described, default=value))
        owner = next(each for each in cls.__mro__ if "open" in vars(each))
        own = vars(owner)["open"]
        is_checked = owner is not cls and issubclass(owner, Resource)
        if inspect.isfunction(own) and not is_checked:
            cls.open = _within(own, _on_its_bus)  # type: ignore[method-assign]
        if isinstance(getattr(cls, "errors", None), Mapping):
            _translate_errors(cls)

    @property
    def value_type(self) -> Any:
        """The type of what flows from or to the device; `typing.Any` if unknown."""
        return Any

    @property
    def outlet(self) -> Outlet | None:
        """Where the watchdog can send its safe frames: on its bus, if it has one."""
        return None if self.bus is None else self.bus.outlet

    @property
    def identifies(self) -> bool:
        """Whether the class has an ``identify``."""
        return type(self).identify is not Resource.identify

    @property
    def can_tell_set_up(self) -> bool:
        """Whether the class has an ``is_set_up``."""
        return type(self).is_set_up is not Resource.is_set_up

    @property
    def settings(self) -> Mapping[str, Any]:
        """The current value of each setting, by name (read only)."""
        return MappingProxyType(
            {key: getattr(self, key) for key in settings_of(type(self))}
        )

    @property
    def operations(self) -> Mapping[str, Operation]:
        """What can be called by `operate`, by name, with its parameters (read only)."""
        return operations_of(type(self))

    if TYPE_CHECKING:

        def open(self) -> Awaitable[None] | None: ...
        def close(self) -> Awaitable[None] | None: ...
        def identify(self) -> Awaitable[Any] | Any: ...
        def apply(self, *_: Any, **changes: Any) -> Awaitable[None] | None: ...
        def is_set_up(self) -> Awaitable[bool] | bool: ...

    else:  # the types above allow drivers to write either kind of method

        async def open(self) -> None:
            """Make the device ready. Called at the start and after each loss."""
            with _on_its_bus(self):
                pass

        async def close(self) -> None:
            """Let the device go. Called at the stop and after each loss."""

        async def identify(self) -> Any:
            """Ask the device who it is: its serial number, say.

            Write it for a device that another one could take the place of. Called
            after each `open`, before anything else is sent. The first answer is
            remembered, unless `identity` declares it; while another device answers
            this one stays lost. None says that the device cannot tell yet.
            """

        async def apply(self, **changes: Any) -> None:
            """Send changed settings to the device; they are checked already.

            The attributes change after this returns. If it raises, it is called again
            with the values from before. After each opening it is called with all the
            settings that differ from their defaults. Nothing but the safe command is
            called beside it.
            """

        async def is_set_up(self) -> bool:
            """Tell whether what `open` and `apply` have set up is still there.

            Write it for a part that can lose its power, or restart, without being
            unplugged: read a register back that is another one after a reset. Asked
            each `set_up_period`, and after each silence. If it is not, the part is
            opened again and disarmed. Nothing but the safe command is called beside it.
            """
            return True

    def counts(self) -> Mapping[str, int]:
        """Return what the driver counts itself: what it could not read, or threw away.

        It is asked by `Journal.counts`, in the event loop, and shown beside what is
        counted for every sensor or actuator: the attributes that `counted` names.
        """
        return {name: getattr(self, name) for name in self.counted}

    def report_lost(self, error: BaseException | None = None) -> None:
        """Say from a driver, on any thread, that the device is gone."""
        listener = self._listener
        if listener is not None:
            listener(error or ConnectionError("the device reported that it is gone"))

    def report_arrived(self) -> None:
        """Say from a driver, on any thread, that the device is back: reopen now."""
        listener = self._listener
        if listener is not None:
            listener(None)


@once_for_class
def _keywords(cls: type[Resource]) -> frozenset[str]:
    """The keywords of its constructor, and of those that it hands the rest on to."""
    constructors = [
        vars(each)["__init__"] for each in cls.__mro__ if "__init__" in vars(each)
    ]
    return frozenset(
        parameter.name
        for each in constructors[:-1]  # the last is that of `object`
        for parameter in inspect.signature(each).parameters.values()
        if parameter.kind is parameter.KEYWORD_ONLY
    )


@once_for_class
def bus_kind(cls: type[Resource]) -> Any:
    """Return the type of ``bus: SomeBus`` in a class; `typing.Any` if it does not say."""
    narrowed = itertools.takewhile(lambda each: each is not Resource, cls.__mro__)
    if not any("bus" in inspect.get_annotations(each) for each in narrowed):
        return Any
    try:
        return typing.get_type_hints(cls)["bus"]
    except Exception:  # some hint names what only a type checker can see
        return Any


def wrong_bus(cls: type, bus: object) -> str | None:
    """Say what is wrong with a bus for a class that declares one: ``bus: I2CBus``."""
    kind = bus_kind(cls)
    if kind is Any and bus is not None and not hasattr(bus, "on_lost"):
        return f"expected a bus such as esair.buses.SerialBus, not {bus!r:.80}"
    try:
        if kind is Any or isinstance(bus, kind):
            return None
    except TypeError:  # a type that nothing can be compared with at run time
        return None
    kinds = typing.get_args(kind) or (kind,)
    name = " or ".join(getattr(each, "__name__", str(each)) for each in kinds)
    wanted = f"expected {'an' if name[0] in 'AEIO' else 'a'} {name}"
    called = getattr(bus, "name", None)
    if called is None:
        return f"{wanted}, not {bus!r:.80}"
    return f"{wanted}, but {called!r} is a {type(bus).__name__}"


_CALLED = ("open", "close", "identify", "apply", "is_set_up", "read", "write", "stream")
"""The methods of a driver, whose errors may be those of a package."""


def _translate_errors(cls: type[Resource]) -> None:
    """Have the methods that were written for a class raise what ``errors`` says."""
    for name in _CALLED:
        own = next(
            (vars(each)[name] for each in cls.__mro__ if name in vars(each)), None
        )
        if not inspect.isfunction(own) or own.__module__.startswith("esair.resources"):
            continue
        if not hasattr(own, "_translates"):
            made = _within(own, _translated)
            vars(made)["_translates"] = True
            setattr(cls, name, made)


def _within(own: Callable[..., Any], context: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method of a device, of whatever kind, that runs in a context of it."""
    made: Callable[..., Any]
    if inspect.isasyncgenfunction(own):

        async def made(device: Resource, *args: Any, **named: Any) -> Any:
            with context(device):
                async with contextlib.aclosing(own(device, *args, **named)) as values:
                    async for value in values:
                        yield value

    elif inspect.isgeneratorfunction(own):

        def made(device: Resource, *args: Any, **named: Any) -> Any:
            with context(device):
                yield from own(device, *args, **named)

    elif inspect.iscoroutinefunction(own):

        async def made(device: Resource, *args: Any, **named: Any) -> Any:
            with context(device):
                return await own(device, *args, **named)

    else:

        def made(device: Resource, *args: Any, **named: Any) -> Any:
            with context(device):
                return own(device, *args, **named)

    return functools.wraps(own)(made)


@contextlib.contextmanager
def _on_its_bus(device: Resource) -> Iterator[None]:
    """Have an ``open`` that is called by hand say that its bus is missing.

    A robot looks before it starts; by hand it would be an `AttributeError` of None.
    """
    if device.bus is None and (told := wrong_bus(type(device), None)):
        raise ConfigError(device.name, "bus", f"{told}: give it one by bus=")
    yield


@contextlib.contextmanager
def _translated(device: Resource) -> Iterator[None]:
    try:
        yield
    except EsairError:
        raise
    except Exception as error:
        errors: Mapping[Any, Any] = type(device).errors  # type: ignore[attr-defined]
        for kind, meant in errors.items():
            if isinstance(error, kind):
                raise meant(device.name, describe(error)) from error
        raise
