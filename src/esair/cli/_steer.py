"""Verbs that steer a robot which runs on this computer: one act each."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Annotated, Any

from cyclopts import Parameter

from esair.cli._errors import CANNOT_USE, NOT_DONE, tell
from esair.cli._options import AsJson, Which
from esair.seat import ACTS, connect, robots, value_of
from esair.values import printable


def why(
    actuator: str | None = None, /, *, robot: Which = None, machine: AsJson = False
) -> int:
    """Tell who holds an actuator, why, and what would free it.

    Args:
        actuator: The actuator; all of them unless given.
    """
    return act(robot, "why", machine=machine, actuator=actuator)


def stop(
    reason: str = "",
    /,
    *,
    robot: Which = None,
    everyone: Annotated[bool, Parameter(name="--all")] = False,
    machine: AsJson = False,
) -> int:
    """Halt a robot: every actuator is safe and stays so until resume.

    Exit code 0 says that every actuator has answered.

    Args:
        reason: Why, for whoever looks at it.
        everyone: Halt every robot of this user on this computer.
    """
    names: list[str | None] = [*robots()] if everyone else [robot]
    found: list[Any] = []
    names = names or [None]  # which tells that there is none
    code = max(
        act(name, "stop", machine=machine, to=found, reason=reason) for name in names
    )
    answered = all(each["answered"] for told in found for each in told["told"])
    return code or (0 if answered else NOT_DONE)


def resume(*, robot: Which = None) -> int:
    """End all halts of a robot: who writes next moves."""
    return act(robot, "resume")


def put(
    receiver: str, data: str, /, *, interval: float = 1.0, robot: Which = None
) -> int:
    """Hand data to a behavior.

    Args:
        receiver: The behavior.
        data: JSON, or a text.
        interval: How long to try, in seconds.
    """
    return act(robot, "put", receiver=receiver, data=value_of(data), interval=interval)


def ask(
    receiver: str,
    request: str,
    /,
    *fields: str,
    timeout: float = 10.0,
    robot: Which = None,
    machine: AsJson = False,
) -> int:
    """Ask a behavior to do something, and print its answer.

    Args:
        receiver: The behavior.
        request: The name of the request's class.
        fields: Its fields: name=value.
        timeout: How long it may wait and work, in seconds.
    """
    given = _table(fields)
    if given is None:
        return CANNOT_USE
    return act(
        robot,
        "ask",
        machine=machine,
        wait=timeout + 5.0,
        receiver=receiver,
        request=request,
        fields=given,
        timeout=timeout,
    )


def operate(
    resource: str,
    operation: str,
    /,
    *fields: str,
    robot: Which = None,
    machine: AsJson = False,
) -> int:
    """Have a device do what its driver can, such as home.

    Args:
        resource: The device.
        operation: What it does.
        fields: What it takes: name=value.
    """
    given = _table(fields)
    if given is None:
        return CANNOT_USE
    return act(
        robot,
        "operate",
        machine=machine,
        wait=600.0,
        resource=resource,
        operation=operation,
        fields=given,
    )


def _table(words: tuple[str, ...]) -> dict[str, Any] | None:
    found: dict[str, Any] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign:
            tell(f"expected name=value, not {printable(word)}")
            return None
        found[name] = value_of(value)
    return found


def set_(
    setting: str, value: str, /, *, robot: Which = None, machine: AsJson = False
) -> int:
    """Change a setting of a device: set wheels.max_speed 0.2.

    Args:
        setting: The device and its setting, with a dot between.
        value: The new value; its unit and limits are those of the setting.
    """
    return act(robot, "set", machine=machine, setting=setting, value=value_of(value))


def mute(name: str, seconds: float, reason: str, /, *, robot: Which = None) -> int:
    """Let pass for a while what a guard or a blind hold keeps back.

    Args:
        name: The reaction that guards.
        seconds: For how long.
        reason: Why, for the log.
    """
    return act(robot, "mute", name=name, seconds=seconds, reason=reason)


def _of_one(verb: str, does: str, what: str) -> Callable[..., int]:
    """Make a verb that is about one component."""

    def do(name: str, /, *, robot: Which = None) -> int:
        return act(robot, verb, name=name)

    do.__name__, do.__doc__ = verb, f"{does}\n\nArgs:\n    name: {what}\n"
    return do


def act(
    robot: str | None,
    verb: str,
    /,
    *,
    machine: bool = False,
    wait: float = 15.0,
    to: list[Any] | None = None,
    **fields: Any,
) -> int:
    """Do one act and print its result."""
    with connect(robot) as client:
        result = client.do(verb, fields, timeout=wait)
    if to is not None:
        to.append(result)
    shown = json.dumps(result) if machine else ACTS[verb].tells(result)
    for line in shown.splitlines():
        print(printable(line))  # noqa: T201 - this is the output
    return 0


_PART, _GUARD = "The behavior or device.", "The reaction that guards."

VERBS = (
    why,
    stop,
    resume,
    put,
    ask,
    operate,
    _of_one("add", "Add what the robot's file has of this name now.", _PART),
    _of_one(
        "remove", "Take a behavior or device away; what it moves is safe first.", _PART
    ),
    _of_one(
        "replace", "Put what the robot's file has of this name now in its place.", _PART
    ),
    _of_one("restart", "Begin a behavior or device anew.", _PART),
    mute,
    _of_one("reset", "End the latch of a guard, after its cause is gone.", _GUARD),
)
"""The verbs whose names are those of their functions."""
