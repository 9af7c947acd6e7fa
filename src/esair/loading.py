"""Imports: of names when they are asked for, and of packages that an extra brings."""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any


def late(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and the ``__dir__`` of a package.

    Args:
        package: Its name.
        homes: The names that a module has, by the module, without the package.
    """
    homes = {name: home for home, names in homes.items() for name in names.split()}

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(importlib.import_module(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, found)
        return found

    return get, lambda: sorted(homes)


@contextlib.contextmanager
def of_extra(extra: str) -> Iterator[None]:
    """Say which extra of esair brings a package, where its import fails."""
    try:
        yield
    except ModuleNotFoundError as error:
        error.msg += f": pip install 'esair[{extra}]'"
        raise
