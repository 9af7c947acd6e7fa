"""What a line of a reaction can see: its names, its types, and the C that is written."""

from __future__ import annotations

import ast
import builtins
import contextlib
import inspect
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import attrs

from esair.firmware.c._types import INT, NONE, RefusedError, Type, Types, in_c
from esair.minimal import declared
from esair.resources import REFUSE

UNKNOWN: Final = object()
_MANY: Final = {inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD}


@attrs.frozen
class Value:
    """What an expression gives; its text changes nothing, and can raise a fault.

    Attributes:
        type: Its type.
        text: How C writes it.
        simple: Whether it can be written twice, and after other statements too.
        known: It, if it is a constant.
    """

    type: Type
    text: str
    simple: bool = False
    known: Any = UNKNOWN

    @property
    def is_known(self) -> bool:
        """Whether it is a constant."""
        return self.known is not UNKNOWN


@attrs.define
class Function:
    """A function of Python for arguments of given types.

    Attributes:
        python: It.
        c: What it is called in C.
        kinds: The types of its parameters.
        locals: The types of its names, as far as they are known.
        result: What it returns, as far as that is known.
        impure: Whether it changes ``self``.
        timed: Whether it asks for the time.
        lines: Its text.
    """

    python: Any
    c: str
    kinds: Mapping[str, Type]
    locals: dict[str, Type]
    result: Type | None = None
    impure: bool = False
    timed: bool = False
    lines: list[str] = attrs.Factory(list)

    def called(self, args: Mapping[str, Value]) -> str:
        """Write a call of it."""
        given = (each.text for each in args.values() if each.type is not NONE)
        return f"{self.c}({', '.join(given)})"


@attrs.define
class Memory:
    """What the functions of one reaction share.

    Attributes:
        reaction: It.
        c: What it is called in C.
        types: The types of the robot.
        constants: The texts of constant tuples, and their names.
        call: Translates a function for arguments.
        ports: What the actuators of its ports take.
        state: The types of the attributes that it changes.
        changed: Whether something was learned about types, so all is translated anew.
    """

    reaction: Any
    c: str
    types: Types
    constants: dict[str, str]
    call: Callable[[Any, Mapping[str, Value]], Function]
    ports: Mapping[str, Type]
    state: dict[str, Type] = attrs.Factory(dict)
    changed: bool = False

    def learn(self, known: dict[str, Type], name: str, kind: Type, what: str) -> Type:
        """Return the type of a name or attribute, with one more use of it."""
        before = known.get(name)
        known[name] = after = join(self.types, before or kind, kind, what)
        self.changed |= after is not before
        return after

    def constant(self, value: Any) -> Value:
        """Return a value that is known."""
        guards = any(hasattr(need, "latch") for _, need in declared(self.reaction))
        if value is REFUSE and guards:
            value = None
        kind = self.types.of_value(value)
        if kind is NONE:
            return Value(NONE, "", True, None)
        text = self.types.literal(value, kind)
        if kind.fields:
            text = self.constants.setdefault(
                f"static const {kind.c} @ = {self.types.braces(value, kind)};",
                f"es_k{len(self.constants)}",
            )
        return Value(kind, text, True, value)

    def bound(
        self, function: Any, args: Sequence[Any], named: Mapping[str, Any]
    ) -> dict[str, Value]:
        """Return the values of all parameters of a function, with their defaults."""
        try:
            signature = inspect.signature(function, follow_wrapped=False)
            bound = signature.bind(*args, **named)
        except (TypeError, ValueError) as error:
            raise RefusedError(f"it cannot be called so: {error}") from error
        if any(each.kind in _MANY for each in signature.parameters.values()):
            raise RefusedError("* or ** in its parameters: write each of them")
        bound.apply_defaults()
        return {
            name: each if isinstance(each, Value) else self.constant(each)
            for name, each in bound.arguments.items()
        }

    def first(self, name: str) -> Any:
        """Return what an attribute of the reaction is at the start."""
        if isinstance(
            inspect.getattr_static(type(self.reaction), name, None), property
        ):
            raise RefusedError(f"self.{name} is a property: call a method")
        if name in dict(declared(self.reaction)):
            raise RefusedError(
                f"self.{name} is a port: take the reading of react's parameter"
            )
        found = getattr(self.reaction, name, UNKNOWN)
        if found is UNKNOWN:
            raise RefusedError(
                f"self.{name} has no first value: give it one in the class"
            )
        return found


def join(known: Types, one: Type, other: Type, what: str) -> Type:
    """Return the type of what is the one or the other."""
    if one is other or one.of is other:
        return one
    if other.of is one:
        return other
    if NONE in {one, other}:
        return known.option(other if one is NONE else one)
    how = "write 0.0, not 0" if INT in {one, other} else "give each its own name"
    raise RefusedError(
        f"{what}: {one.said} at one place and {other.said} at another, and C has one type "
        f"for it: {how}"
    )


