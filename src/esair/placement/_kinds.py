"""Which classes cross between a robot and a child."""

from __future__ import annotations

import sys
from typing import Any

from esair import messages
from esair.codec import Kinds, declared
from esair.connections import Halting, LastCommand, Stopped

ALWAYS = [each for each in vars(messages).values() if isinstance(each, type)] + [
    LastCommand
]


class KindsOfChild(Kinds):
    """The classes that a child may get: the robot names them, and it imports them."""

    def __init__(self) -> None:
        self._own: list[type] = []
        super().__init__(ALWAYS, more=self._add_own)

    def declare(self, kind: type) -> None:
        """Let those cross that a class declares."""
        self.programs.append(kind.__module__)
        self._own.append(kind)

    def _add_own(self, _: Kinds) -> None:
        while self._own:
            for each in declared(self._own.pop()):
                self.add(each)

    def find(self, name: str) -> Any:
        found = super().find(name)
        if found is None:
            module, _, path = name.partition(":")
            try:
                made: Any = sys.modules.get(module) or __import__(
                    module, fromlist=["_"]
                )
                for part in path.split("."):
                    made = getattr(made, part)
            except (ImportError, AttributeError):
                return None
            self.add(made)
            found = super().find(name)
        return found


def plain_result(value: Any) -> Any:
    """Return what crosses of a result that lives in the robot."""
    if isinstance(value, Stopped):
        return tuple(value), value.reason
    return None if isinstance(value, Halting) else value
