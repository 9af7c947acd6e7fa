"""Put a mutant into the functions and classes of a module that is loaded already."""

from __future__ import annotations

import gc
import sys
from types import FunctionType
from typing import Any

from tests.mutation.mutants import Mutant

PLAIN = (bool, int, float, str, tuple, frozenset, type(None))


def loaded_functions() -> dict[tuple[Any, ...], list[FunctionType]]:
    """All functions by the place where they are written."""
    found: dict[tuple[Any, ...], list[FunctionType]] = {}
    for each in gc.get_objects():
        if type(each) is FunctionType:  # some answer for another object
            found.setdefault(_place(each), []).append(each)
    return found


def put_in(mutant: Mutant, loaded: dict[tuple[Any, ...], list[FunctionType]]) -> None:
    """Run the wrong file beside the module, and move what it makes over.

    Objects and subclasses that are there keep their class: its functions get other code.
    """
    (module,) = (
        module
        for module in list(sys.modules.values())
        if getattr(module, "__file__", None) == str(mutant.file)
    )
    before = dict(vars(module))
    beside = dict(before)
    exec(mutant.compile(), beside)
    for new in gc.get_objects():  # what is older is frozen
        if type(new) is FunctionType:
            for old in loaded.get(_place(new), ()):
                old.__code__ = new.__code__
                old.__defaults__ = new.__defaults__
                old.__kwdefaults__ = new.__kwdefaults__
                if new.__globals__ is not beside:  # written by attrs for a class
                    old.__globals__.update(new.__globals__)
    for name, made in beside.items():
        was = before.get(name)
        if made is was:
            continue
        if isinstance(made, type) and made.__module__ == module.__name__:
            for attribute, value in vars(made).items():
                if isinstance(value, PLAIN) and vars(was).get(attribute) != value:
                    setattr(was, attribute, value)
        elif isinstance(made, PLAIN) and made != was:
            for user in list(sys.modules.values()):
                if user.__name__.startswith("esair") and vars(user).get(name) is was:
                    setattr(user, name, made)


def _place(function: FunctionType) -> tuple[Any, ...]:
    # By its own name, too: all named tuples are made of one line of one string.
    code = function.__code__
    name = function.__module__, function.__qualname__
    return *name, code.co_filename, code.co_qualname, code.co_firstlineno
