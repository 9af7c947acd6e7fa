"""The one object of a kind that an event loop has."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, ClassVar, Self


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
