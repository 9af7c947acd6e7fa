"""What protects one actuator: holds of those that cannot see, and guards."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from esair.connections._actuator_device import ActuatorDevice
from esair.connections._call import Call, End
from esair.connections._driver import Guard
from esair.connections._protection import Protection
from esair.connections._registrations import Registration
from esair.connections._weaker import is_same, weaker_of
from esair.exceptions import BadValueError
from esair.journal import Kind
from esair.loop import OneShot, Order, Scheduler
from esair.messages import ResourceState
from esair.resources import HOLD

_EARLY = 1e-6  # timers may fire a hair early
_GRACE = 1e-5  # more than that


class ProtectedDevice(ActuatorDevice):
    """Keeps one actuator safe against whoever writes it."""

    __slots__ = (
        "_asked",
        "_blind",
        "_blind_look",
        "_fence",
        "_guards",
        "_still",
        "_writer",
        "holder",
    )

    # Of the channel, which decides who writes.
    holder: Registration | None
    until: float
    _accepts: bool
    _blocks: bool
    checked: Callable[[Any], Any]
    _copied: Callable[[Any], Any]
    _ended: Callable[[Call, End], None]
    _writer: Registration | None

    def attach(self, actuator: Any) -> None:
        if not hasattr(self, "_guards"):  # else what protects the name goes on
            self._blind: Protection | None = None
            """The hold in force of those that cannot see, the highest of several."""
            self._guards: tuple[Protection, ...] = ()
            self._blind_look: OneShot | None = None
            self._fence = 0
        self._asked: Any = None
        super().attach(actuator)

    def configured(self) -> None:
        """Take over what is safe, for protection: to stay where safe is a place to go."""
        super().configured()
        self._still = HOLD if self.actuator.safe_moves else self.actuator.safe

    def protect(
        self, holds: tuple[Protection, ...], guards: tuple[Protection, ...]
    ) -> None:
        """Obey these from this moment on; the table calls it at each change."""
        self._blind = holds[0] if holds else None
        self._guards = guards
        if holds:
            self._keep_still()

    @property
    def moves(self) -> bool:
        """Whether the device was told something else than to be safe, or to stay."""
        return (
            self.state is ResourceState.READY
            and not self._told_safe
            and self._told is not HOLD
            and self._safe_task is None
        )

    # Those that cannot see.

    def _keep_still(self) -> None:
        """Make it safe because somebody is blind, unless a higher priority moves it."""
        blind = self._blind
        if blind is None or not self.moves:
            return
        mover = self.holder
        if (
            mover is not None
            and mover is self._writer
            and self.time() - _EARLY < self.until
            and (
                mover.priority > blind.priority or not blind.is_against(mover.behavior)
            )
        ):
            if self._blind_look is None:
                # A hair later: who sees again at that very moment, sees.
                self._blind_look = Scheduler.of(self._loop).at(
                    self.until + _GRACE, self._look_at_blind, order=Order.STALE
                )
            return
        self.make_safe(stay=True)

    def _look_at_blind(self, _now: float) -> None:
        self._blind_look = None
        self._keep_still()

    def _look_no_more(self) -> None:
        if self._blind_look is not None:
            Scheduler.of(self._loop).cancel(self._blind_look)
            self._blind_look = None

    # Guards.

    def _pass_guards(
        self, command: Any, now: float
    ) -> tuple[Protection | None, str | None, Any]:
        self._asked = command
        moving, still = self.moves, self._still
        by: str | None = None
        passed = command
        for guard in self._guards:
            weighed = guard.weigh(passed, still, now, moving=moving, hand=self._copied)
            if weighed is not passed and weighed is not None:
                try:
                    weighed = self.checked(weighed)
                except BadValueError as error:  # the guard's own: it is asked no more
                    guard.crash(error)
                    weighed = None
                by = guard.component
            guard.note(weighed is None)
            if weighed is None:
                return guard, by, None
            passed = weighed
        return None, by, passed

    def _stay(self) -> None:
        """Make it safe at once because of a guard; who writes keeps the hold."""
        if self.moves:
            holder, writer = self.holder, self._writer
            self.make_safe(stay=True)
            self.holder, self._writer = holder, writer

    def review(self) -> None:
        """Put what stands to the guards again; only less than that may leave now."""
        if not (self._guards and self._accepts and self.moves):
            return
        stop, _by, passed = self._pass_guards(self._asked, self.time())
        if stop is not None:
            self._stay()
            return
        if passed is self._told or self._busy:
            return  # a call in flight: it is looked at again when that ends
        less = weaker_of(self._told, passed, self._still)
        if is_same(less, self._told):
            return
        if self._journal.heard:
            self._journal.publish(Kind.SENT, self.name, "", less)
        self._told = less
        self._told_at = self.time()
        try:
            sent = self.calls.begin(
                "write",
                self._write,
                (less,),
                self.actuator.deadline,
                self._may_leave() if self._blocks else None,
            )
        except Exception as error:
            self._failed(error, "write")
            return
        if type(sent) is Call:
            sent.apply = self._ended
            self._busy = True
            self._lane = sent
            self._told_error = "it has not answered yet"
        else:
            self._took(less, sent)

    def _may_leave(self) -> Guard:
        calls, opening, fence = self.calls, self.calls.opening, self._fence
        return lambda: (
            self._accepts and opening == calls.opening and fence == self._fence
        )

    # The safe command.

    def make_safe(self, *, stay: bool = False) -> asyncio.Task[bool]:
        """Send the safe command; what was begun before it leaves no more."""
        self._fence += 1
        self._look_no_more()
        return super().make_safe(stay=stay)
