"""Expressions of Python as expressions of C, in Python's order of evaluation.

The text of a `Value` changes nothing, whatever order C evaluates it in: what has an effect,
or is needed twice, stands in a statement of its own before it.
"""

from __future__ import annotations

import ast
import functools
import inspect
import math
import operator
import types
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Final

from esair.firmware.c._scope import (
    BOOL,
    INT,
    NONE,
    REAL,
    UNKNOWN,
    RefusedError,
    Scope,
    Type,
    Value,
    convert,
    equal,
    is_named,
    join,
)

# What each operator is called for integers, for floats, and in Python.
_OPERATORS: Final[dict[type[ast.operator], tuple[str, str, Any]]] = {
    ast.Add: ("es_add({}, {})", "({} + {})", operator.add),
    ast.Sub: ("es_sub({}, {})", "({} - {})", operator.sub),
    ast.Mult: ("es_mul({}, {})", "({} * {})", operator.mul),
    ast.Div: ("", "es_div({}, {})", operator.truediv),
    ast.FloorDiv: (
        "es_floordiv({}, {})",
        "es_floordiv_real({}, {})",
        operator.floordiv,
    ),
    ast.Mod: ("es_mod({}, {})", "es_mod_real({}, {})", operator.mod),
    ast.LShift: ("es_shl({}, {})", "", operator.lshift),
    ast.RShift: ("es_shr({}, {})", "", operator.rshift),
    ast.BitAnd: ("({} & {})", "", operator.and_),
    ast.BitOr: ("({} | {})", "", operator.or_),
    ast.BitXor: ("({} ^ {})", "", operator.xor),
}
_COMPARED: Final[dict[type[ast.cmpop], str]] = {
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
}
_MATH: Final = {
    getattr(math, name): f"es_math(M({name})({{0}}), {{0}})"
    for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log")
} | {
    math.fabs: "M(fabs)({0})",
    math.radians: f"({{0}} * R({math.pi / 180!r}))",
    math.degrees: f"({{0}} * R({180 / math.pi!r}))",
    math.atan2: "M(atan2)({0}, {1})",
    math.copysign: "M(copysign)({0}, {1})",
}
_TO_INT: Final[dict[Any, str]] = {
    int: "es_int({})",
    round: "es_round({})",
    math.floor: "es_int(M(floor)({}))",
    math.ceil: "es_int(M(ceil)({}))",
}
_TO_BOOL: Final = {math.isnan: "isnan", math.isinf: "isinf", math.isfinite: "isfinite"}
_INSTEAD: Final = {
    sum: "its floats are rounded in another way in each Python: add in a for loop",
    math.hypot: "C rounds it in another way: write math.sqrt(x * x + y * y)",
    math.pow: "write x * x",
    pow: "write x * x",
    print: "a chip has no line to print to: count on self",
    isinstance: "each value has one type here: leave it out",
}


