"""What a line of a reaction can see: its names and types, and how C writes them."""

# ruff: noqa: SIM905

from __future__ import annotations

import ast
import builtins
import contextlib
import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import attrs

from esair.minimal import declared
from esair.resources import REFUSE

WORDS: Final = frozenset(
    "alignas alignof and asm auto bool break case catch char class const constexpr "
    "continue default delete do double else enum explicit export extern false float for "
    "friend goto if inline int long mutable namespace new not operator or private "
    "protected public real register restrict return short signed sizeof static struct "
    "switch template this throw true try typedef typeid typename typeof union unsigned "
    "using virtual void volatile while xor linux unix".split()
)
"""What no field of a struct can be called, in C or C++."""


_ODD: Final = frozenset(
    "__new__ __init__ __eq__ __ne__ __bool__ __len__ __iter__ __getitem__ __getattribute__".split()
)
"""What a named tuple must not do in its own way."""


class RefusedError(Exception):
    """Something that cannot be translated; the reason says how to write it.

    Its line is 0 as long as it is not known where that is.
    """

    def __init__(self, reason: str, line: int = 0, file: str = "") -> None:
        super().__init__(reason)
        self.reason, self.line, self.file = reason, line, file


@attrs.frozen
class Type:
    """A type of C."""

    c: str  # what it is called
    said: str  # what people call it
    fields: tuple[Type, ...] = ()  # of a tuple
    names: tuple[str, ...] = ()  # of its fields; empty for a plain tuple
    cls: type | None = attrs.field(default=None, eq=False)  # of a named tuple
    of: Type | None = None  # what it is if it is not None, of what may be None

    @property
    def row(self) -> Type | None:
        """What each field of a row is: of a plain tuple whose fields are alike."""
        if self.fields and not self.names and len(set(self.fields)) == 1:
            return self.fields[0]
        return None

    @property
    def is_large(self) -> bool:
        """Whether a copy of it costs more than its address."""
        return len(self.fields) > 2 or any(each.fields for each in self.fields)

    def field(self, number: int) -> str:
        """What follows the name of a tuple to say one of its fields."""
        if self.row is not None:
            return f".v[{number}]"
        return f".{in_c(self.names[number])}" if self.names else f".f{number}"


INT: Final = Type("int32_t", "an integer")
BOOL: Final = Type("bool", "a truth value")
REAL: Final = Type("real", "a float")
NONE: Final = Type("void", "None")
PLAIN: Final = {int: INT, bool: BOOL, float: REAL, type(None): NONE}


