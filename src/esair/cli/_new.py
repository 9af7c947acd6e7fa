"""``esair new``: a robot project that runs in simulation at once."""

from __future__ import annotations

import importlib.util
import keyword
import os
import shutil
import sys
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.text import Text

from esair.cli._errors import CANNOT_USE, tell
from esair.exceptions import ConfigError
from esair.values import check_name

_RESERVED = {"esair", "test", "tests", "robot", "conftest"}


def new(
    name: str, /, *, folder: Annotated[Path, Parameter(name="--in")] = Path()
) -> int:
    """Make a robot project that runs in simulation at once.

    Args:
        name: The name of the robot, of its directory, and of its Python package.
        folder: Where the directory is made.
    """
    problem = _why_not(name, folder)
    if problem is not None:
        tell(problem)
        return CANNOT_USE
    project = folder / name
    try:
        write_project(name, project)
    except OSError as error:
        tell(f"{project} cannot be made: {error.strerror or error}")
        return CANNOT_USE
    console = Console(highlight=False, soft_wrap=True)
    console.print(Text(f"{project} is ready. Next:", "bold"))
    console.print(Text(f"  cd {project}"))
    console.print(
        Text("  esair sim robot.toml     # it drives, in simulation; Ctrl-C stops it")
    )
    console.print(Text("  python -m pytest         # its tests"))
    return 0


def _why_not(name: str, folder: Path) -> str | None:
    """Say why a project cannot have a name, or None if it can."""
    try:
        check_name("robot", name)
    except ConfigError as error:
        return str(error)
    if keyword.iskeyword(name) or keyword.issoftkeyword(name):
        return f"{name!r} is a word of Python itself: choose another name"
    if name in sys.stdlib_module_names:
        return f"{name!r} is a module of Python itself: choose another name"
    if name in _RESERVED:
        return f"{name!r} is needed for something else: choose another name"
    project = folder / name
    if os.path.lexists(project):
        return f"{project} exists already: choose another name, or remove it"
    if not folder.is_dir():
        return f"{folder} is no directory"
    if importlib.util.find_spec(name) is not None:
        return f"a Python package {name!r} is installed already: choose another name"
    return None


def write_project(name: str, project: Path) -> None:
    """Write all files of a project, or none."""
    project.mkdir()
    try:
        template = resources.files("esair.cli") / "templates" / "project"
        _copy(template, project, name)
    except BaseException:
        shutil.rmtree(project, ignore_errors=True)
        raise


def _copy(template: Traversable, to: Path, name: str) -> None:
    for part in template.iterdir():
        if part.name == "__pycache__":
            continue
        # The suffix keeps tools from taking a template for the real thing.
        target = to / part.name.removesuffix(".tmpl").replace("package", name)
        if part.is_dir():
            target.mkdir()
            _copy(part, target, name)
        else:
            text = part.read_text(encoding="utf-8").replace("{{name}}", name)
            target.write_text(text, encoding="utf-8")
