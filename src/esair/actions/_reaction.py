"""Reactions: the reactive actions of a robot."""

from __future__ import annotations

import inspect
from typing import Any, ClassVar

from esair.actions._needs import Blind, Guards, ProfiledAction, Reads, Writes
from esair.exceptions import ConfigError
from esair.messages import Restart
from esair.values import is_positive


class Reaction(ProfiledAction):
    """A reactive action: one small decision each step, on the newest readings.

    It runs on every new reading of its sensors, or at a fixed ``rate``. While one
    of its sensors is not heard yet, lost, removed or stale, and while it has
    crashed, it is *blind*: its actuators are kept safe against the same and lower
    priorities, unless its port says ``blind="release"``.

    A reaction with a port of `esair.guards` is a guard: ``react`` gets each command
    that anybody writes, and returns what of it may pass.

    Example:
        >>> class Avoid(esair.Reaction):
        ...     sonar = esair.reads(float, max_age=0.5)
        ...     wheels = esair.writes(Twist, priority=10)
        ...
        ...     def react(self, sonar: float) -> Twist | None:
        ...         return Twist(0.0, 1.2) if sonar < 0.4 else None
    """

    rate: float | None = None
    """How often it runs, in Hz; None to run on every new reading."""

    budget: float | None = None
    """How long one step may take, in seconds; None if there is no limit.

    A longer one is counted, and logged. In asyncio's debug mode there is always a
    budget: the loop's ``slow_callback_duration``.
    """

    overrun_limit: int | None = None
    """How many steps in a row may exceed the budget; one more is an error of it."""

    restart: Restart = Restart()
    """How often it is started again after an error."""

    mute_limit: float = 30.0
    """For how long the user may mute what it protects, in seconds; 0: not at all."""

    blind_unless_said: ClassVar[Blind] = "safe"

    def react(self, *args: Any, **readings: Any) -> Any:
        """Decide on the newest readings, which come by the names of their ports.

        Returns:
            A command; several as ``{"left": ..., "right": ...}``; or None for "no
            opinion", which gives the actuator back at once.
        """
        raise NotImplementedError

    def blind(self, *args: Any, **commands: Any) -> Any:
        """Of a guard: decide what of a command may pass while it cannot see.

        It gets the command by the name of its port, as ``react`` does, and no
        readings. Unless overridden it lets nothing pass.
        """
        return None

    @property
    def inputs(self) -> dict[str, Reads[Any]]:
        """What it reads, by the name of its port."""
        return {
            key: need for key, need in self.needs.items() if isinstance(need, Reads)
        }

    @property
    def outputs(self) -> dict[str, Writes[Any]]:
        """What it writes, by the name of its port."""
        return {
            key: need for key, need in self.needs.items() if isinstance(need, Writes)
        }

    @property
    def guarded(self) -> tuple[str, Guards[Any]] | None:
        """The port by which it guards an actuator, and its name; None if it does not."""
        for key, need in self.needs.items():
            if isinstance(need, Guards):
                return key, need
        return None


def mistakes_in_reaction(reaction: Reaction) -> list[ConfigError]:
    """Return what is wrong with the class of a reaction, whatever the robot."""
    found: list[ConfigError] = []
    name = reaction.name
    rate = reaction.rate
    if rate is not None and not (is_positive(rate) and rate <= 100_000):
        found.append(ConfigError(name, "rate", f"expected Hz > 0, not {rate!r:.80}"))
    budget, limit = reaction.budget, reaction.overrun_limit
    if budget is not None and not is_positive(budget):
        found.append(
            ConfigError(name, "budget", f"expected seconds > 0, not {budget!r:.80}")
        )
    if limit is not None and (type(limit) is not int or limit < 0):
        found.append(
            ConfigError(
                name, "overrun_limit", f"expected a whole number, not {limit!r:.80}"
            )
        )
    mute_limit = reaction.mute_limit
    if mute_limit != 0 and not is_positive(mute_limit):
        found.append(
            ConfigError(
                name, "mute_limit", f"expected seconds >= 0, not {mute_limit!r:.80}"
            )
        )
    guards = [key for key, need in reaction.needs.items() if isinstance(need, Guards)]
    if len(guards) > 1 or (guards and reaction.outputs):
        others = ", ".join([*guards[1:], *reaction.outputs])
        found.append(
            ConfigError(
                name,
                guards[0],
                f"a guard guards one actuator and writes none: make {others} part of "
                "another reaction",
            )
        )
    if rate is None and not reaction.inputs and not guards:
        found.append(
            ConfigError(
                name, "rate", "it reads no sensor, so it needs a rate (Hz) to run at"
            )
        )
    if getattr(reaction.react, "__func__", None) is Reaction.react:
        found.append(ConfigError(name, "react", "a reaction must have a react method"))
        return found
    if inspect.iscoroutinefunction(reaction.react):
        found.append(ConfigError(name, "react", "expected a plain function, not async"))
        return found
    if inspect.isgeneratorfunction(reaction.react):
        found.append(
            ConfigError(name, "react", "expected a plain function that does not yield")
        )
        return found
    given = [*reaction.inputs, *guards]
    kind = "readings and the command" if guards else "readings"
    try:
        inspect.signature(reaction.react).bind(**dict.fromkeys(given))
    except TypeError as error:
        found.append(
            ConfigError(
                name,
                "react",
                f"its parameters must be its {kind} ({', '.join(given) or 'none'}): "
                f"{error}",
            )
        )
    if guards:
        found.extend(_mistakes_in_blind(reaction, guards))
    return found


def _mistakes_in_blind(reaction: Reaction, guards: list[str]) -> list[ConfigError]:
    if inspect.iscoroutinefunction(reaction.blind):
        return [ConfigError(reaction.name, "blind", "expected a plain function")]
    try:
        inspect.signature(reaction.blind).bind(**dict.fromkeys(guards))
    except TypeError as error:
        told = f"its parameter must be the command ({guards[0]}): {error}"
        return [ConfigError(reaction.name, "blind", told)]
    return []
