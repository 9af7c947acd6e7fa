"""What comes into a loop from outside, and the way in, as others see it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

Tag = tuple[str, ...]
"""Which call it is the end of, or who tells something: such as ``("sonar", "read")``."""


class Entry(NamedTuple):
    """What has come in.

    Attributes:
        number: Grows by one with each entry.
        time: When it came in, in seconds of the loop's clock.
        work: The number of the work that it is the end of; 0 if it is none.
        tag: Whose it is.
        function: What lets it take effect, in the loop.
        arguments: What the function gets.
    """

    number: int
    time: float
    work: int
    tag: Tag
    function: Callable[..., object]
    arguments: tuple[Any, ...]


class WayIn(Protocol):
    """What a replay needs of the door."""

    divert: Callable[[Entry], object] | None

    def bring(self, entry: Entry) -> None:
        """Bring in an entry, from any thread."""

    def end(self, tag: Tag, function: Callable[..., object], *arguments: Any) -> None:
        """Bring in the end of something in the loop itself."""
