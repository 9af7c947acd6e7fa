"""A robot of a module: ``module:robot``, or ``file.py:robot``."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, overload

from esair.config._classes import searched_first
from esair.exceptions import ConfigError, describe, did_you_mean
from esair.plan import only_looking
from esair.standard import Robot


def is_of_module(target: str) -> bool:
    """Tell whether a target names a robot of a module, and no file."""
    return ":" in target and not Path(target).exists()


@overload
def find_robot(target: str) -> Robot: ...
@overload
def find_robot(
    target: str, *, or_maker: Literal[True]
) -> Robot | Callable[[], object]: ...
def find_robot(target: str, *, or_maker: bool = False) -> Any:
    """Import a module and return the robot of it, which is not started.

    Args:
        target: ``module:robot``, a module of this folder or an installed one, or
            ``file.py:robot``.
        or_maker: A function that returns a robot will do, too.

    Raises:
        ConfigError: There is no such module, or no such robot in it.
    """
    where, _, name = target.rpartition(":")
    try:
        with only_looking():
            module = _import_file(where) if where.endswith(".py") else _import(where)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # the user's code may do anything
        told = f"{where!r} cannot be imported: {describe(error)}"
        raise ConfigError(target, "", told) from error
    robots = [each for each, found in vars(module).items() if isinstance(found, Robot)]
    found = getattr(module, name, None)
    if isinstance(found, Robot) or (or_maker and callable(found)):
        return found
    has = f"it has a {type(found).__name__}" if found is not None else "there is none"
    hint = did_you_mean(name, robots) or (
        f"; there are {', '.join(robots)}" if robots else ""
    )
    told = f"expected an esair.Robot named {name!r} in {where!r}, {has}{hint}"
    raise ConfigError(target, "", told)


def _import(name: str) -> ModuleType:
    with searched_first(Path.cwd()):
        return importlib.import_module(name)


def _import_file(path: str) -> ModuleType:
    place = Path(path)
    if not place.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    name = place.stem
    if name in sys.modules or name in sys.stdlib_module_names:
        name = f"checked_{name}"  # what is there stays what it is
    spec = importlib.util.spec_from_file_location(name, place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    with searched_first(place.resolve().parent):
        spec.loader.exec_module(module)
    return module
