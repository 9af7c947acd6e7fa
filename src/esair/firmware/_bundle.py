"""Many modules as one text, with only what is used: for boards that hold little."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Mapping

import attrs

from esair.exceptions import ConfigError

_BINDING = (
    *(ast.FunctionDef, ast.ClassDef, ast.Import, ast.ImportFrom, ast.Assign),
    *(ast.AnnAssign, ast.If, ast.Try),
)

MAIN = "main.py"
"""The start of the program, in the place of a module."""

_LOOP = "_Runner"
"""The class of MIN that is too long to be compiled at once."""

_LONG = 450
"""Characters, before it is made small, of a method that wants to be compiled early."""

_BASES = frozenset({"Sensor", "Actuator", "Reaction"})
_BROUGHT = frozenset({"super", "rate", "limits", "clamp", "command_timeout"})
"""What code may use of its base in MIN."""


@attrs.frozen
class Chunk:
    """Statements that stay together.

    Attributes:
        module: Where they come from.
        name: What they define, if it has a name.
        nodes: They.
    """

    module: str
    name: str
    nodes: tuple[ast.stmt, ...]


@attrs.define
class _Unit:
    """A statement at the top of a module, which is taken whole or not at all."""

    module: str
    node: ast.stmt
    bound: frozenset[str]
    needed: bool


def bundle(sources: Mapping[str, str], main: str) -> list[Chunk]:
    """Join modules to one, in which what is used comes before what uses it.

    Methods and names that nobody mentions are left out. What is long comes early, where
    that is possible: it is compiled while there is much memory.

    Args:
        sources: The text of each module, by its dotted name.
        main: The text that starts it all; it is kept whole.

    Raises:
        ConfigError: Two modules define the same name, or an import renames.
    """
    units: list[_Unit] = []
    for name, text in {**sources, MAIN: main}.items():
        tree = _InOneNamespace(name, sources).visit(ast.parse(text))
        units += _units_of(name, tree, keep=name == MAIN)
    _drop_bases(units)
    used = _take_what_is_used(units)
    kept = [unit for unit in units if unit.needed]
    _refuse_two_of_a_name(kept)
    for unit in kept:
        if isinstance(unit.node, ast.ClassDef):
            unit.node.body = [
                each for each in unit.node.body if _is_used(each, used)
            ] or [ast.Pass()]
    return _long_ones_first(_in_order(kept))


def identifiers(node: ast.AST) -> Iterator[str]:
    """Yield every name that a piece of code mentions, as a text too."""
    for each in ast.walk(node):
        if isinstance(each, ast.Name):
            yield each.id
        elif isinstance(each, ast.Attribute):
            yield each.attr
        elif isinstance(each, ast.Constant) and isinstance(each.value, str):
            yield each.value


def bound_by(node: ast.stmt) -> frozenset[str]:
    """Return the names that a statement at the top of a module makes."""
    names = set()
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return frozenset({node.name})
    for each in ast.walk(node):
        if isinstance(each, ast.FunctionDef | ast.ClassDef):
            names.add(each.name)
        elif isinstance(each, ast.alias):
            names.add(each.asname or each.name.partition(".")[0])
        elif isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
            names.add(each.id)
    return frozenset(names)


def _units_of(module: str, tree: ast.Module, *, keep: bool) -> Iterator[_Unit]:
    for node in tree.body:
        bound = bound_by(node) if isinstance(node, _BINDING) else frozenset()
        yield _Unit(module, node, bound, keep or not bound)


def _take_what_is_used(units: list[_Unit]) -> set[str]:
    """Mark the units that are needed; return all names that they mention."""
    used: set[str] = set()
    before = -1
    while before != len(used):
        before = len(used)
        for unit in units:
            unit.needed = unit.needed or bool(unit.bound & used)
            if not unit.needed:
                continue
            if isinstance(unit.node, ast.ClassDef):
                for part in (*unit.node.bases, *unit.node.body):
                    if _is_used(part, used):
                        used.update(identifiers(part))
            else:
                used.update(identifiers(unit.node))
    return used


def _drop_bases(units: list[_Unit]) -> None:
    """Drop the bases of MIN, if nobody uses what they bring: the wiring is done."""
    classes = [
        unit.node
        for unit in units
        if unit.module != "esair.minimal" and isinstance(unit.node, ast.ClassDef)
    ]
    code: list[ast.AST] = [part for node in classes for part in node.body]
    code += [
        unit.node
        for unit in units
        if unit.module != "esair.minimal" and unit.node not in classes
    ]
    if (_BASES | _BROUGHT) & set(_loaded(code)):
        return
    for node in classes:
        node.bases = [each for each in node.bases if ast.unparse(each) not in _BASES]


def _loaded(code: Iterable[ast.AST]) -> Iterator[str]:
    for node in code:
        for each in ast.walk(node):
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load):
                yield each.id
            elif isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Load):
                yield each.attr


def _is_declaration(part: ast.AST) -> bool:
    """Tell whether it is ``x = reads(...)`` in a class: that is wired already."""
    return (
        isinstance(part, ast.Assign)
        and isinstance(part.value, ast.Call)
        and ast.unparse(part.value.func) in {"reads", "writes"}
    )


def _is_used(part: ast.AST, used: set[str]) -> bool:
    """Tell whether something in a class stays: all but methods that nobody mentions."""
    if isinstance(part, ast.FunctionDef):
        return part.name.startswith("__") or (
            part.name in used
            and ast.unparse(part.body[0]) != "raise NotImplementedError"
        )
    return not _is_declaration(part)


def _refuse_two_of_a_name(units: Iterable[_Unit]) -> None:
    owners: dict[str, _Unit] = {}
    for unit in units:
        for name in unit.bound:
            other = owners.setdefault(name, unit)
            if other.module != unit.module and ast.dump(other.node) != ast.dump(
                unit.node
            ):
                raise ConfigError(
                    unit.module,
                    name,
                    f"{other.module} has a {name!r} too; a micro:bit has room for one "
                    "namespace only: rename one of them",
                )


def _in_order(units: list[_Unit]) -> list[_Unit]:
    """Put what is used before what uses it; the start is at the end, as it is."""
    makers: dict[str, list[_Unit]] = {}
    for unit in units:
        for name in unit.bound if unit.module != MAIN else ():
            makers.setdefault(name, []).append(unit)
    placed: list[_Unit] = []
    seen: set[str] = set()

    def place(unit: _Unit) -> None:
        text = ast.dump(unit.node)  # the same import of two modules is made once
        if text in seen and unit.module != MAIN:
            return
        seen.add(text)
        for each in ast.walk(unit.node):
            if isinstance(each, ast.Name):
                for maker in makers.get(each.id, ()):
                    place(maker)
        placed.append(unit)

    for unit in units:
        place(unit)
    return placed


def _long_ones_first(units: list[_Unit]) -> list[Chunk]:
    """Reorder what may be: functions, and the methods of the loop.

    Functions need nothing before they are called; the methods of the loop neither, and
    it is called at the very end.
    """
    early: list[Chunk] = []
    rest: list[Chunk] = []
    late: list[Chunk] = []
    for module, node in ((unit.module, unit.node) for unit in units):
        if isinstance(node, ast.ClassDef) and node.name == _LOOP:
            methods = list(_taken_apart(module, node))
            early.append(Chunk(module, node.name, (node,)))
            early += [each for each in methods if _length(each) > _LONG]
            late += [each for each in methods if _length(each) <= _LONG]
        elif isinstance(node, ast.FunctionDef):
            early.append(Chunk(module, node.name, (node,)))
        else:
            rest.append(Chunk(module, getattr(node, "name", ""), (node,)))
    early.sort(key=lambda each: (each.name != _LOOP, -_length(each)))
    late.sort(key=_length, reverse=True)
    return [*early, *rest[:-1], *late, rest[-1]]


def _taken_apart(module: str, node: ast.ClassDef) -> Iterator[Chunk]:
    """Yield the methods of a class, each of which is put into it from outside."""
    methods = [each for each in node.body if isinstance(each, ast.FunctionDef)]
    node.body = [ast.Pass()]
    for method in methods:
        name = f"{node.name}.{method.name}"
        method.name = "_"
        yield Chunk(module, name, (method, *ast.parse(f"{name} = _").body))


def _length(chunk: Chunk) -> int:
    return sum(len(ast.unparse(node)) for node in chunk.nodes)


class _InOneNamespace(ast.NodeTransformer):
    """Takes out the imports between the modules that are joined."""

    def __init__(self, module: str, sources: Mapping[str, str]) -> None:
        self._module = module
        self._sources = sources
        self._modules: set[str] = set()
        """Names that stand for a module that is joined."""

    def visit_Import(self, node: ast.Import) -> ast.stmt | None:
        node.names = [
            alias for alias in node.names if not self._is_joined(alias, alias.name)
        ]
        return node if node.names else None

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.stmt | None:
        if node.module == "__future__":
            return None
        target = node.module or ""
        if node.level:
            base = self._module.split(".")[: -node.level]
            target = ".".join([*base, *([target] if target else [])])
        if not self._is_ours(target):
            return node
        for alias in node.names:
            if self._is_joined(alias, f"{target}.{alias.name}"):
                continue
            if alias.asname not in {None, alias.name}:
                raise ConfigError(
                    self._module,
                    alias.asname or "",
                    f"a micro:bit has room for one namespace only: call it {alias.name}",
                )
        return None

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        self.generic_visit(node)
        if ast.unparse(node.value) in self._modules:
            return ast.Name(node.attr, node.ctx)
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.stmt:
        if node.value is None:
            return ast.Pass()
        return ast.Assign([node.target], node.value, lineno=node.lineno)

    def visit_If(self, node: ast.If) -> ast.AST | None:
        if "TYPE_CHECKING" in ast.unparse(node.test):
            return None
        return self.generic_visit(node)

    def _is_joined(self, alias: ast.alias, module: str) -> bool:
        if module in self._sources or module == "esair":
            self._modules.add(alias.asname or alias.name)
            return True
        return False

    def _is_ours(self, target: str) -> bool:
        return target in self._sources or any(
            each.startswith(f"{target}.") for each in self._sources
        )
