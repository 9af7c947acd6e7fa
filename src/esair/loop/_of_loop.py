"""The one object of a kind that an event loop has."""

from __future__ import annotations

import asyncio
from typing import Any, TypeVar

T = TypeVar("T")


def of_loop(loop: asyncio.AbstractEventLoop, kind: type[T]) -> T:
    """Return a loop's object of a class; it is made when it is asked for first.

    It is an attribute of the loop and they go together. In a table elsewhere it would
    keep every loop that ever was, because it refers to its loop.
    """
    attributes: dict[str, Any] = vars(loop)
    key = _KEYS[kind]
    found: T | None = attributes.get(key)
    if found is None:
        found = attributes[key] = kind(loop)  # type: ignore[call-arg]
    return found


class _Keys(dict[type, str]):
    """The names of the attributes: to make one takes as long as all the rest."""

    def __missing__(self, kind: type) -> str:
        key = self[kind] = f"_esair_{kind.__name__}"
        return key


_KEYS = _Keys()
