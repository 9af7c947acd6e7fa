"""While a robot is only looked at, none starts."""

from __future__ import annotations

import contextlib
import contextvars
from collections.abc import Iterator

from esair.exceptions import ConfigError

_looking: contextvars.ContextVar[bool] = contextvars.ContextVar(
    "esair.plan.looking", default=False
)


@contextlib.contextmanager
def only_looking() -> Iterator[None]:
    """Let no robot start meanwhile: a module is imported to see what robot it has."""
    token = _looking.set(True)
    try:
        yield
    finally:
        _looking.reset(token)


def refuse_while_looking(robot: str) -> None:
    """Raise if a robot starts while it is only looked at.

    Raises:
        ConfigError: It does.
    """
    if _looking.get():
        raise ConfigError(
            f"robot {robot!r}",
            "",
            "its module starts it when it is imported: put that below "
            "if __name__ == '__main__'",
        )
