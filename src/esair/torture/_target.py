"""Whose robot it is: one of a file or of a module, made anew for each story."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import esair
from esair import config
from esair.exceptions import ConfigError, EsairError
from esair.torture._life import Habits

Make = Callable[[], esair.Robot]


class Target:
    """A robot that can be made as often as is needed.

    Args:
        name: What it is called: as it was named, or as a test names it.
        make: Makes the robot; it is not started.
        alone: The devices whose drivers are never called: a stand-in answers for each.
            None for all of them.

    Attributes:
        name: As above.
        alone: As above.
        file: The folder that tests are written for, and the words that name the
            robot; None if only this process knows it.
        habits: What it does when nothing is done to it; None before it was looked at.
    """

    def __init__(
        self, name: str, make: Make, *, alone: frozenset[str] | None = frozenset()
    ) -> None:
        self.name = name
        self.alone = alone
        self.file: Path | None = None
        self.own = False
        self.habits: Habits | None = None
        self._make = make

    @classmethod
    def of(cls, robot: str, *, own: bool = False) -> Target:
        """Find a robot by the words of a command line.

        Args:
            robot: A robot.toml, whose ``sim`` tables count; or ``module:robot``,
                ``file.py:robot``, where the name may be that of a function that
                returns a robot.
            own: The devices of a module's robot are harmless as they are: use them.
                Else, and for a file without ``sim`` tables, stand-ins answer that say
                values of the right type.

        Raises:
            ConfigError: There is no such robot.
            ExceptionGroup: A `ConfigError` for each mistake in the file.
        """
        if config.is_of_module(robot):
            target = cls._of_module(robot, own=own)
            where = robot.rpartition(":")[0]
            target.file = Path(where) if where.endswith(".py") else None
        else:
            target = cls._of_file(Path(robot))
            target.file = Path(robot)
        target.own = own
        return target

    @classmethod
    def _of_file(cls, path: Path) -> Target:
        simulated = _loads(path, simulated=True)
        if not simulated and not _loads(path):  # the mistakes that are meant are raised
            simulated = config.has_simulation(config.tables_of(path))
            config.load(path, simulated=simulated)

        def make() -> esair.Robot:
            made = config.build(config.load(path, simulated=simulated))
            return made.alike(*_parts(made))

        return cls(str(path), make, alone=frozenset() if simulated else None)

    @classmethod
    def _of_module(cls, robot: str, *, own: bool) -> Target:
        found = config.find_robot(robot)
        alone = frozenset[str]() if own else None
        if not isinstance(found, esair.Robot):
            maker = found

            def make() -> esair.Robot:
                made = maker()
                return made.alike(*_parts(made))

            return cls(robot, make, alone=alone)
        try:
            _copied(found, alone=not own)
        except Exception as error:  # the user's objects may hold anything
            raise ConfigError(
                robot,
                "",
                f"it cannot be made a second time ({type(error).__name__}: {error}): "
                "name a function that returns the robot instead",
            ) from error

        def copied() -> esair.Robot:
            return found.alike(*_copied(found, alone=not own))

        return cls(robot, copied, alone=alone)

    def make(self) -> esair.Robot:
        """Return a new robot, with neither a second process nor files nor sockets.

        Raises:
            EsairError: It cannot be made.
        """
        try:
            return self._make()
        except (EsairError, ExceptionGroup):
            raise
        except Exception as error:
            told = f"it cannot be made: {type(error).__name__}: {error}"
            raise ConfigError(self.name, "", told) from error


def _loads(path: Path, *, simulated: bool = False) -> bool:
    try:
        config.load(path, simulated=simulated)
    except ExceptionGroup:
        return False
    return True


def _parts(robot: esair.Robot) -> tuple[list[Any], list[Any]]:
    plan = robot.plan
    return list(plan.resources), list(plan.behaviors)


def _copied(robot: esair.Robot, *, alone: bool) -> tuple[list[Any], list[Any]]:
    """Copy the parts of a robot that was never started.

    Alone no bus is opened and no driver is called: what they have that cannot be copied,
    such as a module, is shared.
    """
    parts = _parts(robot)
    shared: dict[int, Any] = {}
    for each in parts[0] if alone else ():
        for held in (each.bus, *vars(each).values()):
            if held is each.bus or not _can_be_copied(held, shared):
                shared[id(held)] = held
    return copy.deepcopy(parts, shared)


def _can_be_copied(value: Any, shared: Mapping[int, Any]) -> bool:
    try:
        copy.deepcopy(value, dict(shared))
    except Exception:  # the user's objects may hold anything
        return False
    return True
