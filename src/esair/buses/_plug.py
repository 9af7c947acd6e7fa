"""What can be pulled out tells when it is back."""

from __future__ import annotations

from collections.abc import Callable


class Plug:
    """The far end's side of a cable: as the kernel does, it tells of an arrival."""

    def __init__(self) -> None:
        self._on_plug: dict[Callable[[], None], None] = {}

    def on_plug(self, listener: Callable[[], None]) -> None:
        """Call a function whenever the plug is in again."""
        self._on_plug[listener] = None

    def _tell_plugged(self) -> None:
        for listener in tuple(self._on_plug):
            listener()
