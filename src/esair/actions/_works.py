"""What an action owes while nothing is wrong; `esair torture` looks whether it does it."""

from __future__ import annotations

from typing import Any

import attrs

from esair.actions._needs import attributes_of
from esair.exceptions import ConfigError
from esair.values import check_name, is_positive


@attrs.frozen
class Works:
    """What an action does for as long as nothing is wrong; made by `works`.

    Attributes:
        partners: The actuators that it commands, and the behaviors that it puts to, gets
            from or asks; all of them if there is none here.
        within: The longest pause between two times, in seconds; None if it owes nothing.
    """

    partners: tuple[str, ...] = ()
    within: float | None = None


def works(*partners: str, within: float = 4.0, idle: bool = False) -> Works:
    """Declare, as a class attribute, what an action does while nothing is wrong.

    A robot takes no notice of it. `esair torture` expects it again soon after the last
    fault, beside what the robot did steadily when nothing was done to it.

    Args:
        partners: The names of the actuators that it commands, or of the behaviors that
            it puts to, gets from or asks. Without any it is to do anything at all.
        within: Its longest pause, in seconds.
        idle: It owes nothing: it may rest, or end, whenever it likes. With partners, it
            owes nothing to those.

    Raises:
        ConfigError: A name, or the time, is none.

    Example:
        >>> class Patrol(esair.Behavior):
        ...     wheels = esair.writes(Twist)
        ...     rounds = esair.works("wheels", within=30.0)
    """
    for name in partners:
        check_name("works", name)
    if not idle and not is_positive(within):
        raise ConfigError(
            "works", "within", f"expected seconds > 0, not {within!r:.80}"
        )
    return Works(partners, None if idle else float(within))


def declared_works(action: Any) -> list[Works]:
    """Return what an action says that it does, or need not do."""
    values = attributes_of(type(action)).values()
    return [each for each in values if isinstance(each, Works)]
