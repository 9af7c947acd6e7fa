"""The functions of one reaction in C: its ``react``, and what that calls."""

from __future__ import annotations

import ast
import functools
import inspect
import linecache
import re
import textwrap
import types
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from esair.firmware.c._scope import Function, Memory, Scope, Value
from esair.firmware.c._statements import Statements
from esair.firmware.c._types import NONE, RefusedError, Type, Types, in_c


class Functions:
    """Translates what a reaction calls, once for each list of types of arguments.

    Args:
        reaction: It.
        types: The types of the robot.
        constants: The texts of constant tuples, and their names.
        ports: What the actuators of its ports take, in their order.
    """

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
        self._names: set[str] = set()
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
        while name in self._names:
            number += 1
            name = f"{wanted}_{number}"
        self._names.add(name)
        return name

    def _write(self, function: Function, is_method: bool, root: bool) -> None:
        node, file, before = definition(function.python)
        function.impure = function.timed = False
        parameters = inspect.signature(function.python, follow_wrapped=False).parameters
        scope = Scope(
            self.memory,
            function,
            next(iter(parameters)) if is_method else "",
            (file, before),
        )
        ports = [*self.memory.ports.values()]
        statements = Statements(scope, ports[0] if root and len(ports) == 1 else None)
        statements.whole(node)
        self._errors += statements.errors
        result = function.result or NONE
        given = [
            f"{t.c} v_{in_c(n)}" for n, t in function.kinds.items() if t is not NONE
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
