"""The one object of a kind that an event loop has."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Self

if TYPE_CHECKING:
    from esair.loop._turn import Turn


class OfLoop:
    """What an event loop has one of; it is made when it is asked for first.

    It is an attribute of the loop and they go together. In a table elsewhere it would
    keep every loop that ever was, because it refers to its loop.
    """

    __slots__ = ()

    if TYPE_CHECKING:

        def __init__(self, loop: asyncio.AbstractEventLoop) -> None: ...

    _attribute: ClassVar[str]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls._attribute = f"_esair_{cls.__name__}"

    @classmethod
    def of(cls, loop: asyncio.AbstractEventLoop) -> Self:
        """Return the one of a loop."""
        attributes: dict[str, Any] = vars(loop)
        found: Self | None = attributes.get(cls._attribute)
        if found is None:
            found = attributes[cls._attribute] = cls(loop)
        return found

    @classmethod
    def settle(cls, loop: asyncio.AbstractEventLoop, one: Self) -> None:
        """Give a loop this one."""
        vars(loop)[cls._attribute] = one


class OfTurn(OfLoop):
    """A part of the turns of a loop; all of them are made with its `Turn`."""

    __slots__ = ()

    if TYPE_CHECKING:

        def __init__(self, turn: Turn) -> None: ...

    made_by: ClassVar[Callable[[asyncio.AbstractEventLoop], Turn]]
    """What makes the turn of a loop, and with it all of its parts."""

    @classmethod
    def of(cls, loop: asyncio.AbstractEventLoop) -> Self:
        """Return the one of a loop, that of the robot if there is another beside it."""
        found: Self | None = vars(loop).get(cls._attribute)
        if found is None:
            turn_of(loop)
            found = vars(loop)[cls._attribute]
        return found


def turn_of(loop: asyncio.AbstractEventLoop) -> Turn:
    """Return what the turns of a loop have in common."""
    found: Turn | None = vars(loop).get("_esair_Turn")
    return OfTurn.made_by(loop) if found is None else found


def clock_of(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return what reads the clock of a loop's turns, in seconds.

    Where turns repeat it stands still while one lasts.
    """
    return turn_of(loop).time


def clock_beside(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return what reads a loop's clock amid a turn too, in any thread.

    What this reads may not decide anything in a robot, or it has to be kept: it is
    another in a replay.
    """
    return turn_of(loop).clock
