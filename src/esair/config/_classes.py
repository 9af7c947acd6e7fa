"""From the names in a file to classes: ``module:Class``, or an installed name.

What is installed is an entry point that names a class, or a module: then the class is
the one public class there of the kind that the table asks for.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Final

from esair import abc
from esair.buses import MEDIA
from esair.config._mistakes import Mistakes
from esair.exceptions import describe, did_you_mean, hint_for, line_of

BUSES: Final[Mapping[str, str]] = {
    kind: f"{medium.package}:{medium.bus}" for kind, medium in MEDIA.items()
}
"""The kinds of bus that need no module name."""

_MODULE_AND_CLASS = re.compile(
    r"([^\W\d]\w*(?:\.[^\W\d]\w*)*):([^\W\d]\w*(?:\.[^\W\d]\w*)*)\Z"
)
_INSTALLED = re.compile(r"[A-Za-z][\w.-]{0,62}\Z")


@contextlib.contextmanager
def searched_first(folder: Path) -> Iterator[None]:
    """Find modules in a folder before all others, as for a script that lies there."""
    path = str(folder)
    sys.path.insert(0, path)
    importlib.invalidate_caches()
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):
            sys.path.remove(path)


def find_class(
    name: str,
    key: str,
    mistakes: Mistakes,
    *,
    group: str,
    folder: Path,
    kind: tuple[type, str] = (object, "a class"),
    built_in: Mapping[str, str] | None = None,
) -> type | None:
    """Return the class that a file names, or note what is wrong with the name."""
    built_in = built_in or {}
    target = built_in.get(name, name)
    if matched := _MODULE_AND_CLASS.match(target):
        return _import(matched[1], matched[2], key, mistakes, folder)
    if not _INSTALLED.match(name):
        mistakes.add(
            key,
            "expected 'module:Class', or the name of an installed driver, "
            f"not {name!r:.80}",
        )
        return None
    points = {
        point.name: point for point in importlib.metadata.entry_points(group=group)
    }
    if name not in points:
        known = [*built_in, *points]
        hint = hint_for(name, sorted(known))
        own = "module:Class"
        if "." in name:  # as Python would write it
            hint, own = "", ":".join(name.rsplit(".", 1))
        told = f"{name!r} is not installed{hint} (a class of your own is named {own!r})"
        mistakes.add(key, told)
        return None
    try:
        found: object = points[name].load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # the code of another package
        mistakes.add(key, _why_not_loaded(points[name], error))
        return None
    if inspect.ismodule(found):
        return _class_in(found, name, *kind, key, mistakes)
    return _checked_class(found, name, key, mistakes)


def _class_in(
    module: ModuleType, name: str, base: type, words: str, key: str, mistakes: Mistakes
) -> type | None:
    """Return the one public class of a kind in the module of an installed driver."""
    public: list[str] = getattr(module, "__all__", None) or [
        each
        for each, value in vars(module).items()
        if not each.startswith("_")
        and getattr(value, "__module__", "") == module.__name__
    ]
    classes = {
        each: found
        for each in public
        if isinstance(found := getattr(module, each, None), type)
    }
    fitting = {
        each: found
        for each, found in classes.items()
        if issubclass(found, base) and found is not base
    }
    if len(fitting) == 1:
        return next(iter(fitting.values()))
    if fitting:
        choices = ", ".join(f"'{module.__name__}:{each}'" for each in fitting)
        mistakes.add(key, f"{name!r} has several; expected one of {choices}")
        return None
    components = [
        each for each, found in classes.items() if issubclass(found, abc.Component)
    ]
    has = f"only {', '.join(components)}" if components else "none"
    mistakes.add(key, f"expected {words}, {name!r} ({module.__name__}) has {has}")
    return None


def _why_not_loaded(point: importlib.metadata.EntryPoint, error: BaseException) -> str:
    if not isinstance(error, ModuleNotFoundError) or not error.name:
        return f"{point.name!r} cannot be imported: {describe(error)}"
    text = f"{point.name!r} needs {error.name!r}, which is not installed"
    if point.dist is not None and point.name in point.dist.metadata.get_all(
        "Provides-Extra", []
    ):
        text += f": pip install '{point.dist.name}[{point.name}]'"
    return text


def _import(
    module_name: str, class_name: str, key: str, mistakes: Mistakes, folder: Path
) -> type | None:
    top = module_name.partition(".")[0]
    if top in sys.stdlib_module_names:
        mistakes.add(
            key,
            f"{top!r} is a module of Python itself, it has no drivers; name your own",
        )
        return None
    with searched_first(folder):
        try:
            module = importlib.import_module(module_name)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # the user's code may do anything
            mistakes.add(key, _why_not_imported(module_name, error, folder))
            return None
    if problem := _another_module(top, folder):
        mistakes.add(key, problem)
        return None
    found: object = module
    for part in class_name.split("."):
        try:
            found = getattr(found, part)
        except Exception:  # a module may have a __getattr__ of its own
            classes = [
                each for each, value in vars(module).items() if isinstance(value, type)
            ]
            mistakes.add(
                key,
                f"module {module_name!r} has no {class_name!r}"
                + (did_you_mean(class_name, classes) or ""),
            )
            return None
    return _checked_class(found, f"{module_name}:{class_name}", key, mistakes)


def _checked_class(
    found: object, name: str, key: str, mistakes: Mistakes
) -> type | None:
    if isinstance(found, type):
        return found
    mistakes.add(key, f"{name!r} is no class, but a {type(found).__name__}")
    return None


def _another_module(top: str, folder: Path) -> str | None:
    """Say so if a module beside the file has the name of another one that is used."""
    origin = getattr(sys.modules.get(top), "__file__", None)
    both = folder / f"{top}.py", folder / top / "__init__.py"
    beside = next((each for each in both if each.is_file()), None)
    if origin is None or beside is None or top == "__main__":
        return None
    if Path(origin).resolve() != beside.resolve():
        return (
            f"this process has imported another {top!r} already, from {origin}, "
            f"so {beside} cannot be used: give one of them another name"
        )
    if _is_needed(top, folder):
        return f"esair needs the package {top!r}: give {beside} another name"
    return None


def _is_needed(top: str, folder: Path) -> bool:
    """Whether esair imports the installed module of a name, maybe later."""
    others = [each for each in sys.path if Path(each).resolve() != folder.resolve()]
    if PathFinder.find_spec(top, others) is None:
        return False
    try:
        needed = " ".join(importlib.metadata.requires("esair") or ())
    except importlib.metadata.PackageNotFoundError:
        return False
    found = importlib.metadata.packages_distributions().get(top, ())
    return not {each.lower() for each in found}.isdisjoint(
        re.findall(r"[\w.-]+", needed)
    )


def _why_not_imported(module_name: str, error: BaseException, folder: Path) -> str:
    if isinstance(error, ModuleNotFoundError) and error.name:
        if module_name == error.name or module_name.startswith(f"{error.name}."):
            neighbours = [path.stem for path in sorted(folder.glob("*.py"))[:100]]
            hint = did_you_mean(error.name, neighbours)
            return (
                f"there is no module {error.name!r}, neither installed "
                f"nor in {folder}{hint}"
            )
        _, found, extra = error.msg.partition(": pip install ")  # see `of_extra`
        return (
            f"module {module_name!r} needs {error.name!r}, which is not installed"
            f"{found}{extra}{_place(error)}"
        )
    return (
        f"module {module_name!r} cannot be imported: {describe(error)}{_place(error)}"
    )


def _place(error: BaseException) -> str:
    place, _, _ = line_of(error).partition(", in ")
    return f" ({place})" if place else ""
