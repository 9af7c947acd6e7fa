"""Who holds an actuator, and why a command was not sent, in words."""

from __future__ import annotations

import math

from esair.connections._halt import HALT, HALT_PRIORITY
from esair.connections._held_device import USER, BeingReplacedError, HeldDevice, rule_of
from esair.connections._registrations import Registration
from esair.messages import Refused, Why


def why(channel: HeldDevice, now: float) -> Why:
    """Tell who holds an actuator, by which rule, and what would free it."""
    holder = channel.holder
    halt = channel.registrations.halt
    if halt is not None:
        return Why(
            channel.name,
            channel.state,
            HALT,
            HALT_PRIORITY,
            halt.reason,
            halt.since,
            math.inf,
            "robot.resume(), by the user",
            channel.told().command,
        )
    if isinstance(channel.error, BeingReplacedError):
        return Why(
            channel.name,
            channel.state,
            USER,
            HALT_PRIORITY,
            channel.error.detail,
            channel.since,
            None,
            "the device that takes its place, when it is open",
            channel.told().command,
        )
    held = holder is not None and now < channel.until
    blind = channel.blind
    if blind is not None and not (
        held and holder is not None and holder.priority > blind.priority
    ):
        return Why(
            channel.name,
            channel.state,
            blind.component,
            blind.priority,
            blind.rule,
            blind.since,
            None,
            f"its next decision, or a write with a priority above {blind.priority}",
            channel.told().command,
        )
    if holder is None or not held:
        rule = (
            "it was told its safe command" if channel.is_safe else "no hold is in force"
        )
        return Why(channel.name, channel.state, rule=rule, last=channel.told().command)
    return Why(
        channel.name,
        channel.state,
        holder.behavior,
        holder.priority,
        rule_of(holder),
        channel.since,
        channel.until,
        f"a write with a priority above {holder.priority}, a release by "
        f"{holder.behavior}, or {channel.until - now:.3g} s without its writes",
        channel.told().command,
    )


def withdrawn(registration: Registration, now: float) -> Refused:
    """Answer a write whose own sender gave the actuator back before its turn came."""
    return Refused(
        registration.behavior,
        registration.priority,
        f"{registration.behavior!r} gave it back before the turn of this command came",
        now,
        now,
    )
