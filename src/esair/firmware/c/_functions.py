"""The functions of one reaction in C: its ``react``, and what that calls.

Each loop has a bound that is known.
"""

from __future__ import annotations

import ast
import functools
import inspect
import linecache
import re
import textwrap
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

from esair.firmware.c._expressions import Expressions
from esair.firmware.c._scope import (
    INT,
    NONE,
    Function,
    Memory,
    RefusedError,
    Type,
    Types,
    Value,
    convert,
    in_c,
)

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


class Statements(Expressions):
    def whole(self, node: ast.FunctionDef) -> None:
        self._nodes = node.body
        if self.run(node.body):
            end = ast.Return(None, lineno=node.end_lineno or 1)
            self.run([end])

    def run(self, nodes: Sequence[ast.stmt]) -> bool:
        """Translate statements; tell whether what is after them is ever reached."""
        for node in nodes:
            try:
                with self.at(node):
                    if type(node) not in self._by_statement:
                        what = f"{ast.unparse(node):.40}: C has nothing like it"
                        raise RefusedError(_INSTEAD.get(type(node), what))
                    if not self._by_statement[type(node)](self, node):
                        return False
            except RefusedError as error:
                self.errors.append(error)
            except RecursionError:
                told = "it is too deep for a translation: write it in several lines"
                line = node.lineno + self._before
                self.errors.append(RefusedError(told, line, self._file))
        return True

    def _expression(self, node: ast.Expr) -> bool:
        if not isinstance(node.value, ast.Constant):
            value = self.of(node.value)
            if not value.simple:
                self.say(f"(void)({value.text});")
        return True

    def _assign(self, node: ast.Assign) -> bool:
        value = self.of(node.value)
        if len(node.targets) > 1:
            value = self.kept(value)
        for target in node.targets:
            self._give(target, value)
        return True

    def _annotated(self, node: ast.AnnAssign) -> bool:
        if node.value is not None:
            self._give(node.target, self.of(node.value))
        return True

    def _augmented(self, node: ast.AugAssign) -> bool:
        before: ast.expr = node.target
        left, right = self.operands([before, node.value])
        self._give(node.target, self.binary(node.op, left, right))
        return True

    def _give(self, target: ast.expr, value: Value) -> None:
        if isinstance(target, ast.Name):
            self.set_local(target.id, value)
        elif isinstance(target, ast.Attribute) and self.is_self(target.value):
            self.set_attribute(target.attr, value)
        elif isinstance(target, ast.Tuple):
            if len(value.type.fields) != len(target.elts):
                raise RefusedError(
                    f"{value.type.said} for {len(target.elts)} names: take its fields"
                )
            value = self.kept(value)
            for number, each in enumerate(target.elts):
                self._give(each, self.item(value, number))
        else:
            raise RefusedError(
                f"{ast.unparse(target):.40} = ...: values do not change, only names and "
                "attributes of self get others"
            )

    def _inside(
        self, nodes: Sequence[ast.stmt], sure: str = ""
    ) -> tuple[list[str], set[str] | None]:
        """Translate a block; return its lines, and what has a value after it, if ever."""
        before, was_sure = self.defined, self.sure
        self.defined = set(before)
        if sure and not _changes(nodes, sure):
            self.sure = was_sure | {sure}
        with self.aside() as lines:
            goes_on = self.run(nodes)
        self.sure = was_sure
        after, self.defined = self.defined, before
        return lines, after if goes_on else None

    def _branch(self, node: ast.If) -> bool:
        try:
            test = self.condition(node.test)
        except RefusedError as error:
            self.errors.append(error)
            test = "false"
        name, there = _asked(node.test)
        yes, after_yes = self._inside(node.body, name * there)
        no, after_no = self._inside(node.orelse, name * (not there))
        if after_yes is None and name and not there and not _changes(self._nodes, name):
            self.sure = self.sure | {name}
        self.block(f"if ({test})", yes, no)
        if after_yes is None and after_no is None:
            return False
        ends = [each for each in (after_yes, after_no) if each is not None]
        self.defined = set.intersection(*ends)
        return True

    def _for(self, node: ast.For) -> bool:
        if node.orelse:
            raise RefusedError("else of a loop: keep in a name whether it broke")
        count = self.new_name()
        size, items = self._items(node.iter, count, node.body)
        self.defined, before = set(self.defined), self.defined
        with self.aside() as head:
            self._give(node.target, items)
        lines, _ = self._inside(node.body)
        self.defined = before
        self.block(
            f"for (int32_t {count} = 0; {count} < {size}; {count}++)", [*head, *lines]
        )
        return True

    def _items(
        self, node: ast.expr, count: str, body: Sequence[ast.stmt]
    ) -> tuple[int, Value]:
        """Return how many items a loop has, and that of its counter."""
        if isinstance(node, ast.Call) and not node.keywords:
            target = self.thing(node.func)
            if target is range:
                known = [each.known for each in self.operands(node.args)]
                if not 1 <= len(known) <= 3 or {*map(type, known)} != {int}:
                    raise RefusedError(
                        "a range whose end is not known has no bound: write `for i in range(100):` "
                        "with `if i >= end: break`"
                    )
                if known[2:] == [0]:
                    raise RefusedError("a range of step 0: give it another step")
                numbers = range(*known)
                for each in (*numbers[:1], *numbers[-1:], len(numbers) * numbers.step):
                    self.constant(each)
                text = f"({numbers.start} + {count} * {numbers.step})"
                return len(numbers), Value(INT, text)
            if target is enumerate and len(node.args) == 1:
                size, item = self._items(node.args[0], count, body)
                kind = self.types.tuple_of((INT, item.type), ("number", "item"), None)
                return size, Value(kind, f"(({kind.c}){{{count}, {item.text}}})")
        value = self.of(node)
        row = value.type.row
        if row is None:
            raise RefusedError(
                f"a loop over {value.type.said}: only over a range or a row of equal types"
            )
        names = (each.id for each in ast.walk(node) if isinstance(each, ast.Name))
        if any(_changes(body, name) for name in names):  # it goes on over what it was
            value = Value(value.type, value.text)
        value = self.kept(value)
        return len(value.type.fields), Value(row, f"{value.text}.v[{count}]")

    def _return(self, node: ast.Return) -> bool:
        value = self.constant(None)
        if node.value is not None:
            value = self.of(node.value)
        function = self.function
        if self._command is not None:
            value = self._as_command(value, self._command)
        results = {} if function.result is None else {"": function.result}
        kind = self.memory.learn(results, "", value.type, "what is returned")
        self.memory.changed |= kind is not function.result
        function.result = kind
        if kind is NONE and not value.simple:
            self.say(f"(void)({value.text});")
        text = "" if kind is NONE else f" {convert(value, kind)}"
        return self._leave(f"return{text};")

    def _as_command(self, value: Value, kind: Type) -> Value:
        inner = value.type.of or value.type
        if inner.fields and any(each.of for each in inner.fields):
            return value  # commands for several
        return self.as_command(value, kind)

    def _assert(self, node: ast.Assert) -> bool:
        test = self.condition(node.test)
        self.block(f"if (!{test})", ["es_fail();"])
        return True

    def _leave(self, line: str) -> bool:
        self.say(line)
        return False

    _by_statement: ClassVar[dict[type[ast.stmt], Callable[[Any, Any], bool]]] = {
        ast.Expr: _expression,
        ast.Assign: _assign,
        ast.AnnAssign: _annotated,
        ast.AugAssign: _augmented,
        ast.If: _branch,
        ast.For: _for,
        ast.Return: _return,
        ast.Assert: _assert,
        ast.Raise: lambda self, _: self._leave("es_fail();"),
        ast.Pass: lambda self, _: True,
        ast.Break: lambda self, _: self._leave("break;"),
        ast.Continue: lambda self, _: self._leave("continue;"),
    }


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
    each = (node for statement in nodes for node in ast.walk(statement))
    return any(
        isinstance(n, ast.Name) and n.id == name and isinstance(n.ctx, ast.Store)
        for n in each
    )


