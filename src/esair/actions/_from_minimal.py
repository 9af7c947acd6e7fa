"""Reactions of ESAIR MIN in a robot of ESAIR STD."""

from __future__ import annotations

from typing import Any, TypeVar, overload

from esair import minimal
from esair.actions._needs import Guards, Need, Reads, Writes
from esair.actions._reaction import Reaction
from esair.values import snake_case

T = TypeVar("T")

_OF_STD = ("rate", "restart", "budget", "overrun_limit")
"""What a class of MIN may say about itself; all but the rate is for STD alone."""


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
            self._profile = {**self._profile, **guarded}
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
