"""What a bus is given instead of a port of the computer: the far end of a wire."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from esair.buses._bus import Bus


class Wire:
    """The far end of a wire: memory, a pseudo-terminal, a simulation.

    A bus with ``wire=`` opens that and nothing else. A subclass has the method
    ``open`` that its medium asks for: `SerialWire`, `CanWire`, or for I²C and SPI a
    plain one that returns the link. As the kernel does, it tells of an arrival.
    """

    def __init__(self) -> None:
        self._on_plug: dict[Callable[[], None], None] = {}

    async def join(self, bus: Bus) -> Any:
        """Return the wire that a bus opens now; a simulation starts one first."""
        return self

    async def leave(self, bus: Bus) -> None:
        """Be told that a bus was closed."""

    def on_plug(self, listener: Callable[[], None]) -> None:
        """Call a function whenever the plug is in again."""
        self._on_plug[listener] = None

    def _tell_plugged(self) -> None:
        for listener in tuple(self._on_plug):
            listener()


class LateWire(Wire):
    """A wire that is made, or found, when a bus opens it.

    Args:
        find: Returns the wire for a bus.
        left: Is told that a bus was closed.
    """

    def __init__(
        self,
        find: Callable[[Bus], Awaitable[Wire]],
        left: Callable[[Bus], Awaitable[None]] | None = None,
    ) -> None:
        super().__init__()
        self._find = find
        self._left = left

    async def join(self, bus: Bus) -> Wire:
        return await self._find(bus)

    async def leave(self, bus: Bus) -> None:
        if self._left is not None:
            await self._left(bus)
