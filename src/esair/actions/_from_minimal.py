"""Reactions of ESAIR MIN in a robot of ESAIR STD."""

from __future__ import annotations

from typing import Any, TypeVar, overload

from esair import minimal
from esair.actions._needs import Reads, Writes
from esair.actions._reaction import Reaction
from esair.messages import snake_case

T = TypeVar("T")


class MinimalReaction(Reaction):
    """Runs a reaction that was written for `esair.minimal`, as it is.

    Attributes:
        reaction: What decides.
    """

    def __init__(self, reaction: minimal.Reaction) -> None:
        needs = minimal.declared(reaction)
        super().__init__(
            name=reaction.name or snake_case(type(reaction).__name__),
            reads={
                key: Reads(need.type, need.name, need.max_age, need.configure)
                for key, need in needs
                if isinstance(need, minimal.Reads)
            },
            writes={
                key: Writes(
                    need.type, need.name, need.priority, need.hold, need.configure
                )
                for key, need in needs
                if isinstance(need, minimal.Writes)
            },
        )
        self.reaction = reaction
        self.rate = reaction.rate
        if hasattr(reaction, "restart"):
            self.restart = reaction.restart
        if type(reaction).react is not minimal.Reaction.react:
            # In the instance: its parameters are looked at, and nothing lies between.
            self.react = reaction.react  # type: ignore[method-assign]

    def react(self, *args: Any, **readings: Any) -> Any:
        """Decide as the reaction does."""
        return self.reaction.react(*args, **readings)


@overload
def adapt_action(action: minimal.Reaction) -> MinimalReaction: ...
@overload
def adapt_action(action: T) -> T: ...
def adapt_action(action: Any) -> Any:
    """Return what runs in STD: a reaction of MIN in its adapter, all else as it is."""
    return MinimalReaction(action) if isinstance(action, minimal.Reaction) else action