class Types:
    """The types that a robot needs, with what C has to be told about each."""

    def __init__(self) -> None:
        self._known: dict[object, Type] = {}
        self.lines: list[str] = []
        """The structs, for the header."""
        self.functions: list[str] = []
        """What compares and unpacks them."""
        self.names: set[str] = set()
        """Those of the functions of all reactions."""

    def tuple_of(
        self, fields: tuple[Type, ...], names: tuple[str, ...], cls: type | None
    ) -> Type:
        if not fields:
            raise RefusedError("an empty tuple: C has none, leave it out")
        above = cls.__mro__[: [*map(_is_tuple, cls.__mro__)].index(True)] if cls else ()
        if any(_ODD & vars(each).keys() for each in above):
            raise RefusedError(
                f"{cls and cls.__name__} is made or compared in its own way: write a plain one"
            )
        if any(each is NONE for each in fields):
            raise RefusedError("None in a tuple: write a number that stands for it")
        key = (fields, names, cls)
        if key in self._known:
            return self._known[key]
        said = cls.__name__ if cls else f"a tuple of {len(fields)}"
        plain = "_".join(each.c.removeprefix("Robot_") for each in fields)
        if len(set(fields)) == 1:
            plain = f"{fields[0].c.removeprefix('Robot_')}_x{len(fields)}"
        made = Type(
            self._name(cls.__name__ if cls else plain), said, fields, names, cls
        )
        inside = [f"{t.c} {made.field(n)[1:]};" for n, t in enumerate(fields)]
        same = [
            equal(t, f"a{made.field(n)}", f"b{made.field(n)}")
            for n, t in enumerate(fields)
        ]
        body = f"return {' && '.join(same)};"
        if made.row is not None:
            inside = [f"{fields[0].c} v[{len(fields)}];"]
            each = f"if (!({equal(fields[0], 'a.v[i]', 'b.v[i]')})) return false;"
            body = f"for (int i = 0; i < {len(fields)}; i++) {each} return true;"
        self.lines.append(f"typedef struct {{ {' '.join(inside)} }} {made.c};")
        if not any(t.of for t in fields):
            self.functions.append(
                f"static inline bool eq_{made.c}({made.c} a, {made.c} b) {{ {body} }}"
            )
        self._known[key] = made
        return made

    def option(self, of: Type) -> Type:
        if of is NONE or of.of:
            return of
        if of in self._known:
            return self._known[of]
        name = self._name(f"{of.c.removeprefix('Robot_')}_or_none")
        made = Type(name, f"{of.said} or None", of=of)
        self.lines.append(f"typedef struct {{ bool some; {of.c} value; }} {name};")
        self.functions.append(
            f"static inline {of.c} some_{name}({name} a) "
            "{ if (!a.some) es_fail(); return a.value; }"
        )
        self._known[of] = made
        return made

    def _name(self, wanted: str) -> str:
        name, number = f"Robot_{wanted}", 1
        while any(each.c == name for each in self._known.values()):
            number += 1
            name = f"Robot_{wanted}_{number}"
        return name

    def of_value(self, value: Any) -> Type:
        if type(value) in PLAIN:
            return PLAIN[type(value)]
        if isinstance(value, tuple):
            fields = tuple(self.of_value(each) for each in value)
            names = tuple(getattr(value, "_fields", ()))
            return self.tuple_of(fields, names, type(value) if names else None)
        if isinstance(value, list):
            raise RefusedError("a list may change: write a tuple")
        raise RefusedError(
            f"{value!r:.60}: C has numbers, truth values and tuples of them; write a namedtuple"
        )

    def of_annotation(self, hint: Any) -> Type | None:
        """Return what an annotation says of a value; None if it does not say it."""
        if hint in PLAIN:
            return PLAIN[hint]
        inside = typing.get_args(hint)
        if typing.get_origin(hint) in {typing.Union, types.UnionType}:
            some = [each for each in inside if each is not type(None)]
            return self.of_annotation(some[0]) if len(some) == 1 else None
        names, cls = (), None
        if is_named(hint):
            names, cls = hint._fields, hint
            hints = typing.get_type_hints(hint)
            inside = tuple(hints.get(each) for each in names)
        elif isinstance(hint, type) and hint not in {tuple, object, Any}:
            raise RefusedError(
                f"{hint.__name__}: C has numbers, truth values and tuples; write a namedtuple"
            )
        elif typing.get_origin(hint) is not tuple or Ellipsis in inside:
            return None
        fields = [self.of_annotation(each) for each in inside]
        known = tuple(each for each in fields if each is not None)
        return (
            self.tuple_of(known, names, cls)
            if known and len(known) == len(fields)
            else None
        )

    def literal(self, value: Any, kind: Type) -> str:
        if kind is BOOL:
            return "true" if value else "false"
        if kind is INT:
            if not -(2**31) <= value < 2**31:
                raise RefusedError(
                    f"{value} does not fit into 32 bits: write a smaller one"
                )
            if value == -(2**31):
                return "INT32_MIN"
            return f"({value})" if value < 0 else f"{value}"
        if kind is REAL:
            if math.isnan(value):
                return "R(NAN)"
            text = repr(float(value)).replace("inf", "INFINITY")
            return f"R({text})"
        return f"({kind.c}){self.braces(value, kind)}"

    def braces(self, value: Any, kind: Type) -> str:
        """Write a value where C asks for one of a known type."""
        if kind.of:
            return (
                "{0}" if value is None else f"{{true, {self.braces(value, kind.of)}}}"
            )
        if not kind.fields:
            return self.literal(value, kind)
        inside = ", ".join(map(self.braces, value, kind.fields))
        return f"{{{{{inside}}}}}" if kind.row else f"{{{inside}}}"


def is_named(cls: Any) -> bool:
    return isinstance(cls, type) and issubclass(cls, tuple) and hasattr(cls, "_fields")


def _is_tuple(cls: type) -> bool:
    return "_fields" in vars(cls)


def equal(kind: Type, one: str, other: str) -> str:
    return f"{one} == {other}" if not kind.fields else f"eq_{kind.c}({one}, {other})"


