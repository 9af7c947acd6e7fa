"""Whether a command may leave now: one question, answered in one place.

`verdict` is pure: it looks at the gate of an actuator and at its hold, and changes
neither. It is asked by a write, by a write that has waited, by the look at what stands,
by operations, and by whoever wants to know why.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from esair.connections._halt import HALT, HALT_PRIORITY, Halt
from esair.exceptions import DeviceLostError, EsairError, StoppingError
from esair.messages import Refused, ResourceState, Why

if TYPE_CHECKING:
    from esair.connections._device import Device
    from esair.connections._protection import Protection
    from esair.connections._registrations import Registration

EARLY = 1e-6  # timers may fire a hair early

USER = "user"  # who holds an actuator that is being replaced

READY = ResourceState.READY  # hot


class BeingReplacedError(DeviceLostError):
    """The user is about to put another device in its place; no device was lost."""


class Gate:
    """What can keep every command from one actuator, whoever holds it.

    Whatever shuts it raises one of the two numbers in the same step, so that a thread
    which is about to call the driver needs to look at those alone (`ticket`).

    Attributes:
        device: Its state, and why it is not ready.
        holds: The blind holds in force, the highest first.
        latched: The robot stops: only the safe command leaves from now on.
        halts: Grows with each halt: a command from before is never sent after it.
        fence: Grows when the actuator is made safe, or is gone, or is about to go: what
            was begun before leaves no more.
        since: Since when it is being replaced, on the event loop's clock (seconds).
    """

    __slots__ = ("device", "fence", "halts", "holds", "latched", "since")

    def __init__(self, device: Device) -> None:
        self.device = device
        self.holds: tuple[Protection, ...] = ()
        self.latched = False
        self.halts = 0
        self.fence = 0
        self.since = 0.0

    def ticket(self, right: Registration | None) -> Callable[[], bool]:
        """Return what a thread asks just before it calls the driver."""
        halts, fence = self.halts, self.fence
        return lambda: (
            halts == self.halts
            and fence == self.fence
            and (right is None or right.usable)
        )

    @property
    def is_plain(self) -> bool:
        """Whether only a right that is void, or a holder, can be in a command's way."""
        device = self.device
        return (
            device.state is READY
            and device.error is None
            and not self.latched
            and not self.holds
            and device.registrations.halt is None
        )


class Hold:
    """Who holds one actuator and until when, and whose will it does.

    Attributes:
        holder: Who has written last, or operates it; None if it was given back.
        since: Since when it is the holder.
        begun: When it has written last, or when its operation must have ended.
        seconds: For how long it holds it after that.
        writer: Whose command stands; None if that was taken back, or is nobody's.
        written: When somebody has written last.
    """

    __slots__ = ("begun", "holder", "seconds", "since", "writer", "written")

    def __init__(self) -> None:
        self.holder: Registration | None = None
        self.writer: Registration | None = None
        self.since = self.begun = self.seconds = self.written = 0.0

    @property
    def until(self) -> float:
        """When the hold is over, on the loop's clock."""
        return self.begun + self.seconds

    def present(self, now: float) -> Registration | None:
        """Return who holds it now; None when the hold is over."""
        return self.holder if now + EARLY < self.begun + self.seconds else None

    def keeps_away(self, right: Registration, now: float) -> bool:
        """Tell whether the holder is in the way of somebody's command."""
        holder = self.holder
        return (
            holder is not None
            and holder is not right
            and now + EARLY < self.begun + self.seconds
            and right.priority <= holder.priority
            and holder.behavior != right.behavior
        )

    def refusal(self, holder: Registration) -> Refused:
        """Make the answer for a command that the holder keeps away."""
        rule = rule_of(holder)
        return Refused(holder.behavior, holder.priority, rule, self.since, self.until)


def shut(
    gate: Gate,
    right: Registration | None,
    now: float,
    asked: int | None = None,
    *,
    operates: bool = False,
) -> Refused | EsairError | None:
    """Return what keeps every command away that somebody has a right to; or None."""
    device = gate.device
    table = device.registrations
    if right is not None and not (operates or right.usable):
        return table.refusal(right)
    if gate.latched:
        return StoppingError(device.name, "stopping")
    halt = table.halt
    if halt is None and asked is not None and asked != gate.halts:
        told = "it was asked for before the robot was halted, or its computer slept"
        halt = Halt(told, now)
    if halt is not None:
        return Refused(HALT, HALT_PRIORITY, halt.reason, halt.since, None)
    error = device.error
    if isinstance(error, BeingReplacedError):
        return Refused(USER, HALT_PRIORITY, error.detail, gate.since, None)
    if error is not None or device.state is not READY:
        return device.absence()
    return None


def verdict(
    gate: Gate,
    hold: Hold,
    right: Registration | None,
    now: float,
    asked: int | None = None,
    *,
    operates: bool = False,
    is_still: bool = False,
) -> Refused | EsairError | None:
    """Return why a command may not leave now; None if it may.

    A refusal is false in a condition: compare what this returns with None.

    Args:
        gate: What can keep every command away.
        hold: Who holds the actuator.
        right: By which right somebody writes, or operates; None for what stands.
        now: The moment, on the loop's clock.
        asked: How many halts there were when it was asked for; as many as now if it is
            None.
        operates: It is an operation, which needs another kind of right.
        is_still: The command asks for what is safe, which no blind hold is against.
    """
    refused = shut(gate, right, now, asked, operates=operates)
    if refused is not None or right is None:
        return refused
    if not is_still:
        for each in gate.holds:
            if right.priority <= each.priority:
                return each.refusal()
    if hold.keeps_away(right, now):
        assert hold.holder is not None
        return hold.refusal(hold.holder)
    return None


def explain(gate: Gate, hold: Hold, now: float, told: object, *, is_safe: bool) -> Why:
    """Tell who holds an actuator, by which rule, and what would free it."""
    device = gate.device
    halt, error = device.registrations.halt, device.error
    holder = hold.present(now)
    blind = gate.holds[0] if gate.holds else None
    by: tuple[str, int, str, float, float | None]
    if halt is not None:
        by = HALT, HALT_PRIORITY, halt.reason, halt.since, None
        frees = "robot.resume(), by the user"
    elif isinstance(error, BeingReplacedError):
        by = USER, HALT_PRIORITY, error.detail, gate.since, None
        frees = "the device that takes its place, when it is open"
    elif blind is not None and (holder is None or holder.priority <= blind.priority):
        by = blind.component, blind.priority, blind.rule, blind.since, None
        frees = f"its next decision, or a write with a priority above {blind.priority}"
    elif holder is not None:
        by = holder.behavior, holder.priority, rule_of(holder), hold.since, hold.until
        frees = (
            f"a write with a priority above {holder.priority}, a release by "
            f"{holder.behavior}, or {hold.until - now:.3g} s without its writes"
        )
    else:
        rule = "it was told its safe command" if is_safe else "no hold is in force"
        return Why(device.name, device.state, rule=rule, last=told)
    return Why(device.name, device.state, *by)._replace(frees=frees, last=told)


def rule_of(holder: Registration) -> str:
    """Say by which rule somebody holds an actuator."""
    return (
        f"priority {holder.priority} of {holder.behavior!r} holds until it has not "
        "written for its hold; only a higher priority gets through"
    )
