"""Types of C: what a value of a reaction is there, how it is written and compared."""

# ruff: noqa: SIM905

from __future__ import annotations

import math
import re
import types
import typing
from typing import Any, Final

import attrs

WORDS: Final = frozenset(
    "alignas alignof and asm auto bool break case catch char class const constexpr "
    "continue default delete do double else enum explicit export extern false float for "
    "friend goto if inline int long mutable namespace new not operator or private "
    "protected public real register restrict return short signed sizeof static struct "
    "switch template this throw true try typedef typeid typename union unsigned using "
    "virtual void volatile while xor".split()
)
"""What no field of a struct can be called, in C or C++."""


_ODD: Final = frozenset(
    "__new__ __init__ __eq__ __ne__ __bool__ __len__ __iter__ __getitem__ __getattribute__".split()
)
"""What a named tuple must not do in its own way."""


class RefusedError(Exception):
    """Something that cannot be translated; the reason says how to write it.

    Attributes:
        reason: What it is, and what to write instead.
        line: Where it is in its file; 0 if that is not known yet.
        file: The name of that file.
    """

    def __init__(self, reason: str, line: int = 0, file: str = "") -> None:
        super().__init__(reason)
        self.reason, self.line, self.file = reason, line, file


@attrs.frozen
class Type:
    """A type of C.

    Attributes:
        c: What it is called.
        said: What people call it.
        fields: The types of a tuple's fields; empty for what is no tuple.
        names: What its fields are called; empty for a plain tuple.
        cls: The class of a named tuple.
        of: What it is if it is not None; None for what is never None.
    """

    c: str
    said: str
    fields: tuple[Type, ...] = ()
    names: tuple[str, ...] = ()
    cls: type | None = attrs.field(default=None, eq=False)
    of: Type | None = None

    @property
    def row(self) -> Type | None:
        """What each field of a row is: of a plain tuple whose fields are alike."""
        if self.fields and not self.names and len(set(self.fields)) == 1:
            return self.fields[0]
        return None

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

    def tuple_of(
        self, fields: tuple[Type, ...], names: tuple[str, ...], cls: type | None
    ) -> Type:
        """Return the struct of a tuple, or of a named one."""
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
        """Return the struct of what may be None."""
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
        """Return the type of a value that is known."""
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
        """Write a value as C has it."""
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
    """Whether something is the class of a named tuple."""
    return isinstance(cls, type) and issubclass(cls, tuple) and hasattr(cls, "_fields")


def _is_tuple(cls: type) -> bool:
    return "_fields" in vars(cls)


def equal(kind: Type, one: str, other: str) -> str:
    """Write the comparison of two values of a type."""
    return f"{one} == {other}" if not kind.fields else f"eq_{kind.c}({one}, {other})"


def in_c(name: str) -> str:
    """Return what a field is called in C: no word of the language, and no macro."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z_0-9]*", name):
        raise RefusedError(
            f"the name {name!r}: names of C have letters, digits and _: take another"
        )
    return f"{name}_" if name in WORDS or name.isupper() else name