class Expressions(Scope):
    """Translates the expressions of one function; statements that they need go before."""

    def of(self, node: ast.expr) -> Value:
        with self.at(node):
            if type(node) not in self._by_node:
                raise RefusedError(
                    f"{ast.unparse(node):.60}: C has nothing like it; write numbers, "
                    "tuples, if and for"
                )
            return self._by_node[type(node)](self, node)

    def operands(self, nodes: Sequence[ast.expr]) -> list[Value]:
        """Translate expressions that Python evaluates from left to right."""
        found: list[Value] = []
        for node in nodes:
            with self.aside() as lines:
                value = self.of(node)
            if lines:
                found = [self.kept(each) for each in found]
                self.lines += lines
            found.append(value)
        return found

    def kept(self, value: Value) -> Value:
        """Return a value that stays what it is now, whatever statements follow."""
        if value.simple:
            return value
        name = self.new_name()
        self.say(f"const {value.type.c} {name} = {value.text};")
        return Value(value.type, name, True)

    def there(self, value: Value) -> Value:
        """Return a value that is not None; it is a fault if it is."""
        if value.type.of is None:
            return value
        return Value(value.type.of, f"some_{value.type.c}({value.text})")

    def number(self, value: Value, doing: str = "a calculation") -> Value:
        value = self.there(value)
        if value.type not in {INT, BOOL, REAL}:
            raise RefusedError(
                f"{doing} with {value.type.said}: write it with its numbers"
            )
        return value

    def as_real(self, value: Value) -> str:
        value = self.number(value)
        if value.is_known:
            return self.types.literal(float(value.known), REAL)
        return value.text if value.type is REAL else f"(real){value.text}"

    def as_int(self, value: Value) -> str:
        value = self.number(value)
        if value.type is REAL:
            raise RefusedError(
                "a float where Python asks for an integer: write int(...)"
            )
        return value.text if value.type is INT else f"(int32_t){value.text}"

    def binary(self, op: ast.operator, left: Value, right: Value) -> Value:
        if type(op) not in _OPERATORS:
            raise RefusedError(
                f"{type(op).__name__}: write it with + - * /, as x * x for x ** 2"
            )
        whole, real, python = _OPERATORS[type(op)]
        left, right = self.number(left), self.number(right)
        if left.is_known and right.is_known:
            try:
                return self.constant(python(left.known, right.known))
            except (ArithmeticError, RefusedError, TypeError, ValueError):
                pass  # it is a fault when it is done, or is refused below
        if not whole or REAL in {left.type, right.type}:
            if not real:
                raise RefusedError("bits of a float: write int(...)")
            return Value(REAL, real.format(self.as_real(left), self.as_real(right)))
        text = whole.format(self.as_int(left), self.as_int(right))
        if whole[0] == "(" and left.type is right.type is BOOL:
            return Value(BOOL, f"({text} != 0)")
        return Value(INT, text)

    def _unary(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            return Value(BOOL, self.condition(node))
        if (
            isinstance(node.op, ast.USub)
            and type(getattr(node.operand, "value", "")) is int
        ):
            return self.constant(-node.operand.value)  # type: ignore[attr-defined]
        value = self.number(self.of(node.operand))
        signs: Any = {
            ast.USub: operator.neg,
            ast.UAdd: operator.pos,
            ast.Invert: operator.inv,
        }
        if value.is_known and value.known != -(2**31):
            return self.constant(signs[type(node.op)](value.known))
        if isinstance(node.op, ast.Invert):
            return Value(INT, f"(~{self.as_int(value)})")
        if isinstance(node.op, ast.UAdd):
            return value if value.type is not BOOL else Value(INT, self.as_int(value))
        if value.type is REAL:
            return Value(REAL, f"(-{value.text})")
        return Value(INT, f"es_neg({self.as_int(value)})")

    def truth(self, value: Value) -> str:
        if value.type is NONE:
            return "false"
        if value.type.of:
            value = self.kept(value)
            return f"({value.text}.some && {self.truth(inside(value))})"
        if value.type.fields:
            return "true"
        return value.text if value.type is BOOL else f"({value.text} != 0)"

    def condition(self, node: ast.expr) -> str:
        """Translate what decides: only as much of it is evaluated as Python does."""
        with self.at(node):
            if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
                return f"!{self.condition(node.operand)}"
            if isinstance(node, ast.BoolOp):
                text = self.condition(node.values[0])
                for each in node.values[1:]:
                    text = self._further(
                        text,
                        isinstance(node.op, ast.And),
                        functools.partial(self.condition, each),
                    )
                return text
            if isinstance(node, ast.Compare):
                return self._compared(node)
            return self.truth(self.of(node))

    def _further(self, text: str, wanted: bool, more: Callable[[], str]) -> str:
        """Write a condition that is looked at further only if it was as wanted."""
        with self.aside() as lines:
            other = more()
        if not lines:
            return f"({text} {'&&' if wanted else '||'} {other})"
        name = self.new_name()
        self.say(f"bool {name} = {text};")
        self.block(
            f"if ({'' if wanted else '!'}{name})", [*lines, f"{name} = {other};"]
        )
        return name

    def _compared(self, node: ast.Compare) -> str:
        left, right = self.operands([node.left, node.comparators[0]])
        return self._chained(node.ops, left, right, node.comparators[1:])

    def _chained(
        self, ops: list[ast.cmpop], left: Value, right: Value, others: list[ast.expr]
    ) -> str:
        """Translate ``a < b < c``: ``b`` is evaluated once, ``c`` only if ``a < b``."""
        if not others:
            return self.pair(ops[0], left, right)
        right = self.kept(right)

        def more() -> str:
            return self._chained(ops[1:], right, self.of(others[0]), others[1:])

        return self._further(self.pair(ops[0], left, right), True, more)

    def pair(self, op: ast.cmpop, left: Value, right: Value) -> str:
        no = "!" if isinstance(op, ast.IsNot | ast.NotEq | ast.NotIn) else ""
        if (
            isinstance(op, ast.Is | ast.IsNot)
            or right.type is NONE
            or left.type is NONE
        ):
            if right.type is not NONE or not isinstance(
                op, ast.Is | ast.IsNot | ast.Eq | ast.NotEq
            ):
                raise RefusedError(
                    "C has no identity of values: write ==, or `is None`"
                )
            if left.type.of:
                return f"({'' if no else '!'}{left.text}.some)"
            if not left.simple:
                self.say(f"(void)({left.text});")
            return "true" if (left.type is NONE) != bool(no) else "false"
        if isinstance(op, ast.In | ast.NotIn):
            if not isinstance(right.known, tuple):
                raise RefusedError(
                    "`in`: write a tuple of constants, or compare in a for loop"
                )
            left = self.kept(left)
            each = [
                self.pair(ast.Eq(), left, self.constant(one)) for one in right.known
            ]
            return f"{no}({' || '.join(each)})"
        if left.type.fields or right.type.fields:
            if left.type is not right.type or type(op) not in {ast.Eq, ast.NotEq}:
                raise RefusedError(
                    f"{left.type.said} and {right.type.said}: compare their fields"
                )
            left, right = self.kept(left), self.kept(right)
            return f"{no}{equal(left.type, left.text, right.text)}"
        if isinstance(op, ast.Eq | ast.NotEq) and (left.type.of or right.type.of):
            raise RefusedError(
                "== of what may be None: ask `is None` before, and keep a number"
            )
        left, right = (self.number(each, "a comparison") for each in (left, right))
        as_text = self.as_real if REAL in {left.type, right.type} else self.as_int
        return f"({as_text(left)} {_COMPARED[type(op)]} {as_text(right)})"

    def _and_or(self, node: ast.BoolOp) -> Value:
        """Translate ``a or b`` where its value counts, not only whether it is true."""
        values, asides = [], []
        for each in node.values:
            with self.aside() as lines:
                values.append(self.of(each))
            asides.append(lines)
        kind = values[0].type
        for value in values:
            kind = join(self.types, kind, value.type, "`and`, `or`")
        if kind is NONE:
            raise RefusedError("`and`, `or` of None alone: write None")
        self.lines += asides[0]
        name = self.new_name()
        self.say(f"{kind.c} {name} = {convert(values[0], kind)};")
        test = self.truth(Value(kind, name, True))
        for lines, value in zip(asides[1:], values[1:], strict=True):
            no = "" if isinstance(node.op, ast.And) else "!"
            self.block(
                f"if ({no}{test})", [*lines, f"{name} = {convert(value, kind)};"]
            )
        return Value(kind, name, True)

    def _if(self, node: ast.IfExp) -> Value:
        test = self.condition(node.test)
        with self.aside() as yes:
            one = self.of(node.body)
        with self.aside() as no:
            other = self.of(node.orelse)
        if (
            isinstance(node.test, ast.Compare)
            and [*map(ast.unparse, node.test.comparators)] == ["None"]
            and one.type is not NONE is not other.type
        ):
            asked = ast.dump(node.test.left)
            op = type(node.test.ops[0])
            if op is ast.IsNot and ast.dump(node.body) == asked:
                one = self.there(one)
            elif op is ast.Is and ast.dump(node.orelse) == asked:
                other = self.there(other)
        kind = join(self.types, one.type, other.type, "the two sides of `if ... else`")
        if kind is NONE:
            self.block(f"if ({test})", yes, no)
            return one
        a, b = convert(one, kind), convert(other, kind)
        if not yes and not no:
            return Value(kind, f"({test} ? {a} : {b})")
        name = self.new_name()
        self.say(f"{kind.c} {name};")
        self.block(f"if ({test})", [*yes, f"{name} = {a};"], [*no, f"{name} = {b};"])
        return Value(kind, name, True)

    def display(self, values: Sequence[Value], cls: Any = None) -> Value:
        if any(each.type.of for each in values):
            raise RefusedError(
                "what may be None in a tuple: write (x if x is not None else 0.0)"
            )
        if all(each.is_known for each in values):
            known = [each.known for each in values]
            return self.constant(cls(*known) if cls else tuple(known))
        names = cls._fields if cls else ()
        kinds = tuple(each.type for each in values)
        return self._tuple(self.types.tuple_of(kinds, names, cls), values)

    def _tuple(self, kind: Type, values: Sequence[Value]) -> Value:
        text = f"{{{', '.join(each.text for each in values)}}}"
        return Value(kind, f"(({kind.c}){f'{{{text}}}' if kind.row else text})")

    def item(self, value: Value, number: int) -> Value:
        if value.is_known:
            return self.constant(value.known[number])
        value = self.kept(value)
        return Value(
            value.type.fields[number], value.text + value.type.field(number), True
        )

    def _attribute(self, node: ast.Attribute) -> Value:
        owner = self.thing(node.value)
        if self.is_self(node.value):
            return self.attribute(node.attr)
        if isinstance(owner, types.ModuleType | type):
            return self.constant(getattr(owner, node.attr, UNKNOWN))
        value = self.there(self.of(node.value))
        if node.attr in value.type.names:
            return self.item(value, value.type.names.index(node.attr))
        found = inspect.getattr_static(value.type.cls, node.attr, UNKNOWN)
        if found is UNKNOWN or callable(found) or hasattr(found, "__get__"):
            raise RefusedError(f"{value.type.said} has no field {node.attr!r} in C")
        return self.constant(found)

    def _subscript(self, node: ast.Subscript) -> Value:
        if isinstance(node.slice, ast.Slice):
            raise RefusedError("a slice: take its fields one by one")
        value, index = self.operands([node.value, node.slice])
        if not value.type.fields:
            raise RefusedError(f"{value.type.said} has no items: only tuples have")
        size = len(value.type.fields)
        if type(index.known) is int:
            if not -size <= index.known < size:
                raise RefusedError(f"item {index.known} of {size}: there is none")
            return self.item(value, index.known % size)
        row = value.type.row
        if row is None:
            raise RefusedError(
                "an item by a number that is not known: only of a row of equal types"
            )
        value = self.kept(value)
        return Value(row, f"{value.text}.v[es_at({self.as_int(index)}, {size})]")

    def _call(self, node: ast.Call) -> Value:
        if any(isinstance(a, ast.Starred) for a in node.args) or any(
            k.arg is None for k in node.keywords
        ):
            raise RefusedError("* or ** in a call: write each argument")
        function = node.func
        if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Dict):
            return self._looked_up(function, node)
        owner: Value | None = None
        target = self.thing(function)
        if isinstance(function, ast.Attribute) and target is None:
            owner = self.there(self.of(function.value))
            target = inspect.getattr_static(owner.type.cls, function.attr, None)
            if not isinstance(target, types.FunctionType):
                raise RefusedError(
                    f"{ast.unparse(function):.60}(): C has no such method"
                )
            owner = self.kept(owner)
        if target is float and node.args and isinstance(node.args[0], ast.Constant):
            return self.constant(float(ast.literal_eval(node.args[0])))  # "inf"
        values = self.operands([*node.args, *(each.value for each in node.keywords)])
        args = values[: len(node.args)]
        names = [str(each.arg) for each in node.keywords]
        named = dict(zip(names, values[len(args) :], strict=True))
        bound = self.memory.bound
        if is_named(target):
            new = functools.partial(target.__new__, target)
            return self.display([*bound(new, args, named).values()], target)
        if isinstance(target, types.FunctionType | types.MethodType):
            first = [owner] if owner is not None else []
            return self._called(target, bound(target, [*first, *args], named))
        if named:
            raise RefusedError(f"{ast.unparse(function):.60}: give it no keywords")
        return self._builtin(target, ast.unparse(function), args)

    def _called(self, target: Any, args: dict[str, Value]) -> Value:
        """Call a function of the user; a statement of its own if it changes self."""
        function = self.memory.call(target, args)
        self.function.impure |= function.impure
        self.function.timed |= function.timed
        text = function.called(args)
        if function.result in {None, NONE}:
            self.say(f"{text};")
            return self.constant(None)
        assert function.result is not None
        value = Value(function.result, text)
        return self.kept(value) if function.impure else value

    def as_command(self, value: Value, kind: Type) -> Value:
        """Return a value as the command that an actuator takes, or what may be None."""
        if value.type is NONE or value.type is kind or value.type.of is kind:
            return value
        if value.type.of:
            value = self.kept(value)
            text = self.as_command(inside(value), kind).text
            some = self.types.option(kind)
            return Value(some, f"(({some.c}){{{value.text}.some, {text}}})")
        if kind is REAL and value.type is INT:
            return Value(REAL, self.as_real(value))
        named = not kind.names or (
            value.type.cls is not None and issubclass(value.type.cls, kind.cls or tuple)
        )
        if named and kind.fields and len(value.type.fields) == len(kind.fields):
            parts = [  # of the same number
                self.as_command(self.item(value, n), each)
                for n, each in enumerate(kind.fields)
            ]
            return self._tuple(kind, parts)
        raise RefusedError(
            f"the command is {value.type.said}, and its actuator takes "
            f"{kind.said}: return that"
        )

    def _commands(self, node: ast.Dict) -> Value:
        """Translate ``{"left": ..., "right": ...}``, commands for several actuators."""
        ports = self.memory.ports
        keys = [
            each.value if isinstance(each, ast.Constant) else None for each in node.keys
        ]
        if not keys or not set(keys) <= ports.keys() or len(set(keys)) < len(keys):
            raise RefusedError(
                "a dictionary: only of commands, each once, by the names of ports"
            )
        options = [self.types.option(each) for each in ports.values()]
        kind = self.types.tuple_of(tuple(options), tuple(ports), None)
        values = dict(zip(keys, self.operands(node.values), strict=True))
        none = self.constant(None)
        texts = [
            convert(self.as_command(values.get(name, none), ports[name]), option)
            for name, option in zip(ports, options, strict=True)
        ]
        return Value(kind, f"(({kind.c}){{{', '.join(texts)}}})")

    def _looked_up(self, function: ast.Attribute, node: ast.Call) -> Value:
        """Translate ``{key: value, ...}.get(key, default)`` of constants."""
        table = function.value
        assert isinstance(table, ast.Dict)
        if function.attr != "get" or len(node.args) != 2 or None in table.keys:
            raise RefusedError(
                "a dictionary: write if and elif, or {...}.get(key, default)"
            )
        cases = [self.of(each) for each in [*filter(None, table.keys), *table.values]]
        if not all(each.is_known for each in cases):
            raise RefusedError(
                "a dictionary whose values are not constants: write if and elif"
            )
        half = len(table.values)
        found = {
            key.known: value for key, value in zip(cases, cases[half:], strict=False)
        }
        # Python looks at the default, too, and at its faults.
        key, value = map(self.kept, self.operands(node.args))
        kind, text = value.type, value.text
        for known, each in reversed(found.items()):
            kind = join(self.types, kind, each.type, "the values of the dictionary")
            if kind is not value.type:
                raise RefusedError("None in the dictionary: write if and elif")
            test = self.pair(ast.Eq(), key, self.constant(known))
            text = f"({test} ? {each.text} : {text})"
        return Value(kind, text)

    def _builtin(self, target: Any, said: str, args: list[Value]) -> Value:
        if not callable(target):
            raise RefusedError(f"{said}: C has no such function")
        if len(args) == 1 and target in {min, max} and args[0].type.row is not None:
            row = self.kept(args[0])
            args = [self.item(row, n) for n in range(len(row.type.fields))]
            return self._extreme(target, args)
        if target in {min, max} and len(args) > 1:
            return self._extreme(target, args)
        if target is len and len(args) == 1 and args[0].type.fields:
            return self.constant(len(args[0].type.fields))
        if target is bool and len(args) == 1:
            return Value(BOOL, self.truth(args[0]))
        takes = 2 if target in {math.atan2, math.copysign} else 1
        known = {abs, float, *_MATH, *_TO_INT, *_TO_BOOL}
        if target not in known or len(args) != takes:
            instead = next(
                (text for each, text in _INSTEAD.items() if target is each), ""
            )
            raise RefusedError(f"{said}: {instead or 'C has nothing like it here'}")
        values = [self.number(each, said) for each in args]
        if all(each.is_known for each in values):
            try:
                return self.constant(target(*(each.known for each in values)))
            except (ArithmeticError, ValueError, RefusedError):
                pass  # it is a fault when it is done
        return self._calculated(target, values)

    def _calculated(self, target: Any, values: list[Value]) -> Value:
        value = values[0]
        if target in _MATH:
            reals = [self.kept(Value(REAL, self.as_real(each))).text for each in values]
            return Value(REAL, _MATH[target].format(*reals))
        if target in _TO_BOOL:
            return Value(BOOL, f"({_TO_BOOL[target]}({self.as_real(value)}) != 0)")
        if target is float:
            return Value(REAL, self.as_real(value))
        if value.type is not REAL:
            text = self.as_int(value)
            return Value(INT, f"es_abs({text})" if target is abs else text)
        if target is abs:
            return Value(REAL, f"M(fabs)({value.text})")
        return Value(INT, _TO_INT[target].format(value.text))

    def _extreme(self, target: Any, values: Sequence[Value]) -> Value:
        values = [self.number(each) for each in values]
        kinds = {each.type for each in values}
        if len(kinds) > 1 or BOOL in kinds:
            raise RefusedError(
                f"{target.__name__} of an integer and a float: write {target.__name__}(0.0, x), "
                "with floats or with integers only"
            )
        name = f"es_{target.__name__}{'_real' if REAL in kinds else ''}"
        text = values[0].text
        for each in values[1:]:
            text = f"{name}({text}, {each.text})"
        return Value(values[0].type, text)

    _by_node: ClassVar[dict[type[ast.expr], Callable[[Any, Any], Value]]] = {
        ast.Constant: lambda self, node: self.constant(node.value),
        ast.Name: lambda self, node: self.name(node.id),
        ast.Attribute: _attribute,
        ast.Subscript: _subscript,
        ast.Tuple: lambda self, node: self.display(self.operands(node.elts)),
        ast.UnaryOp: _unary,
        ast.BinOp: lambda self, node: self.binary(
            node.op, *self.operands([node.left, node.right])
        ),
        ast.Compare: lambda self, node: Value(BOOL, self.condition(node)),
        ast.BoolOp: _and_or,
        ast.IfExp: _if,
        ast.Call: _call,
        ast.Dict: _commands,
    }


def inside(value: Value) -> Value:
    """Return what a value is that is not None."""
    return Value(value.type.of or NONE, f"{value.text}.value", True)
