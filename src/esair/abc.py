"""The four abstract bases of ESAIR, on one page. Read this first.

Four kinds of things make up a robot, and two flows join them::

    control flow   Action ──> Supervisor ──> Resource     register, configure,
                                                          add, remove
    data flow      Action ──> Connection ──> Resource     read, write

The two never mix: a `Supervisor` deploys and configures and never touches data; a
`Connection` moves data and decides nothing about who may.
"""

from __future__ import annotations

import abc
import copy
from typing import Any, Self

from esair.exceptions import ConfigError
from esair.messages import Place, SupervisorPhase
from esair.values import check_name, snake_case


class Component:
    """Something with a name: an action or a resource.

    The name is the class name in snake case unless ``name=`` says otherwise.
    """

    placement: Place = None
    """``"process"``, or an `esair.Placement`, to live in a process of its own."""

    _name: str | None = None
    _kind = "component"
    _made_of: tuple[tuple[Any, ...], dict[str, Any]] = ((), {})

    def __new__(cls, *args: Any, **options: Any) -> Self:
        """Remember what it is constructed with."""
        above = super().__new__
        plain = above is object.__new__
        made = above(cls) if plain else above(cls, *args, **options)
        kept = {each: _copied(value) for each, value in options.items()}
        try:
            made._made_of = (*map(_copied, args),), kept  # noqa: SLF001 - its own class
        except AttributeError as error:
            told = "a component has a life, so its class cannot be frozen"
            raise ConfigError(snake_case(cls.__name__), "", told) from error
        return made

    def __init__(self, *, name: str | None = None) -> None:
        if name is not None:
            self._name = check_name(self._kind, name)

    @property
    def name(self) -> str:
        """The name of this component; it is unique among its kind in a robot."""
        if self._name is None:
            self._name = check_name(self._kind, snake_case(type(self).__name__))
        return self._name

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} {self._name or snake_case(type(self).__name__)!r}>"
        )


def _copied(value: Any) -> Any:
    """Return what was given as it is now: a constructor may take a list apart."""
    return copy.copy(value) if type(value) in {list, dict, set, bytearray} else value


def made_of(component: Component) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Return what a component was constructed with; a process of its own does it again."""
    return component._made_of  # noqa: SLF001 - its own module


class Action(Component):
    """An activity of the robot: a deliberative behavior or a reaction.

    It knows its own readings and commands and nothing of devices, buses, or
    other actions' insides.
    """

    _kind = "behavior"


class Resource(Component):
    """A piece of hardware: a sensor or an actuator.

    It knows its device and nothing of who uses it.
    """

    _kind = "resource"


class Connection(abc.ABC):
    """The only way of data between actions and resources.

    It checks the registration at each use; what is not registered does not reach
    a driver.
    """

    @abc.abstractmethod
    def names(self) -> list[str]:
        """Return the names of the resources that can be reached."""


class Supervisor(abc.ABC):
    """Deploys the components of one kind; adds and removes them at run time."""

    @property
    @abc.abstractmethod
    def phase(self) -> SupervisorPhase:
        """What the supervisor is doing."""

    @abc.abstractmethod
    async def add(self, component: Any, /) -> None:
        """Deploy a component while everything else keeps running."""

    @abc.abstractmethod
    async def remove(self, name: str) -> Any:
        """Take a component away while everything else keeps running."""

    @abc.abstractmethod
    async def replace(self, name: str, component: Any, /) -> Any:
        """Put another component in the place of one, under the same name."""
