"""While a program is only looked at, for the robot it has, none starts."""

from __future__ import annotations

import contextlib
import contextvars
from collections.abc import Iterator
from typing import Any

_looking: contextvars.ContextVar[bool] = contextvars.ContextVar(
    "esair.standard.looking", default=False
)


class RunWanted(BaseException):
    """A program has come to where it runs its robot; it is wanted, not its run.

    Attributes:
        robot: The robot, an `esair.Robot`.
    """

    def __init__(self, robot: Any) -> None:
        super().__init__(robot.name)
        self.robot = robot


@contextlib.contextmanager
def only_looking() -> Iterator[None]:
    """Have a robot raise `RunWanted` instead of its start meanwhile."""
    token = _looking.set(True)
    try:
        yield
    finally:
        _looking.reset(token)


def not_while_looking(robot: Any) -> None:
    """Raise `RunWanted` if robots are only looked at."""
    if _looking.get():
        raise RunWanted(robot)
