"""Reactions: the reactive actions of a robot."""

from __future__ import annotations

from typing import Any, ClassVar, cast

from esair.actions._needs import Blind, Guards, ProfiledAction, Reads, Writes
from esair.actions._step_clock import StepClock, Told
from esair.messages import Restart

EVERY_LIMIT = 256
"""How many readings of ports with ``every=True`` wait for a step; the oldest go."""


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

    now_ms: int = cast(int, Told())
    """The moment of this step, in whole milliseconds since the robot started."""

    elapsed_ms: int = cast(int, Told())
    """Milliseconds since its previous step; 0 at the first."""

    def take_clock(self, clock: StepClock) -> None:
        """Ask this clock from now on."""
        fields = vars(self)
        fields.pop("now_ms", None)
        fields.pop("elapsed_ms", None)
        fields["_step_clock"] = clock

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
