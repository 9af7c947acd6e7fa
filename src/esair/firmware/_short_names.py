"""Cheaper names: a board keeps the letters of each name that it does not have in ROM."""

# ruff: noqa: SIM905

from __future__ import annotations

import ast
import itertools
import string
from collections.abc import Iterator

from esair.firmware._bundle import identifiers

_IN_ROM = (
    "pop get sort keys find join copy send items index count upper lower split strip "
    "clear throw append extend insert remove values update format lstrip rstrip "
    "replace reverse popitem rsplit isalpha isdigit islower isupper isspace rindex rfind "
    "endswith fromkeys setdefault startswith"
).split()
"""Methods of lists, dictionaries, texts and generators, which every board knows."""


def rename_attributes(tree: ast.Module, kept: frozenset[str]) -> None:
    """Give cheap names to the attributes and methods that a program itself defines.

    Args:
        tree: The whole program.
        kept: Names that something else knows.
    """
    kept |= {name for node in ast.walk(tree) for name in _texts(node)}
    made = {
        name: None  # in the order of their first appearance
        for node in ast.walk(tree)
        for name in _defined(node)
        if len(name) > 1 and name not in kept and not name.startswith("__")
    }
    taken = kept | set(identifiers(tree))
    free = (name for name in _names() if name not in taken)
    short = dict(zip(made, free, strict=False))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            node.attr = short.get(node.attr, node.attr)
        elif isinstance(node, ast.ClassDef):
            for part in node.body:
                if isinstance(part, ast.FunctionDef):
                    part.name = short.get(part.name, part.name)
                for target in getattr(part, "targets", ()):
                    if isinstance(target, ast.Name):
                        target.id = short.get(target.id, target.id)


def free_parameters(tree: ast.Module) -> None:
    """Let parameters be renamed, by making them positional, where no call names them."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    named = {word.arg for call in calls for word in call.keywords}
    for node in ast.walk(tree):
        if not isinstance(node, ast.arguments) or None in named:
            continue
        if not named & {each.arg for each in node.args}:
            node.posonlyargs, node.args = [*node.posonlyargs, *node.args], []


def _texts(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value


def _defined(node: ast.AST) -> Iterator[str]:
    """Yield the attributes that a node defines: by assignment, or in a class."""
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        yield node.attr
    elif isinstance(node, ast.ClassDef):
        for part in node.body:
            if isinstance(part, ast.FunctionDef):
                yield part.name
            for target in getattr(part, "targets", ()):
                if isinstance(target, ast.Name):
                    yield target.id


def _names() -> Iterator[str]:
    """Yield names, those first that cost nothing."""
    yield from _IN_ROM
    for length in (1, 2):
        for letters in itertools.product(string.ascii_letters, repeat=length):
            yield "".join(letters)
