"""Reactions: the reactive actions of a robot, and what they know of time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, TypeVar, cast, overload

from esair import minimal
from esair.actions._needs import Blind, Guards, Need, ProfiledAction, Reads, Writes
from esair.loop import REACHED
from esair.messages import Restart
from esair.values import snake_case

T = TypeVar("T")

_OF_STD = ("rate", "restart", "essential", "budget", "overrun_limit", "placement")
"""What a class of MIN may say about itself; all but the rate is for STD alone."""


class StepClock:
    """Knows the moments of a reaction's steps, and computes them when it asks."""

    __slots__ = ("_began", "before", "now", "reaction", "runs")

    def __init__(self, began: float, reaction: Any = None) -> None:
        self._began = began
        self.now: float | None = None
        """When the step began, in seconds of the loop's clock; None before the first,"""
        self.before: float | None = None  # and the one before it
        self.reaction: Any = reaction
        self.runs: bool = True  # whether what has it is run

    def step(self, now: float) -> None:
        self.before = self.now
        self.now = now
        if self.reaction is not None:
            self.tell()

    def telling(self, react: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that tells the reaction first, if it cannot ask."""
        if self.reaction is None:
            return react

        def told(*values: Any) -> Any:
            self.tell()
            return react(*values)

        return told

    def begin_anew(self, reaction: Any) -> None:
        """Know of no step; tell this one from now on."""
        self.now = self.before = None
        self.reaction = reaction

    def tell(self) -> None:
        """Tell the reaction, which cannot ask."""
        self.reaction.now_ms = self.now_ms
        self.reaction.elapsed_ms = self.elapsed_ms

    @property
    def now_ms(self) -> int:
        """The moment of this step, in whole milliseconds since the robot started."""
        return 0 if self.now is None else self._since_start(self.now)

    @property
    def elapsed_ms(self) -> int:
        """Milliseconds since its previous step; 0 at the first."""
        return (
            0 if self.before is None else self.now_ms - self._since_start(self.before)
        )

    def _since_start(self, moment: float) -> int:
        return int((moment - self._began + REACHED) * 1000.0)


class Told:
    """An attribute of a reaction that its clock answers.

    Outside of a robot, in a test of ``react`` say, it is 0 or what it was set to.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, reaction: Any, owner: type | None = None) -> int:
        fields = {} if reaction is None else vars(reaction)
        if "_step_clock" in fields:
            return cast(int, getattr(fields["_step_clock"], self._name))
        # A loop of MIN has told it; `elapsed_ms` is then an attribute of its own.
        days, rest = fields.get("_days", 0), fields.get("_ms", 0)
        return (days << 28) + rest if self._name == "now_ms" else 0


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

    essential: bool = False
    """Whether the robot ends, with an exit code, when it is FAILED."""

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


class MinimalReaction(Reaction):
    """Runs a reaction that was written for `esair.minimal`, as it is.

    Attributes:
        reaction: What decides.
    """

    def __init__(self, reaction: minimal.Reaction) -> None:
        reaction.name = reaction.name or snake_case(type(reaction).__name__)
        reads: dict[str, Reads[Any]] = {}
        writes: dict[str, Writes[Any]] = {}
        guarded: dict[str, Need] = {}
        for key, need in minimal.declared(reaction):
            of = Any if need.type is None else need.type
            about = of, need.name
            if hasattr(need, "max_age"):
                reads[key] = Reads(
                    *(*about, need.max_age, need.configure),
                    every=need.every,
                    optional=need.optional,
                )
            elif hasattr(need, "latch"):
                guarded[key] = Guards(*about, need.priority, need.latch, key)
            else:
                writes[key] = Writes(
                    *(*about, need.priority, need.hold, need.configure),
                    blind=need.blind,
                )
        super().__init__(name=reaction.name, reads=reads, writes=writes)
        self.reaction = reaction
        if guarded:
            self.needs = {**self.needs, **guarded}
        for name in _OF_STD:
            if hasattr(reaction, name):
                setattr(self, name, getattr(reaction, name))
        if type(reaction).react is not minimal.Reaction.react:
            # In the instance: its parameters are looked at, and nothing lies between.
            self.react = reaction.react  # type: ignore[method-assign]
        if type(reaction).blind is not minimal.Reaction.blind:
            self.blind = reaction.blind  # type: ignore[method-assign]


@overload
def adapt_action(action: minimal.Reaction) -> MinimalReaction: ...
@overload
def adapt_action(action: T) -> T: ...
def adapt_action(action: Any) -> Any:
    """Return what runs in STD: a reaction of MIN in its adapter, all else as it is."""
    return MinimalReaction(action) if isinstance(action, minimal.Reaction) else action
