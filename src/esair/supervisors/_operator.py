"""What an operator types to the behavior supervisor."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from esair.exceptions import ConfigError, did_you_mean

if TYPE_CHECKING:
    from esair.supervisors._behavior_supervisor import BehaviorSupervisor

_COMMANDS = {
    "list": ("", "name every behavior and what it is doing"),
    "query": ("NAME", "tell what a behavior is doing"),
    "remove": ("NAME", "take a behavior away"),
    "restart": ("NAME", "end the run of a behavior, and begin another"),
    "why": ("ACTUATOR", "tell who holds an actuator, and why"),
    "help": ("", "list the commands"),
}


async def command(supervisor: BehaviorSupervisor, text: str) -> str:
    """Do what an operator types; see `BehaviorSupervisor.command`."""
    if not isinstance(text, str):
        raise ConfigError("command", "", f"expected a line of text, not {text!r:.80}")
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigError("command", "", f"{error}: {text!r:.80}") from None
    if not words or words[0] not in _COMMANDS:
        verb = words[0] if words else ""
        hint = did_you_mean(verb, _COMMANDS) or f"; there are {', '.join(_COMMANDS)}"
        raise ConfigError("command", f"{verb!r:.80}", f"it is not known{hint}")
    verb, *arguments = words
    usage = _COMMANDS[verb][0]
    if len(arguments) != len(usage.split()):
        raise ConfigError("command", verb, f"expected: {verb} {usage}".rstrip())
    if verb == "help":
        return "\n".join(
            f"{f'{name} {usage}':<16} {doc}" for name, (usage, doc) in _COMMANDS.items()
        )
    if verb == "list":
        return "\n".join(
            f"{name}: {supervisor.query(name).state.value}"
            for name in supervisor.names()
        )
    (name,) = arguments
    if verb == "query":
        status = supervisor.query(name)
        detail = f" ({status.detail})" if status.detail else ""
        return f"{name}: {status.state.value}{detail}, {status.restarts} restarts"
    if verb == "why":
        return str(supervisor.resources.why(name))
    if verb == "restart":
        await supervisor.restart(name)
        return f"{name} was restarted"
    left = await supervisor.remove(name)
    return f"{name} was removed" + (
        f"; {len(left)} messages were not taken" if left else ""
    )