def in_c(name: str) -> str:
    """Return what a field is called in C: no word of the language, and no macro."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z_0-9]*", name):
        raise RefusedError(
            f"the name {name!r}: names of C have letters, digits and _: take another"
        )
    return f"{name}_" if name.rstrip("_") in WORDS or name.isupper() else name


UNKNOWN: Final = object()
_MANY: Final = {inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD}


@attrs.frozen
class Value:
    """What an expression gives; its text changes nothing, and can raise a fault."""

    type: Type
    text: str
    simple: bool = False
    """Whether it can be written twice, and after other statements too."""
    known: Any = UNKNOWN
    """It, if it is a constant."""

    @property
    def is_known(self) -> bool:
        return self.known is not UNKNOWN


@attrs.define
class Function:
    """A function of Python for arguments of given types, as far as they are known."""

    python: Any
    c: str  # what it is called in C
    kinds: Mapping[str, Type]  # of its parameters
    locals: dict[str, Type]
    result: Type | None = None
    impure: bool = False  # whether it changes self
    timed: bool = False  # whether it asks for the time
    lines: list[str] = attrs.Factory(list)

    lent: set[str] = attrs.Factory(set)
    """Its parameters that are pointers: large, and never another value in it."""

    def called(self, args: Mapping[str, Value]) -> str:
        given = [
            _lent(each) if name in self.lent else each.text
            for name, each in args.items()
            if each.type is not NONE
        ]
        return f"{self.c}({', '.join(given)})"


def _lent(value: Value) -> str:
    """Write where a value is: what a function may change meanwhile is copied first."""
    if re.fullmatch(r"(\(\*v_\w+\)|(v|in|pass)_\w+|(t|es_k)\d+)[\w.\[\]]*", value.text):
        return f"&{value.text}"
    return f"(const {value.type.c}[]){{{value.text}}}"


@attrs.define
class Memory:
    """What the functions of one reaction share."""

    reaction: Any
    c: str  # what it is called in C
    types: Types
    constants: dict[str, str]
    """The texts of constant tuples, and their names."""
    call: Callable[[Any, Mapping[str, Value]], Function]
    """Translates a function for arguments."""
    ports: Mapping[str, Type]
    """What the actuators of its ports take."""
    state: dict[str, Type] = attrs.Factory(dict)
    """The types of the attributes that it changes."""
    changed: bool = False
    """Whether something was learned about types, so all is translated anew."""

    def learn(self, known: dict[str, Type], name: str, kind: Type, what: str) -> Type:
        """Return the type of a name or attribute, with one more use of it."""
        before = known.get(name)
        known[name] = after = join(self.types, before or kind, kind, what)
        self.changed |= after is not before
        return after

    def constant(self, value: Any) -> Value:
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
    """The names of one function, and the lines that are written for it."""

    def __init__(
        self,
        memory: Memory,
        function: Function,
        myself: str,  # its first parameter, if that is the reaction
        place: tuple[str, int],  # its file, and how many lines are before it there
        command: Type | None,  # what its actuator takes, if it returns commands
    ) -> None:
        self.memory, self.function = memory, function
        self.types, self.constant = memory.types, memory.constant
        self.lines: list[str] = []
        self.defined: set[str] = set(function.kinds)
        """The names that have a value wherever this line is reached."""
        self.sure: set[str] = set()
        """Those of them that are not None here, whatever they are elsewhere."""
        self._myself = myself
        self._file, self._before = place
        self._count = 0
        self._command = command
        self.errors: list[RefusedError] = []
        """What was refused; the rest is translated nevertheless, for its types."""

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
        self.lines.append(line)

    def block(self, head: str, lines: Sequence[str], other: Sequence[str] = ()) -> None:
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
        self._count += 1
        return f"t{self._count}"

    def is_self(self, node: ast.expr) -> bool:
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
        code = self.function.python.__code__
        if name == self._myself:
            raise RefusedError("self is no value: write what is needed of it")
        if name in code.co_varnames:
            if name not in self.defined:
                raise RefusedError(f"{name} may have no value here: give it one before")
            kind = self.function.locals.get(name, NONE)
            if kind.of and name in self.sure:
                return Value(kind.of, f"v_{in_c(name)}.value", True)
            if kind is NONE:
                return self.constant(None)
            text = f"v_{in_c(name)}"
            return Value(
                kind, f"(*{text})" if name in self.function.lent else text, True
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
        if name == self._myself:
            raise RefusedError("self cannot be another one")
        kind = self.memory.learn(self.function.locals, name, value.type, name)
        self.defined.add(name)
        self._put(f"v_{in_c(name)}", value, kind)

    def set_attribute(self, name: str, value: Value) -> None:
        if name in {"now_ms", "elapsed_ms", "name", "rate"}:
            raise RefusedError(f"self.{name} is the loop's: take another name")
        if name not in self.memory.state:
            self.memory.state[name] = self.types.of_value(self.memory.first(name))
            self.memory.changed = True
        kind = self.memory.learn(self.memory.state, name, value.type, f"self.{name}")
        self.function.impure = True
        self._put(f"self_{self.memory.c}.a_{in_c(name)}", value, kind)

    def _put(self, target: str, value: Value, kind: Type) -> None:
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
