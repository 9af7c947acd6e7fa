"""What a component declares: the classes of what it gives, takes, asks and raises."""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator
from typing import Any, Final

from esair.codec._kinds import hints_of

_FRAMEWORK: Final = {"abc", "actions", "resources", "connections", "minimal", "loop"}
"""The rooms of esair whose classes say nothing of a robot's own data."""


def declared(kind: type) -> Iterator[Any]:
    """Yield the types that the class of a component declares, some more than once.

    They are those of its ports, requests and annotations, and the classes that stand
    beside it in its module, or in a module that is named there. Nothing is imported.
    """
    for base in kind.__mro__:
        room = base.__module__.split(".")
        if room[0] in {"builtins", "typing", "abc"} or (
            room[0] == "esair" and room[1] in _FRAMEWORK
        ):
            continue
        yield from getattr(base, "__orig_bases__", ())
        yield from hints_of(base).values()
        for each in vars(base).values():
            if isinstance(each, types.FunctionType):
                yield from hints_of(each).values()
            else:
                yield getattr(each, "type", None)  # a port
        yield from _in_module(base.__module__)


def _in_module(name: str) -> Iterator[type]:
    module = sys.modules.get(name)
    for each in list(vars(module).values()) if module is not None else ():
        if isinstance(each, type):
            yield each
        elif isinstance(each, types.ModuleType):
            for other in list(vars(each).values()):
                if isinstance(other, type) and other.__module__ == each.__name__:
                    yield other
