"""A robot of a module: ``module:robot``, or ``file.py:robot``."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from esair.config import FoundInFile, Report, searched_first
from esair.exceptions import ConfigError, describe, did_you_mean
from esair.plan import Finding, examine, only_looking, protection
from esair.standard import Robot


def is_of_module(target: str) -> bool:
    """Tell whether a target names a robot of a module, and no file."""
    return ":" in target and not Path(target).exists()


def check_robot(target: str) -> Report:
    """Find every mistake of a robot of a module, without starting it.

    Args:
        target: ``module:robot``, a module of this folder or an installed one, or
            ``file.py:robot``.

    Raises:
        ConfigError: There is no such module, or no such robot in it.
    """
    plan = find_robot(target).plan
    findings = [_shown(each) for each in examine(plan)]
    findings.sort(key=lambda each: each.severity)
    return Report(
        file=target,
        digest="",
        findings=tuple(findings),
        actuators=tuple(protection(plan)),
        with_simulation=False,
    )


def find_robot(target: str) -> Robot:
    """Import a module and return the robot of it, which is not started.

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
    if isinstance(found, Robot):
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


def _shown(finding: Finding) -> FoundInFile:
    where = ".".join(each for each in (finding.component, finding.field) if each)
    return FoundInFile(finding.severity.value, finding.rule, where, None, finding.text)
