"""The one object of a kind that an event loop has."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Self


class OfLoop:
    """What an event loop has one of; it is made when it is asked for first.

    It is an attribute of the loop and they go together. In a table elsewhere it would
    keep every loop that ever was, because it refers to its loop.
    """

    __slots__ = ()

    if TYPE_CHECKING:

        def __init__(self, loop: asyncio.AbstractEventLoop) -> None: ...

    @classmethod
    def of(cls, loop: asyncio.AbstractEventLoop) -> Self:
        """Return the one of a loop."""
        attributes: dict[str, Any] = vars(loop)
        key = _KEYS[cls]
        found: Self | None = attributes.get(key)
        if found is None:
            found = attributes[key] = cls(loop)
        return found


class _Keys(dict[type, str]):
    """The names of the attributes: to make one takes as long as all the rest."""

    def __missing__(self, kind: type) -> str:
        key = self[kind] = f"_esair_{kind.__name__}"
        return key


_KEYS = _Keys()
