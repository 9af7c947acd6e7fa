"""Actuators: data flows from actions to them."""

from __future__ import annotations

import enum
from collections.abc import Awaitable, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from esair.resources._resource import Resource, ResourceSettings
from esair.values import value_type

if TYPE_CHECKING:
    from esair.watchdog import SafeFrames

T = TypeVar("T")


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
    """The fastest change, in units per second: of the command, or of its fields."""

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
    def value_type(self) -> Any:
        """The type of the commands, from the class or else from ``safe``."""
        declared = value_type(type(self), Actuator)
        if declared is Any and hasattr(self, "safe") and self.safe is not HOLD:
            return type(self.safe)
        return declared
