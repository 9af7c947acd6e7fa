"""Parts of the kernel are small, and put together: nothing inherits to split a file."""

from __future__ import annotations

import ast
import ctypes
import functools
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from typing import Any

ROOMS = (
    *("loop", "connections", "supervisors", "actions"),
    *("resources", "plan", "standard", "journal"),
)
"""The kernel: what every robot stands on."""

FIELDS = 25

PROTOCOLS = 8
"""How many protocols the kernel has: what a user writes, and what another room gives."""


def classes() -> Iterator[type]:
    """Yield every class of the kernel, each once."""
    for room in ROOMS:
        package = importlib.import_module(f"esair.{room}")
        for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
            for each in vars(importlib.import_module(module.name)).values():
                is_own = inspect.isclass(each) and each.__module__ == module.name
                if is_own and not issubclass(each, ctypes.Array):
                    yield each


@functools.cache
def classes_in(module: str) -> dict[str, ast.ClassDef]:
    """Return the text of each class of a module, by its name; of equal ones the last."""
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    return {
        each.name: each for each in ast.walk(tree) if isinstance(each, ast.ClassDef)
    }


def source_of(cls: type) -> ast.ClassDef:
    """Return the text of a class, also of one that is no part of a module."""
    if "<locals>" not in cls.__qualname__:
        return classes_in(cls.__module__)[cls.__name__]
    (tree,) = ast.parse(inspect.cleandoc("\n" + inspect.getsource(cls))).body
    assert isinstance(tree, ast.ClassDef)
    return tree


def own_fields(cls: type) -> set[str]:
    """Return what a class itself gives its instances: declared, in slots, or set."""
    slots: Any = vars(cls).get("__slots__", ())
    found = {slots} if isinstance(slots, str) else set(slots)
    found |= vars(cls).get("__annotations__", {}).keys()
    for node in ast.walk(source_of(cls)):
        match node:
            case ast.Attribute(ast.Name("self"), name, ast.Store()):
                found.add(name)
    return {name for name in found if not is_of_class(cls, name)} - {"__weakref__"}


def is_of_class(cls: type, name: str) -> bool:
    """Tell whether a name is one of a property, or of something that the class has."""
    told = str(vars(cls).get("__annotations__", {}).get(name, ""))
    return "ClassVar" in told or isinstance(vars(cls).get(name), property)


def fields(cls: type) -> set[str]:
    """Return the fields of a class with those of its bases in esair."""
    bases = [each for each in cls.__mro__ if each.__module__.startswith("esair.")]
    return {name for each in bases for name in own_fields(each)}


def test_no_class_has_more_than_25_fields() -> None:
    """Its bases count, too: what has more is two things, and one is a part of the other."""
    sizes = {
        f"{each.__module__}.{each.__name__}": len(fields(each)) for each in classes()
    }
    largest = sorted(sizes.items(), key=lambda item: -item[1])[:10]
    print(largest)  # noqa: T201 - read with -s
    assert {name: n for name, n in sizes.items() if n > FIELDS} == {}


def test_a_field_is_seen_wherever_it_is_made() -> None:
    """The count would see one more, in slots, declared or set; what it sees is right."""

    class Base:
        declared: int = 0

    class Part(Base):
        __slots__ = ("slot",)

        def __init__(self) -> None:
            self.set_here, other = 1, self
            other.not_mine = 2  # type: ignore[attr-defined]

    assert own_fields(Part) == {"slot", "set_here"}
    assert own_fields(Base) == {"declared"}


def test_few_protocols() -> None:
    """What stands in the same room is imported by its name."""
    found = [
        f"{each.__module__}.{each.__name__}"
        for each in classes()
        if getattr(each, "_is_protocol", False)
    ]
    print(len(found), found)  # noqa: T201 - read with -s
    assert len(found) <= PROTOCOLS
