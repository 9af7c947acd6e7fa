"""Statements of Python as statements of C; a loop has a bound that is known."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from typing import Any, Final

from esair.firmware.c._expressions import Expressions
from esair.firmware.c._scope import Scope, Value, convert
from esair.firmware.c._types import INT, NONE, RefusedError, Type

_INSTEAD: Final = {
    ast.While: "a while loop has no bound: write `for _ in range(100):` with a break",
    ast.Try: "C has no exceptions: ask before, as `if b != 0`",
    ast.Global: "reactions share no names: keep it on self",
    ast.Nonlocal: "reactions share no names: keep it on self",
    ast.FunctionDef: "a function in a function: make it a method",
    ast.Import: "an import in a function: put it at the head of the file",
    ast.ImportFrom: "an import in a function: put it at the head of the file",
    ast.Delete: "del: write another value",
}


class Statements:
    """Translates the statements of one function.

    Args:
        scope: What they can see, and where they are written.
        command: What the actuator takes, if what the function returns is a command.
    """

    def __init__(self, scope: Scope, command: Type | None) -> None:
        self.scope, self._command = scope, command
        self.expressions = Expressions(scope)
        self._nodes: Sequence[ast.stmt] = ()
        self.errors: list[RefusedError] = []
        """What was refused; the rest is translated nevertheless, for its types."""
        self._by_node: dict[type[ast.stmt], Callable[[Any], bool]] = {
            ast.Expr: self._expression,
            ast.Assign: self._assign,
            ast.AnnAssign: self._annotated,
            ast.AugAssign: self._augmented,
            ast.If: self._if,
            ast.For: self._for,
            ast.Return: self._return,
            ast.Assert: self._assert,
            ast.Raise: lambda _: self._leave("es_fail();"),
            ast.Pass: lambda _: True,
            ast.Break: lambda _: self._leave("break;"),
            ast.Continue: lambda _: self._leave("continue;"),
        }

    def whole(self, node: ast.FunctionDef) -> None:
        """Translate a function."""
        self._nodes = node.body
        if self.block(node.body):
            end = ast.Return(None, lineno=node.end_lineno or 1)
            self.block([end])

    def block(self, nodes: Sequence[ast.stmt]) -> bool:
        """Translate statements; tell whether what is after them is ever reached."""
        for node in nodes:
            try:
                with self.scope.at(node):
                    if type(node) not in self._by_node:
                        what = f"{ast.unparse(node):.40}: C has nothing like it"
                        raise RefusedError(_INSTEAD.get(type(node), what))
                    if not self._by_node[type(node)](node):
                        return False
            except RefusedError as error:
                self.errors.append(error)
        return True

    def _expression(self, node: ast.Expr) -> bool:
        if not isinstance(node.value, ast.Constant):
            value = self.expressions.of(node.value)
            if not value.simple:
                self.scope.say(f"(void)({value.text});")
        return True

    def _assign(self, node: ast.Assign) -> bool:
        value = self.expressions.of(node.value)
        if len(node.targets) > 1:
            value = self.expressions.kept(value)
        for target in node.targets:
            self._set(target, value)
        return True

    def _annotated(self, node: ast.AnnAssign) -> bool:
        if node.value is not None:
            self._set(node.target, self.expressions.of(node.value))
        return True

    def _augmented(self, node: ast.AugAssign) -> bool:
        before: ast.expr = node.target
        left, right = self.expressions.operands([before, node.value])
        self._set(node.target, self.expressions.binary(node.op, left, right))
        return True

    def _set(self, target: ast.expr, value: Value) -> None:
        if isinstance(target, ast.Name):
            self.scope.set_local(target.id, value)
        elif isinstance(target, ast.Attribute) and self.scope.is_self(target.value):
            self.scope.set_attribute(target.attr, value)
        elif isinstance(target, ast.Tuple):
            if len(value.type.fields) != len(target.elts):
                raise RefusedError(
                    f"{value.type.said} for {len(target.elts)} names: take its fields"
                )
            value = self.expressions.kept(value)
            for number, each in enumerate(target.elts):
                self._set(each, self.expressions.item(value, number))
        else:
            raise RefusedError(
                f"{ast.unparse(target):.40} = ...: values do not change, only names and "
                "attributes of self get others"
            )

    def _inside(
        self, nodes: Sequence[ast.stmt], sure: str = ""
    ) -> tuple[list[str], set[str] | None]:
        """Translate a block; return its lines, and what has a value after it, if ever."""
        before, was_sure = self.scope.defined, self.scope.sure
        self.scope.defined = set(before)
        if sure and not _changes(nodes, sure):
            self.scope.sure = was_sure | {sure}
        with self.scope.aside() as lines:
            goes_on = self.block(nodes)
        self.scope.sure = was_sure
        after, self.scope.defined = self.scope.defined, before
        return lines, after if goes_on else None

    def _if(self, node: ast.If) -> bool:
        try:
            test = self.expressions.condition(node.test)
        except RefusedError as error:
            self.errors.append(error)
            test = "false"
        name, there = _asked(node.test)
        yes, after_yes = self._inside(node.body, name * there)
        no, after_no = self._inside(node.orelse, name * (not there))
        if after_yes is None and name and not there and not _changes(self._nodes, name):
            self.scope.sure = self.scope.sure | {name}
        self.scope.block(f"if ({test})", yes, no)
        if after_yes is None and after_no is None:
            return False
        ends = [each for each in (after_yes, after_no) if each is not None]
        self.scope.defined = set.intersection(*ends)
        return True

    def _for(self, node: ast.For) -> bool:
        if node.orelse:
            raise RefusedError("else of a loop: keep in a name whether it broke")
        count = self.scope.new_name()
        size, items = self._items(node.iter, count, node.body)
        self.scope.defined, before = set(self.scope.defined), self.scope.defined
        with self.scope.aside() as head:
            self._set(node.target, items)
        lines, _ = self._inside(node.body)
        self.scope.defined = before
        self.scope.block(
            f"for (int32_t {count} = 0; {count} < {size}; {count}++)", [*head, *lines]
        )
        return True

    def _items(
        self, node: ast.expr, count: str, body: Sequence[ast.stmt]
    ) -> tuple[int, Value]:
        """Return how many items a loop has, and that of its counter."""
        if isinstance(node, ast.Call) and not node.keywords:
            target = self.scope.thing(node.func)
            if target is range:
                known = [each.known for each in self.expressions.operands(node.args)]
                if not 1 <= len(known) <= 3 or {*map(type, known)} != {int}:
                    raise RefusedError(
                        "a range whose end is not known has no bound: write `for i in range(100):` "
                        "with `if i >= end: break`"
                    )
                if known[2:] == [0]:
                    raise RefusedError("a range of step 0: give it another step")
                numbers = range(*known)
                for each in (*numbers[:1], *numbers[-1:], len(numbers) * numbers.step):
                    self.scope.constant(each)
                text = f"({numbers.start} + {count} * {numbers.step})"
                return len(numbers), Value(INT, text)
            if target is enumerate and len(node.args) == 1:
                size, item = self._items(node.args[0], count, body)
                kind = self.scope.types.tuple_of(
                    (INT, item.type), ("number", "item"), None
                )
                return size, Value(kind, f"(({kind.c}){{{count}, {item.text}}})")
        value = self.expressions.of(node)
        row = value.type.row
        if row is None:
            raise RefusedError(
                f"a loop over {value.type.said}: only over a range or a row of equal types"
            )
        names = (each.id for each in ast.walk(node) if isinstance(each, ast.Name))
        if any(_changes(body, name) for name in names):  # it goes on over what it was
            value = Value(value.type, value.text)
        value = self.expressions.kept(value)
        return len(value.type.fields), Value(row, f"{value.text}.v[{count}]")

    def _return(self, node: ast.Return) -> bool:
        value = self.scope.constant(None)
        if node.value is not None:
            value = self.expressions.of(node.value)
        function = self.scope.function
        if self._command is not None:
            value = self._as_command(value, self._command)
        results = {} if function.result is None else {"": function.result}
        kind = self.scope.memory.learn(results, "", value.type, "what is returned")
        self.scope.memory.changed |= kind is not function.result
        function.result = kind
        if kind is NONE and not value.simple:
            self.scope.say(f"(void)({value.text});")
        text = "" if kind is NONE else f" {convert(value, kind)}"
        return self._leave(f"return{text};")

    def _as_command(self, value: Value, kind: Type) -> Value:
        inner = value.type.of or value.type
        if inner.fields and any(each.of for each in inner.fields):
            return value  # commands for several
        return self.expressions.as_command(value, kind)

    def _assert(self, node: ast.Assert) -> bool:
        test = self.expressions.condition(node.test)
        self.scope.block(f"if (!{test})", ["es_fail();"])
        return True

    def _leave(self, line: str) -> bool:
        self.scope.say(line)
        return False


def _asked(test: ast.expr) -> tuple[str, bool]:
    """Return the name that is asked for None, and whether it is there if that is true."""
    if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And):
        found = [_asked(each) for each in test.values]
        return next((each for each in found if each[1]), ("", False))
    if isinstance(test, ast.Compare) and isinstance(test.left, ast.Name):
        asked = [*map(ast.unparse, test.comparators)] == ["None"]
        if asked and isinstance(test.ops[0], ast.Is | ast.IsNot):
            return test.left.id, isinstance(test.ops[0], ast.IsNot)
    return "", False


def _changes(nodes: Sequence[ast.stmt], name: str) -> bool:
    """Whether a name gets a value somewhere in statements."""
    each = (node for statement in nodes for node in ast.walk(statement))
    return any(
        isinstance(n, ast.Name) and n.id == name and isinstance(n.ctx, ast.Store)
        for n in each
    )
