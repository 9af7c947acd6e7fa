"""Who keeps one actuator still: those that cannot see, the guards, and time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from esair.connections._call import Apply, Call
from esair.connections._gate import EARLY, Gate, Hold, verdict
from esair.connections._protection import Protection
from esair.connections._values import is_same, weaker_of
from esair.connections._wire import IDLE, SafeCommand, Wire
from esair.exceptions import BadValueError, EsairError
from esair.loop import DeadMan, OneShot, Order, Scheduler
from esair.messages import ResourceState
from esair.resources import HOLD

if TYPE_CHECKING:
    from esair.connections._device import Device

_GRACE = 1e-5  # more than `EARLY`


class Guards:
    """The guards of one actuator, and what was asked of it last.

    Attributes:
        all: The guards, by priority.
        asked: The command that was asked for last, before a guard has weighed it.
    """

    __slots__ = ("_wire", "all", "asked")

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self.all: tuple[Protection, ...] = ()
        self.asked: Any = None

    def weigh(
        self, command: Any, now: float, *, moving: bool
    ) -> tuple[Protection | None, str | None, Any]:
        """Put a command to all guards, each gets what the one before lets pass.

        Returns:
            The guard that refuses it, if one does; the one that has weakened it, if one
            has; and what passes.
        """
        wire = self._wire
        self.asked = command
        by: str | None = None
        for guard in self.all:
            weighed = guard.weigh(
                command, wire.still, now, moving=moving, hand=wire.copied
            )
            if weighed is not command and weighed is not None:
                try:
                    weighed = wire.check.checked(weighed)
                except BadValueError as error:  # the guard's own: it is asked no more
                    guard.crash(error)
                    weighed = None
                by = guard.component
            guard.note(weighed is None)
            if weighed is None:
                return guard, by, None
            command = weighed
        return None, by, command

    @property
    def stopping(self) -> Protection | None:
        """The first guard that has refused what it was asked last."""
        return next((guard for guard in self.all if guard.stopping), None)

    @property
    def shut(self) -> Protection | None:
        """The first guard that lets nothing pass now."""
        return next((guard for guard in self.all if guard.stops), None)


class Stillness:
    """Makes one actuator safe when nobody may move it, or nobody has for a time."""

    __slots__ = (
        "_device",
        "_gate",
        "_guards",
        "_hold",
        "_look",
        "_safe",
        "_scheduler",
        "_wire",
        "dead_man",
        "timeouts",
    )

    def __init__(
        self,
        device: Device,
        gate: Gate,
        hold: Hold,
        guards: Guards,
        wire: Wire,
        safe: SafeCommand,
    ) -> None:
        self._device = device
        self._gate = gate
        self._hold = hold
        self._guards = guards
        self._wire = wire
        self._safe = safe
        self._scheduler = Scheduler.of(device.loop)
        self._look: OneShot | None = None
        self.dead_man = DeadMan(device.loop, self)
        self.timeouts = 0  # how often it was made safe because nobody wrote

    def disarm(self) -> None:
        """It is safe, or gone: nobody holds it, and what was begun before is fenced."""
        self._hold.holder = self._hold.writer = None
        self._gate.fence += 1
        self.dead_man.disarm()
        self._look_no_more()

    # The dead man.

    @property
    def dies(self) -> float:
        """When it gets its safe command unless somebody writes, on the loop's clock."""
        return self._hold.written + self._wire.command_timeout

    def dead(self) -> None:
        """Make it safe, because nobody has written."""
        holder = self._hold.holder
        self.timeouts += 1
        self._safe.make()
        self._hold.holder = holder  # a longer hold keeps lower priorities away

    # Those that protect it.

    def is_still(self, command: Any) -> bool:
        """Tell whether a command asks for what protection would send: it moves nothing."""
        return is_same(command, self._wire.still)

    @property
    def moves(self) -> bool:
        """Whether the device was told something else than to be safe, or to stay."""
        told = self._wire.told
        return (
            self._device.state is ResourceState.READY
            and not told.is_safe
            and told.command is not HOLD
            and self._safe.state is IDLE
            and not self.is_still(told.command)
        )

    def keep_still(self) -> None:
        """Make it safe because somebody is blind, unless a higher priority moves it."""
        holds, hold = self._gate.holds, self._hold
        if not (holds and self.moves):
            return
        mover = hold.holder
        if (
            mover is not None
            and mover is hold.writer
            and mover.priority > holds[0].priority
            and self._device.time() - EARLY < hold.until
        ):
            self.look_when_over()
        else:
            self._safe.make(stay=True)

    def look_when_over(self) -> None:
        """Look again when the hold is over: who is blind may keep it still then."""
        self._look_no_more()  # that was when another one's hold ends
        # A hair later: who sees again at that very moment, sees.
        moment = self._hold.until + _GRACE
        self._look = self._scheduler.at(moment, self._look_again, order=Order.STALE)

    def _look_again(self, _now: float) -> None:
        self._look = None
        self.keep_still()

    def _look_no_more(self) -> None:
        if self._look is not None:
            self._scheduler.cancel(self._look)
            self._look = None

    def stay(self) -> None:
        """Make it safe at once because of a guard; who writes keeps the hold."""
        if self.moves:
            hold = self._hold
            holder, writer = hold.holder, hold.writer
            self._safe.make(stay=True)
            hold.holder, hold.writer = holder, writer

    def review(self, apply: Apply) -> None:
        """Put what stands to the guards again; only less than that may leave now."""
        guards, wire, now = self._guards, self._wire, self._device.time()
        if not (guards.all and self.moves):
            return
        if verdict(self._gate, self._hold, None, now) is not None:
            return
        stop, _by, passed = guards.weigh(guards.asked, now, moving=True)
        if stop is not None:
            self.stay()
            return
        told = wire.told
        if passed is told.command or wire.lane is not None:
            return  # a call in flight: it is looked at again when that ends
        if self._safe.state is not IDLE:
            return
        less = weaker_of(told.command, passed, wire.still)
        if is_same(less, told.command):
            return
        told.at = now
        guard = self._gate.ticket(None) if wire.blocks else None
        try:
            sent = wire.send(less, "", apply, guard)
        except EsairError:
            return  # it is told to those who look after the device
        if type(sent) is not Call:
            wire.took(less, sent)
