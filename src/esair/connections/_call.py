"""One call of a driver: its number, its opening, its deadline, and its end."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import attrs

from esair.exceptions import DeviceLostError
from esair.loop import wake

OPERATE = "operate"
"""How the calls of operations are named; the operation's name comes after it."""


class End(NamedTuple):
    """What came of a call: a value, or an error."""

    value: Any
    error: BaseException | None


Apply = Callable[["Call", End], None]


class Engine(Protocol):
    """What drives a call that waits."""

    def cancel(self) -> object:
        """Ask the driver's code to end."""


@attrs.define(eq=False, repr=False)
class Call:
    """One call of a driver that waits; one that ends in its first step is over at once."""

    resource: str
    kind: str  # what was called: read, write, safe, open, close, apply, identify
    opening: int  # the opening of the device that it belongs to
    number: int  # higher than that of all calls of this driver before
    args: tuple[Any, ...]
    begun: float  # when, on the loop's clock
    apply: Apply | None = None
    ended: float | None = None
    """When the driver's code has ended; None while it is alive."""
    outcome: End | None = None
    """What its caller was told; None while nobody was told anything."""
    cancelled: bool = False  # its caller has gone; what it still does is nobody's fault
    owner: object = None  # the right by which it was begun, if it needs one
    engine: Engine | None = None
    until: float = math.inf  # when its time is over, on the loop's clock
    limit: float = math.inf  # for how many seconds that was
    waiters: list[asyncio.Future[None]] = attrs.field(factory=list)
    taped: Callable[[End], None] | None = None  # keeps its end, where a run is recorded

    @property
    def is_abandoned(self) -> bool:
        """Whether its caller was told an outcome while it is still alive."""
        return self.ended is None and self.outcome is not None

    @property
    def may_move(self) -> bool:
        """Whether it may move an actuator: a command, or an operation."""
        return self.kind == "write" or self.kind.startswith(OPERATE)

    def cancel(self) -> None:
        """Ask the driver to end it; a thread cannot be asked."""
        self.cancelled = True
        if self.engine is not None:
            self.engine.cancel()

    def wake(self) -> None:
        """Let those go on who wait for its outcome, or its end."""
        waiters, self.waiters = self.waiters, []
        wake(*waiters)

    def __str__(self) -> str:
        what = ", ".join(f"{each!r:.40}" for each in self.args)
        return f"{self.kind} {self.number} ({what})" if what else self._short

    @property
    def _short(self) -> str:
        return f"{self.kind} {self.number}"


class GivenUpError(DeviceLostError):
    """The robot closes a device that is there: it may move still, and obey."""


def given_up(call: Call) -> GivenUpError:
    """Make the error for a device whose driver does not end a call."""
    return GivenUpError(call.resource, f"{call} was given up and does not end")
