"""Verbs that steer a robot which runs on this computer: one act each."""

from __future__ import annotations

import json
from typing import Annotated, Any

from cyclopts import Parameter

from esair.cli._errors import CANNOT_USE, tell
from esair.exceptions import EsairError
from esair.seat import ACTS, NoRobotError, connect, robots, value_of
from esair.values import printable

NOT_DONE = 1  # The exit code if the robot has not done it

Which = Annotated[str | None, Parameter(name=["--robot", "-r"])]
AsJson = Annotated[bool, Parameter(name="--json")]


def why(
    actuator: str | None = None, /, *, robot: Which = None, machine: AsJson = False
) -> int:
    """Tell who holds an actuator, why, and what would free it.

    Args:
        actuator: The actuator; all of them unless given.
        robot: The name of the robot, if several run.
        machine: JSON, for other programs.
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
        robot: The name of the robot, if several run.
        everyone: Halt every robot of this user on this computer.
        machine: JSON, for other programs.
    """
    names: list[str | None] = [*robots()] if everyone else [robot]
    names = names or [None]  # which tells that there is none
    return max(_stop(name, reason, machine=machine) for name in names)


def _stop(robot: str | None, reason: str, *, machine: bool) -> int:
    found: list[Any] = []
    code = act(robot, "stop", machine=machine, to=found, reason=reason)
    answered = all(each["answered"] for told in found for each in told["told"])
    return code or (0 if answered else NOT_DONE)


def resume(*, robot: Which = None) -> int:
    """End all halts of a robot: who writes next moves.

    Args:
        robot: The name of the robot, if several run.
    """
    return act(robot, "resume")


def put(
    receiver: str, data: str, /, *, interval: float = 1.0, robot: Which = None
) -> int:
    """Hand data to a behavior.

    Args:
        receiver: The behavior.
        data: JSON, or a text.
        interval: How long to try, in seconds.
        robot: The name of the robot, if several run.
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
        robot: The name of the robot, if several run.
        machine: JSON, for other programs.
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
        robot: The name of the robot, if several run.
        machine: JSON, for other programs.
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


def add(name: str, /, *, robot: Which = None) -> int:
    """Add what the robot's file has of this name now.

    Args:
        name: A behavior or device of the file.
        robot: The name of the robot, if several run.
    """
    return act(robot, "add", name=name)


def remove(name: str, /, *, robot: Which = None) -> int:
    """Take a behavior or device away; what it moves is safe first.

    Args:
        name: The behavior or device.
        robot: The name of the robot, if several run.
    """
    return act(robot, "remove", name=name)


def replace(name: str, /, *, robot: Which = None) -> int:
    """Put what the robot's file has of this name now in its place."""
    return act(robot, "replace", name=name)


def restart(name: str, /, *, robot: Which = None) -> int:
    """Begin a behavior or device anew.

    Args:
        name: The behavior or device.
        robot: The name of the robot, if several run.
    """
    return act(robot, "restart", name=name)


def set_(
    setting: str, value: str, /, *, robot: Which = None, machine: AsJson = False
) -> int:
    """Change a setting of a device: set wheels.max_speed 0.2.

    Args:
        setting: The device and its setting, with a dot between.
        value: The new value; its unit and limits are those of the setting.
        robot: The name of the robot, if several run.
        machine: JSON, for other programs.
    """
    return act(robot, "set", machine=machine, setting=setting, value=value_of(value))


def mute(name: str, seconds: float, reason: str, /, *, robot: Which = None) -> int:
    """Let pass for a while what a guard or a blind hold keeps back.

    Args:
        name: The reaction that guards.
        seconds: For how long.
        reason: Why, for the log.
        robot: The name of the robot, if several run.
    """
    return act(robot, "mute", name=name, seconds=seconds, reason=reason)


def reset(name: str, /, *, robot: Which = None) -> int:
    """End the latch of a guard, after its cause is gone.

    Args:
        name: The reaction that guards.
        robot: The name of the robot, if several run.
    """
    return act(robot, "reset", name=name)


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
    try:
        with connect(robot) as client:
            result = client.do(verb, fields, timeout=wait)
    except NoRobotError as error:
        tell(printable(str(error)))
        return CANNOT_USE
    except (EsairError, TimeoutError) as error:
        tell(printable(str(error)))
        return NOT_DONE
    if to is not None:
        to.append(result)
    shown = json.dumps(result) if machine else ACTS[verb].tells(result)
    for line in shown.splitlines():
        print(printable(line))  # noqa: T201 - this is the output
    return 0


VERBS = (
    why,
    stop,
    resume,
    put,
    ask,
    operate,
    add,
    remove,
    replace,
    restart,
    mute,
    reset,
)
"""The verbs whose names are those of their functions."""
