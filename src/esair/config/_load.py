"""From a file to a robot, and to everything that can be known of it before it moves."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar, overload

import attrs

from esair.actions import Behavior, ProfiledAction, Reaction
from esair.buses import Bus
from esair.config._classes import searched_first
from esair.config._draft import Draft
from esair.config._network import (
    open_to_all,
    pair_mistakes,
    pair_warnings,
    strangers,
)
from esair.config._parts import make_draft, refused_by_robot
from esair.config._source import read_source
from esair.exceptions import ConfigError, describe, hint_for
from esair.messages import BehaviorsPolicy, Policy
from esair.plan import Protection, examine, failures, protection
from esair.resources import Resource
from esair.standard import Robot, RunWanted, only_looking

OPENED: Final = {
    "record": ("foxglove", "record"),
    "page": ("uvicorn", "page"),
    "network": ("zenoh", "net"),
    "camera": ("cv2", "camera"),
    "gamepad": ("evdev", "gamepad"),
    "gpio": ("gpiod", "gpio"),
    "spi": ("spidev", "spi"),
}
"""The package and the extra of what imports its package when it is opened, not before."""


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


R = TypeVar("R")


@attrs.define(eq=False)
class Description:
    """What one configuration file says, checked as a whole.

    The components are made, so that their own checks have passed; no device or
    bus is opened. They serve one robot: load the file again for another one.

    Attributes:
        path: The file.
        digest: SHA-256 of the file as it was read, in hexadecimal.
        text: What it says.
        simulated: Whether the ``sim`` tables of the devices were used.
        robot: The keywords of the robot, its name among them.
        buses: The buses, by name.
        resources: The sensors and actuators, by name.
        behaviors: The behaviors and reactions, by name.
        policies: Who may do what with a resource, by the name of the resource; under
            ``behaviors`` who may manage others.
    """

    path: Path
    digest: str
    text: str
    simulated: bool
    robot: Mapping[str, Any]
    buses: Mapping[str, Bus]
    resources: Mapping[str, Resource]
    behaviors: Mapping[str, Behavior | Reaction]
    policies: Mapping[str, Policy | BehaviorsPolicy]
    is_built: bool = attrs.field(default=False, init=False)
    """Whether a robot was made of it."""

    @property
    def name(self) -> str:
        """The name of the robot."""
        return str(self.robot["name"])


def load(
    path: str | os.PathLike[str],
    *,
    simulated: bool = False,
    robot_class: type = Robot,
    text: str | None = None,
) -> Description:
    """Read and check a configuration; nothing is opened, nothing moves.

    Modules that the file names are also found in its own folder.

    Args:
        path: The file, in TOML.
        simulated: Whether the ``sim`` tables replace what they stand beside.
        robot_class: The class of the robot, if it is not `esair.Robot`: its
            keywords are the keys of the table ``[robot]``.
        text: What the file says; it is read unless given.

    Raises:
        ConfigError: The file cannot be read, or is no TOML.
        ExceptionGroup: Every mistake in it at once, each a `ConfigError` that
            names file, line, key, and what was expected.
    """
    source = read_source(path, text)
    draft = make_draft(source, simulated=simulated, robot_class=robot_class)
    for finding in examine(draft.plan()):
        if finding.is_error:
            source.mistakes.add(draft.key_of(finding), finding.text)
    refused_by_robot(draft, robot_class, sound=not source.mistakes.errors)
    source.mistakes.raise_all()
    return Description(
        path=source.path,
        digest=source.digest,
        text=source.text,
        simulated=simulated,
        robot=draft.robot,
        buses=draft.made(Bus),
        resources=draft.made(Resource),
        behaviors=draft.made(ProfiledAction),
        policies=draft.policies,
    )


@overload
def build(description: Description) -> Robot: ...
@overload
def build(description: Description, robot_class: Callable[..., R]) -> R: ...
def build(description: Description, robot_class: Callable[..., Any] = Robot) -> Any:
    """Make the robot that was described. It is not started.

    Args:
        description: What `load` returned; it serves for one robot.
        robot_class: The class of the robot; `esair.Robot` unless given.

    Raises:
        ConfigError: A robot was made of this description already.
        ExceptionGroup: The robot refuses what is described.
    """
    if description.is_built:
        raise ConfigError(
            str(description.path),
            "",
            "a robot was made of it already: load the file again",
        )
    robot = robot_class(
        resources=list(description.resources.values()),
        behaviors=list(description.behaviors.values()),
        policies=list(description.policies.values()),
        **description.robot,
    )
    description.is_built = True
    robot.source = (description.path, description.simulated)
    return robot


def load_robot(
    path: str | os.PathLike[str], robot_class: type[R], simulated: bool = False
) -> R:
    """Make a robot from a file; see `load` and `build`."""
    description = load(path, simulated=simulated, robot_class=robot_class)
    return build(description, robot_class)


@attrs.frozen
class FoundInFile:
    """A finding, and where it is in the file.

    Attributes:
        severity: ``"error"`` or ``"warning"``.
        rule: Which rule found it: ``configuration`` (a key is wrong), ``package`` (one
            is not installed here), or one of those of `esair.plan.Finding`.
        key: The key, as a dotted path; empty for the whole file.
        line: The line, counted from 1; None if it is not known.
        message: What is wrong, and what to do.
        only_simulated: Whether it holds for ``esair sim`` only.
    """

    severity: str
    rule: str
    key: str
    line: int | None
    message: str
    only_simulated: bool = False


@attrs.frozen
class Report:
    """What was found in one file.

    Attributes:
        file: The file or module, as it was named.
        digest: SHA-256 of the file as it was read, in hexadecimal.
        findings: What was found, in the order of the file, errors first.
        actuators: How each actuator is made safe.
        with_simulation: Whether the ``sim`` tables were checked too.
        failures: What happens when a behavior or reaction fails again and again, by its
            name, in words.
    """

    file: str
    digest: str
    findings: tuple[FoundInFile, ...]
    actuators: tuple[Protection, ...]
    with_simulation: bool
    failures: Mapping[str, str] = attrs.field(factory=dict)

    @property
    def errors(self) -> int:
        """How many errors there are."""
        return sum(finding.severity == "error" for finding in self.findings)

    @property
    def warnings(self) -> int:
        """How many warnings there are."""
        return len(self.findings) - self.errors


def check_together(
    paths: Sequence[str | os.PathLike[str]], *, robot_class: type = Robot
) -> list[Report]:
    """Find every mistake of robots that use each other: in each file, and between them.

    Args:
        paths: Their files; a module is looked at alone.
        robot_class: The class of their robots.

    Raises:
        ConfigError: One cannot be read.
    """
    reports = [check(path, robot_class=robot_class) for path in paths]
    if len(paths) < 2:
        return reports
    drafts = {
        number: make_draft(read_source(path), simulated=False, robot_class=robot_class)
        for number, path in enumerate(paths)
        if not is_of_module(str(path))
    }
    for number, mine in drafts.items():
        others = [each for each in drafts.values() if each is not mine]
        lines, told = mine.source.mistakes.lines, [("warning", strangers(mine, others))]
        for other in others:
            told.append(("error", pair_mistakes(mine, other)))
            told.append(("warning", pair_warnings(mine, other)))
        found = [
            FoundInFile(severity, "peer", key, lines.of(key), why)
            for severity, each in told
            for key, why in each
        ]
        every = (*found, *reports[number].findings)
        reports[number] = attrs.evolve(reports[number], findings=every)
    return reports


def check(path: str | os.PathLike[str], *, robot_class: type = Robot) -> Report:
    """Find every mistake of a robot at once, without opening a device.

    A file is checked as it is, and, if it has any ``sim`` table, as a simulation.

    Args:
        path: A robot.toml; or the robot of a module: ``module:robot``, ``file.py:robot``.
        robot_class: The class of a file's robot.

    Raises:
        ConfigError: The file or module cannot be read, or there is no such robot in it.
    """
    if is_of_module(str(path)):
        return _of_module(str(path))
    source = read_source(path)
    real = make_draft(source, simulated=False, robot_class=robot_class)
    found = _found(real, robot_class)
    with_simulation = has_simulation(source.data)
    if with_simulation:
        simulated = make_draft(
            read_source(path), simulated=True, robot_class=robot_class
        )
        known = {(each.key, each.message) for each in found}
        found += [
            attrs.evolve(each, only_simulated=True)
            for each in _found(simulated, robot_class)
            if (each.key, each.message) not in known
        ]
    found.sort(key=lambda each: (each.severity, each.line or 0))
    return Report(
        file=source.mistakes.file,
        digest=source.digest,
        findings=tuple(found),
        actuators=tuple(protection(real.plan())),
        with_simulation=with_simulation,
        failures=failures(real.plan()),
    )


def _of_module(target: str) -> Report:
    plan = robot_of(target).plan
    found = []
    for each in sorted(examine(plan), key=lambda each: each.severity.value):
        key = ".".join(part for part in (each.component, each.field) if part)
        level = each.severity.value
        found.append(FoundInFile(level, each.rule, key, None, each.text))
    table = tuple(protection(plan))
    return Report(target, "", tuple(found), table, False, failures(plan))


def has_simulation(tables: Mapping[str, Any]) -> bool:
    """Tell whether a file says what stands for some part of it in a simulation."""
    kinds = (tables.get(each) for each in ("bus", "sensor", "actuator"))
    parts = (part for kind in kinds if isinstance(kind, dict) for part in kind.values())
    every = (tables.get("network"), tables.get("ros"), *parts)
    return any(isinstance(part, dict) and "sim" in part for part in every)


def _found(draft: Draft, robot_class: type) -> list[FoundInFile]:
    mistakes = draft.source.mistakes
    findings = examine(draft.plan())
    page = draft.robot.get("page")
    try:
        if page is not None:
            page.tls()
    except ConfigError as error:
        mistakes.caught("page", error, "the page")
    sound = not mistakes.errors and not any(each.is_error for each in findings)
    refused_by_robot(draft, robot_class, sound=sound)
    told = [
        (each.severity.value, each.rule, draft.key_of(each), each.text)
        for each in findings
    ]
    told += _not_installed(draft)
    if warned := open_to_all(draft.peers):
        told.append(("warning", "peer", "network.insecure", warned))
    return [
        FoundInFile("error", "configuration", error.key, error.line, error.reason)
        for error in mistakes.errors
    ] + [
        FoundInFile(level, rule, key, mistakes.lines.of(key), text)
        for level, rule, key, text in told
    ]


def _not_installed(draft: Draft) -> Iterator[tuple[str, str, str, str]]:
    """Return what needs a package that is not here: without a device a robot starts."""
    value = draft.source.value
    words = {key: key for key in OPENED if key in draft.source.data}
    if not draft.simulated:
        for key in (each.key for each in draft.parts):
            words[key] = str(value(f"{key}.driver") or value(f"{key}.type"))
    for key, word in words.items():
        package, extra = OPENED.get(word, ("", ""))
        if package and importlib.util.find_spec(package) is None:
            told = f"it needs {package!r}, which is not installed here"
            level = "error" if key in ("record", "page") else "warning"
            yield level, "package", key, f"{told}: pip install 'esair[{extra}]'"
