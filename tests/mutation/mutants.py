"""Small mistakes that could be in a file, made one at a time in its syntax tree.

What changes nothing is left out: whether the edge belongs to it where a tolerance is
added to a moment, or where something is cut to a limit.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs

COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
REMOVED = (
    ast.Expr,
    ast.Assign,
    ast.AugAssign,
    ast.Delete,
    ast.Raise,
    ast.Continue,
    ast.Break,
)
NOT_LOOKED_AT = {"annotation", "returns", "decorator_list", "bases", "keywords"}
"""Fields of functions, classes and assignments that say what things are."""
TOLERANCES = {"_EARLY", "AHEAD", "EARLY", "GRACE", "REACHED"}
NOT_CALLED = {"__repr__", "__str__"}


@attrs.define(eq=False)
class Mutant:
    """One mistake: in *place[key]* stands *wrong* instead of *right*."""

    file: Path
    tree: ast.Module
    right: ast.AST
    wrong: ast.AST
    place: Any
    key: Any
    scope: tuple[int, int] | None
    """First and last line of the innermost function; None outside of all."""

    @property
    def line(self) -> int:
        return int(getattr(self.right, "lineno", 0))

    def __str__(self) -> str:
        right, wrong = (
            " ".join(ast.unparse(each).split())[:70]
            for each in (self.right, self.wrong)
        )
        return f"{right}  ->  {wrong}"

    def compile(self) -> Any:
        """The code of the file with the mistake in it."""
        if isinstance(self.place, list):
            self.place[self.key] = self.wrong
        else:
            setattr(self.place, self.key, self.wrong)
        return compile(ast.fix_missing_locations(self.tree), str(self.file), "exec")


def mutants_of(file: Path) -> list[Mutant]:
    """Every mistake that is tried in a file."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [
        Mutant(file, tree, right, ast.copy_location(wrong, right), place, key, scope)
        for right, place, key, scope in _walk(tree, None)
        for wrong in _mistakes(right)
    ]


def _walk(node: ast.AST, scope: tuple[int, int] | None) -> Iterator[tuple[Any, ...]]:
    """Every node below, where it stands, and the function around it."""
    making = isinstance(node, ast.FunctionDef) and node.name == "__init__"
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
        scope = (node.lineno, node.end_lineno or node.lineno)
    for name, value in ast.iter_fields(node):
        if name in NOT_LOOKED_AT and not isinstance(node, ast.Call):
            continue
        for key, child in (
            enumerate(value) if isinstance(value, list) else [(name, value)]
        ):
            if name == "test" and _cuts(node):
                continue
            if isinstance(child, ast.AST) and not _says_something(child):
                if not (making and isinstance(child, ast.Assign)):  # nobody misses that
                    yield child, value if isinstance(value, list) else node, key, scope
                if not isinstance(child, ast.Raise):
                    yield from _walk(child, scope)


def _says_something(node: ast.AST) -> bool:
    """Whether it is for people or for type checkers: docstrings, the log."""
    match node:
        case ast.Expr(value=ast.Constant()) | ast.JoinedStr():
            return True
        case ast.Call(func=ast.Attribute(value=ast.Name(id="_log"))):
            return True
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=ast.Name(id="_log")))):
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.FunctionDef(name=name) if name in NOT_CALLED:
            return True
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            return any(
                getattr(it, "id", "") == "overload" for it in node.decorator_list
            )
        case ast.keyword(arg="init" | "kw_only"):  # nobody calls it in the other way
            return True
        case ast.Import() | ast.ImportFrom() | ast.Assert():
            return True
        case ast.Assign(targets=[ast.Name(id=name)]):
            return name in {"__all__", "_log"} or name.startswith("T_")
    return False


def _cuts(node: ast.AST) -> bool:
    """Whether it is ``if a > b: a = b``: equal, they may be exchanged or not."""
    match node:
        case ast.If(
            test=ast.Compare(left=value, comparators=[limit]),
            body=[ast.Assign(targets=[target], value=new)],
        ):
            told = [ast.unparse(each) for each in (value, limit)]
            return told == [ast.unparse(target), ast.unparse(new)]
    return False


def _mistakes(node: ast.AST) -> Iterator[ast.AST]:
    if any(
        getattr(each, "id", "") in TOLERANCES for each in ast.iter_child_nodes(node)
    ):
        return
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        if any(getattr(each, "id", "") in TOLERANCES for each in ast.walk(node)):
            return
        wrong = copy.copy(node)
        wrong.ops = [COMPARED[type(node.ops[0])]()]
        yield wrong
    elif isinstance(node, ast.BoolOp):
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield ast.BoolOp(other, node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node.operand
    elif isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Sub)):
        yield ast.BinOp(
            node.left,
            ast.Sub() if isinstance(node.op, ast.Add) else ast.Add(),
            node.right,
        )
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        yield ast.Constant(node.value + 1)
    elif isinstance(node, (ast.If, ast.While, ast.IfExp)) and not isinstance(
        node.test, (ast.Compare, ast.UnaryOp, ast.BoolOp, ast.Constant)
    ):
        wrong_test = copy.copy(node)
        wrong_test.test = ast.UnaryOp(ast.Not(), node.test)
        yield wrong_test
    elif isinstance(node, ast.Return) and not (
        node.value is None
        or (isinstance(node.value, ast.Constant) and not node.value.value)
    ):
        yield ast.Return(ast.Constant(None))
    elif isinstance(node, REMOVED) and not _is_local(node):
        yield ast.Pass()


def _is_local(node: ast.AST) -> bool:
    """Whether it only gives a name to a value: without it, nothing runs."""
    return isinstance(node, ast.Assign) and all(
        isinstance(target, (ast.Name, ast.Tuple)) for target in node.targets
    )
