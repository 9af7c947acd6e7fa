"""A robot of a module: ``module:robot``, ``file.py:robot``; or of a program."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from esair.config._classes import searched_first
from esair.exceptions import ConfigError, describe, hint_for
from esair.standard import Robot, RunWanted, only_looking


def is_of_module(target: str) -> bool:
    """Tell whether a target names a robot of a module, and no file."""
    return ":" in target and not Path(target).exists()


def find_robot(target: str) -> Robot | Callable[[], Robot]:
    """Import a module and return the robot of it, or the function that makes it.

    Args:
        target: ``module:robot``, a module of this folder or an installed one, or
            ``file.py:robot``.

    Raises:
        ConfigError: There is no such module, or no such robot in it.
    """
    where, _, name = target.rpartition(":")
    try:
        with only_looking():
            module = _import_file(where) if where.endswith(".py") else _import(where)
    except KeyboardInterrupt:
        raise
    except RunWanted as wanted:
        told = (
            f"{where!r} starts the robot {wanted.robot.name!r} when it is imported: put "
            "that below if __name__ == '__main__'"
        )
        raise ConfigError(target, "", told) from None
    except BaseException as error:  # the user's code may do anything
        told = f"{where!r} cannot be imported: {describe(error)}"
        raise ConfigError(target, "", told) from error
    robots = [each for each, found in vars(module).items() if isinstance(found, Robot)]
    found = getattr(module, name, None)
    if isinstance(found, Robot):
        return found
    if callable(found):
        return lambda: _made(target, found)
    has = f"it has a {type(found).__name__}" if found is not None else "there is none"
    hint = hint_for(name, robots) if robots else ""
    told = f"expected an esair.Robot named {name!r} in {where!r}, {has}{hint}"
    raise ConfigError(target, "", told)


def robot_of(target: str) -> Robot:
    """Return the robot of a module or a program; it is not started.

    Args:
        target: ``module:robot`` or ``file.py:robot``, where the name may be that of a
            function that returns a robot; or ``program.py``, which is run until its
            `esair.run`.

    Raises:
        ConfigError: There is no such robot.
    """
    if not is_of_module(target):
        return _robot_of_program(target)
    found = find_robot(target)
    try:
        return found if isinstance(found, Robot) else found()
    except ConfigError:
        raise
    except Exception as error:  # the user's code may do anything
        raise ConfigError(target, "", f"it raised {describe(error)}") from error


def _made(target: str, maker: Callable[[], object]) -> Robot:
    made = maker()
    if isinstance(made, Robot):
        return made
    told = f"expected it to return an esair.Robot, not {made!r:.80}"
    raise ConfigError(target, "", told)


def _robot_of_program(path: str) -> Robot:
    """Run a program as Python does, and end it where it runs its robot."""
    place = Path(path)
    if not place.is_file():
        raise ConfigError(path, "", "there is no such file")
    program = ModuleType("__main__")
    program.__file__ = str(place)
    sys.modules["__main__"] = program
    sys.path.insert(0, str(place.resolve().parent))
    sys.argv = [str(place)]
    try:
        with only_looking():
            exec(compile(place.read_bytes(), str(place), "exec"), vars(program))
    except RunWanted as wanted:
        robot: Robot = wanted.robot
        return robot
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # the user's code may do anything
        told = f"it has ended before it ran a robot: {describe(error)}"
        raise ConfigError(path, "", told) from error
    raise ConfigError(path, "", "it has ended, and has not called esair.run(robot)")


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
