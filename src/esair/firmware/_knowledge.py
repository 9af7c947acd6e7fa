"""What MicroPython does not know, found in the text of a module."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from typing import Final

from esair.firmware._micropython import what_it_lacks

_TYPES: Final = (str, bytes, bytearray, int, float, list, tuple, dict, set, bool)

_OF_TYPES: Final = frozenset(
    name for each in _TYPES for name in dir(each) if not name.startswith("_")
)
"""The methods that values of built-in types have here."""

_NO_KEYWORDS: Final = {
    "deque": {"maxlen"},
    "from_bytes": {"byteorder", "signed"},
    "to_bytes": {"byteorder", "signed"},
    "namedtuple": {"defaults", "rename"},
    "print": {"flush"},
    "split": {"sep", "maxsplit"},
    "sum": {"start"},
    "zip": {"strict"},
}
"""Words that MicroPython's functions do not take; most of those give them by position."""

_ONLY_HERE: Final = frozenset({"machine", "esair", "__future__"})
"""Modules that are not asked about: those of a board, and those that are copied."""


def what_boards_do_not_know(tree: ast.AST) -> Iterator[tuple[int, str]]:
    yield from _syntax(tree)
    yield from _keywords(tree)
    yield from what_it_lacks(_used_of_modules(tree), _used_of_types(tree)) or ()


def _syntax(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Match):
            yield node.lineno, "MicroPython has no match statement: use if"
        elif isinstance(node, ast.ClassDef):
            for base in node.bases:
                if isinstance(base, ast.Subscript):
                    plain = ast.unparse(base.value)
                    yield (
                        node.lineno,
                        f"MicroPython knows no {ast.unparse(base)}: write {plain}",
                    )
        elif isinstance(node, ast.TryStar):
            yield node.lineno, "MicroPython has no except*"
        elif isinstance(node, ast.arguments) and node.posonlyargs:
            line = node.posonlyargs[0].lineno
            yield line, "MicroPython has no parameters by position only (/)"


def _keywords(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        name = (
            function.attr
            if isinstance(function, ast.Attribute)
            else getattr(function, "id", "")
        )
        for each in node.keywords:
            if each.arg in _NO_KEYWORDS.get(name, ()):
                yield node.lineno, f"MicroPython's {name} takes no {each.arg}="


def _used_of_modules(tree: ast.AST) -> dict[str, dict[str, int]]:
    """Return what is used of each imported module, with the line."""
    found: dict[str, dict[str, int]] = {}
    called: dict[str, str] = {}
    for node in run_on_boards(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                called[alias.asname or alias.name] = alias.name
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                found.setdefault(node.module, {}).setdefault(alias.name, node.lineno)
    for node in run_on_boards(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = called.get(node.value.id)
            if module is not None:
                found.setdefault(module, {}).setdefault(node.attr, node.lineno)
    return {
        module: names
        for module, names in found.items()
        if module.partition(".")[0] not in _ONLY_HERE
    }


def _used_of_types(tree: ast.AST) -> dict[str, int]:
    """Return the methods that only built-in types can mean, with the line."""
    own = {
        node.name
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
    }
    found: dict[str, int] = {}
    for node in run_on_boards(tree):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in _OF_TYPES - own
        ):
            found.setdefault(node.func.attr, node.lineno)
    return found


def run_on_boards(
    tree: ast.AST, asks: Collection[str] = ("ImportError", "AttributeError")
) -> Iterator[ast.AST]:
    """Yield all nodes but those for type checkers, and of a try that asks for an error."""
    types = getattr(tree, "annotation", None), getattr(tree, "returns", None)
    for node in ast.iter_child_nodes(tree):
        if node in types:
            continue  # boards leave them out
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from run_on_boards(ast.Module(node.orelse, []), asks)
        elif isinstance(node, ast.Try):
            caught = [each.type and ast.unparse(each.type) for each in node.handlers]
            if not any(not each or any(a in each for a in asks) for each in caught):
                yield from run_on_boards(node, asks)
        elif not (
            isinstance(node, ast.If)
            and "AttributeError" in asks
            and "hasattr" in ast.unparse(node.test)
        ):
            yield node
            yield from run_on_boards(node, asks)