class Scope:
    """The names of one function, and the lines that are written for it.

    Args:
        memory: What it shares with the other functions of its reaction.
        function: It.
        myself: The name of its first parameter, if that is the reaction.
        place: The file that it is in, and how many lines are before it there.
    """

    def __init__(
        self, memory: Memory, function: Function, myself: str, place: tuple[str, int]
    ) -> None:
        self.memory, self.function = memory, function
        self.types = memory.types
        self.lines: list[str] = []
        self.defined: set[str] = set(function.kinds)
        """The names that have a value wherever this line is reached."""
        self.sure: set[str] = set()
        """Those of them that are not None here, whatever they are elsewhere."""
        self._myself = myself
        self._file, self._before = place
        self._count = 0

    @contextlib.contextmanager
    def at(self, node: ast.AST) -> Iterator[None]:
        """Tell where something is that is refused."""
        try:
            yield
        except RefusedError as error:
            if not error.line:
                error.line = getattr(node, "lineno", 1) + self._before
                error.file = self._file
            raise

    def say(self, line: str) -> None:
        """Write a line."""
        self.lines.append(line)

    def block(self, head: str, lines: Sequence[str], other: Sequence[str] = ()) -> None:
        """Write a block, and what is done otherwise."""
        self.lines += [f"{head} {{", *(f"    {each}" for each in lines)]
        if other:
            self.lines += ["} else {", *(f"    {each}" for each in other)]
        self.lines.append("}")

    @contextlib.contextmanager
    def aside(self) -> Iterator[list[str]]:
        """Collect what is written meanwhile."""
        before, self.lines = self.lines, []
        try:
            yield self.lines
        finally:
            self.lines = before

    def new_name(self) -> str:
        """Return a name that nobody has."""
        self._count += 1
        return f"t{self._count}"

    def joined(self, one: Type, other: Type, what: str) -> Type:
        """Return the type of what is the one or the other."""
        return join(self.types, one, other, what)

    def constant(self, value: Any) -> Value:
        """Return a value that is known."""
        return self.memory.constant(value)

    def is_self(self, node: ast.expr) -> bool:
        """Whether an expression is the reaction itself."""
        return isinstance(node, ast.Name) and node.id == self._myself != ""

    def thing(self, node: ast.expr) -> Any:
        """Return the module, class or function that is meant; None if it is a value."""
        if isinstance(node, ast.Name):
            code = self.function.python.__code__
            return None if node.id in code.co_varnames else self._global(node.id)
        if isinstance(node, ast.Attribute):
            if self.is_self(node.value):
                found = getattr(self.memory.reaction, node.attr, None)
                return (
                    found
                    if callable(found) and node.attr not in self.memory.state
                    else None
                )
            owner = self.thing(node.value)
            if isinstance(owner, types.ModuleType | type):
                return inspect.getattr_static(owner, node.attr, None)
        return None

    def _global(self, name: str) -> Any:
        found = getattr(builtins, name, UNKNOWN)
        return self.function.python.__globals__.get(name, found)

    def name(self, name: str) -> Value:
        """Return what a name has as its value."""
        code = self.function.python.__code__
        if name == self._myself:
            raise RefusedError("self is no value: write what is needed of it")
        if name in code.co_varnames:
            if name not in self.defined:
                raise RefusedError(f"{name} may have no value here: give it one before")
            kind = self.function.locals.get(name, NONE)
            if kind.of and name in self.sure:
                return Value(kind.of, f"v_{in_c(name)}.value", True)
            return (
                self.constant(None)
                if kind is NONE
                else Value(kind, f"v_{in_c(name)}", True)
            )
        if name in code.co_freevars:
            raise RefusedError(
                f"{name} is of the function around it: make it an attribute of self"
            )
        found = self._global(name)
        if found is UNKNOWN:
            raise RefusedError(f"there is no {name}: an error of the name")
        return self.constant(found)

    def attribute(self, name: str) -> Value:
        """Return what an attribute of the reaction has as its value."""
        if name in {"now_ms", "elapsed_ms"}:
            self.function.timed = True
            return Value(INT, f"es_{name}()")
        if name in self.memory.state:
            kind = self.memory.state[name]
            if kind is NONE:
                return self.constant(None)
            return Value(kind, f"self_{self.memory.c}.a_{in_c(name)}")
        return self.constant(self.memory.first(name))

    def set_local(self, name: str, value: Value) -> None:
        """Let a name have a value."""
        if name == self._myself:
            raise RefusedError("self cannot be another one")
        kind = self.memory.learn(self.function.locals, name, value.type, name)
        self.defined.add(name)
        self._set(f"v_{in_c(name)}", value, kind)

    def set_attribute(self, name: str, value: Value) -> None:
        """Let an attribute of the reaction have a value."""
        if name in {"now_ms", "elapsed_ms", "name", "rate"}:
            raise RefusedError(f"self.{name} is the loop's: take another name")
        if name not in self.memory.state:
            self.memory.state[name] = self.types.of_value(self.memory.first(name))
            self.memory.changed = True
        kind = self.memory.learn(self.memory.state, name, value.type, f"self.{name}")
        self.function.impure = True
        self._set(f"self_{self.memory.c}.a_{in_c(name)}", value, kind)

    def _set(self, target: str, value: Value, kind: Type) -> None:
        if kind is not NONE:
            self.say(f"{target} = {convert(value, kind)};")
        elif not value.simple:
            self.say(f"(void)({value.text});")


def convert(value: Value, kind: Type) -> str:
    """Write a value as one of its own type, or as what may be None too."""
    if value.type is kind:
        return value.text
    if value.type is NONE:
        return f"({kind.c}){{0}}"
    return f"({kind.c}){{true, {value.text}}}"