class Functions:
    """Translates what a reaction calls, once for each list of types of arguments."""

    def __init__(
        self,
        reaction: Any,
        types: Types,
        constants: dict[str, str],
        ports: Mapping[str, Type],
    ) -> None:
        self.memory = Memory(
            reaction, in_c(reaction.name), types, constants, self._call, ports
        )
        self._known: dict[Any, Function] = {}
        self._done: list[Function] = []
        self._busy: list[Function] = []
        self._errors: list[RefusedError] = []

    def translate(
        self, roots: Sequence[tuple[Any, Mapping[str, Value]]]
    ) -> list[Function]:
        """Translate methods, with all that they call; what they return are commands.

        Raises:
            RefusedError: Something cannot be translated.
        """
        while True:
            self.memory.changed = False
            self._done, self._errors, found = [], [], []
            for method, readings in roots:
                try:
                    found.append(self._call(method, readings, root=True))
                except RefusedError as error:
                    self._errors.append(error)
            if not self.memory.changed:
                break
        if self._errors:
            raise self._errors[0]  # the others may come from it
        return found

    def _call(
        self, target: Any, args: Mapping[str, Value], *, root: bool = False
    ) -> Function:
        """Return a function for the types of arguments, translated in this round."""
        python = getattr(target, "__func__", target)
        mine = self.memory.reaction
        if getattr(target, "__self__", mine) is not mine:
            raise RefusedError(
                f"{python.__name__} is a method of a class: write a plain one"
            )
        kinds = {name: value.type for name, value in args.items()}
        key = (python, tuple(kinds.items()))
        if key not in self._known:
            self._known[key] = Function(python, self._name(python), kinds, dict(kinds))
        function = self._known[key]
        if any(function.python is each.python for each in self._busy):
            raise RefusedError(f"{python.__name__} calls itself: write a for loop")
        if function not in self._done:
            self._busy.append(function)
            try:
                self._write(function, isinstance(target, types.MethodType), root)
            finally:
                self._busy.pop()
            self._done.append(function)
        return function

    def _name(self, python: types.FunctionType) -> str:
        wanted = name = f"f_{self.memory.c}_{in_c(python.__name__)}"
        number = 1
        while name in self.memory.types.names:
            number += 1
            name = f"{wanted}_{number}"
        self.memory.types.names.add(name)
        return name

    def _write(self, function: Function, is_method: bool, root: bool) -> None:
        node, file, before = definition(function.python)
        function.impure = function.timed = False
        function.lent = {
            name
            for name, kind in function.kinds.items()
            if kind.is_large and not _changes(node.body, name)
        }
        parameters = inspect.signature(function.python, follow_wrapped=False).parameters
        ports = [*self.memory.ports.values()]
        scope = Statements(
            self.memory,
            function,
            next(iter(parameters)) if is_method else "",
            (file, before),
            ports[0] if root and len(ports) == 1 else None,
        )
        scope.whole(node)
        self._errors += scope.errors
        result = function.result or NONE
        given = [
            f"const {t.c} *v_{in_c(n)}" if n in function.lent else f"{t.c} v_{in_c(n)}"
            for n, t in function.kinds.items()
            if t is not NONE
        ]
        head = f"static {result.c} {function.c}({', '.join(given) or 'void'})"
        own = {n: t for n, t in function.locals.items() if t is not NONE}
        for name, kind in function.kinds.items():
            if kind is not own.get(name, NONE) and kind is not NONE:
                told = f"{name} may become None: give that another name"
                self._errors.append(RefusedError(told, node.lineno + before, file))
        body = [
            f"{t.c} v_{in_c(n)} = {zero(t)};"
            for n, t in own.items()
            if function.kinds.get(n, NONE) is NONE
        ]
        body += [f"(void)v_{in_c(n)};" for n in own]
        text = "\n".join(scope.lines)
        body += [
            re.sub(rf"(const )?\w+ {m[1]} = (.*);$", r"(void)(\2);", line)
            if (m := re.match(r" *const \w+ (t\d+) = ", line))
            and len(re.findall(rf"\b{m[1]}\b", text)) == 1
            else line
            for line in scope.lines
        ]
        if result is not NONE and not scope.lines[-1].startswith("return"):
            body.append(f"return {zero(result)};")
        function.lines = [head, "{", *(f"    {each}" for each in body), "}", ""]

    def lines(self) -> list[str]:
        """Return the state of the reaction and its functions, as C."""
        found = []
        state = {n: t for n, t in self.memory.state.items() if t is not NONE}
        if state:
            first = [
                self.memory.types.braces(self.memory.first(name), kind)
                for name, kind in state.items()
            ]
            fields = " ".join(
                f"{kind.c} a_{in_c(name)};" for name, kind in state.items()
            )
            found = [
                f"static struct {{ {fields} }} self_{self.memory.c} = {{{', '.join(first)}}};",
                "",
            ]
        return found + [line for function in self._done for line in function.lines]


def zero(kind: Type) -> str:
    """Write a value of a type that is never looked at."""
    return f"({kind.c}){{0}}" if kind.of or kind.fields else "0"


@functools.cache
def _text(file: str) -> str:
    return "".join(linecache.getlines(file))


def definition(python: types.FunctionType) -> tuple[ast.FunctionDef, str, int]:
    """Return a function as its source has it, its file, and the lines before it.

    Raises:
        RefusedError: It has no source, or is none of plain Python.
    """
    try:
        lines, first = inspect.getsourcelines(python.__code__)
        tree = ast.parse(textwrap.dedent("".join(lines)))
    except (OSError, TypeError, SyntaxError) as error:
        raise RefusedError(
            f"{python!r:.60} has no source in a file: write it with def"
        ) from error
    node = tree.body[0]
    file = inspect.getsourcefile(python) or "?"
    if not isinstance(node, ast.FunctionDef) or inspect.isgeneratorfunction(python):
        raise RefusedError(
            "it is no plain function: write it with def", first, Path(file).name
        )
    if [each for each in node.decorator_list if ast.unparse(each) != "staticmethod"]:
        raise RefusedError(
            "a decorator: write what it does into the function", first, Path(file).name
        )
    for name in python.__code__.co_names:
        if re.search(rf"^\s*global\b.*\b{name}\b", _text(file), re.MULTILINE):
            raise RefusedError(
                f"{name} is changed by `global`: keep it on self",
                first,
                Path(file).name,
            )
    return node, Path(file).name, first - 1
