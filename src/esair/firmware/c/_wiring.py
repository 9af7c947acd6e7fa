"""A robot in C: MIN's own wiring as tables, and what leads from them to its reactions."""

from __future__ import annotations

import importlib.resources
import math
import re
import string
import typing
from collections.abc import Callable, Sequence
from typing import Any

import attrs

from esair import actions, minimal
from esair.firmware.c._functions import Functions
from esair.firmware.c._scope import (
    BOOL,
    INT,
    NONE,
    REAL,
    RefusedError,
    Type,
    Types,
    Value,
    equal,
    in_c,
)


@attrs.frozen
class Program:
    """A robot in C."""

    types: Types
    sensors: dict[str, Type]  # what each gives
    actuators: dict[str, Type]  # what each takes
    parts: list[str]  # what each is called, of reactions in the order of MIN's steps
    source: str  # robot.c
    has_floats: bool


class Wiring:
    """Translates the parts of a robot, as `esair.minimal.Loop` takes them.

    Sensors give what their ``example``, or the annotation of ``read``, says; actuators
    take what their ``safe`` is. ``refuse`` is told the parts that cannot be translated.
    """

    def __init__(
        self,
        reactions: Sequence[Any],
        sensors: Sequence[Any],
        actuators: Sequence[Any],
        rate: float,
        armed: bool,
        refuse: Callable[[Any, RefusedError], None],
    ) -> None:
        self._armed, self._refuse = armed, refuse
        self._loop = minimal.Loop(reactions, sensors, actuators, rate)
        self._types, self._constants = Types(), dict[str, str]()
        self._unknown: set[str] = set()
        self._outputs = self._all(actuators, self._taken)
        self._inputs = self._all(sensors, self._given)
        self._lines: list[str] = []
        self._terms: list[str] = []
        self._blind_of: dict[str, str] = {}
        self._tasks = [wired[0] for wired in self._loop.tasks]
        outputs = self._loop.outputs.values()
        self._ports = [port for output in outputs for port in output.ports]

    def program(self) -> Program:
        """Return the robot in C; of what is refused there is nothing in it."""
        outputs = self._loop.outputs.values()
        guards = [port for output in outputs for port in output.guards]
        for name, kind in self._inputs.items():
            self._lines += self._input(name, kind)
        for name in self._outputs:
            self._lines += [] if name in self._unknown else self._output(name)
        tables = {
            "task": [self._task(wired) for wired in self._loop.tasks],
            "term": self._terms,
            "input": [*map(self._input_row, self._inputs)],
            "port": [*map(self._port_row, self._ports)],
            "guard": [*map(self._guard_row, guards)],
            "output": [*map(self._output_row, self._outputs)],
        }
        gap, odd = divmod(1_000_000, self._loop.every)
        tasks = [task.name for task in self._tasks]
        names = {"SENSOR": self._inputs, "ACTUATOR": self._outputs, "REACTION": tasks}
        parts = [f"ROBOT_{kind}_{n.upper()}" for kind in names for n in names[kind]]
        if len(parts) > 200 or gap == 0:
            error = RefusedError("at most 200 parts, and 1000 steps a second")
            self._refuse(self._loop, error)
        for each in sorted({each for each in parts if parts.count(each) > 1}):
            error = RefusedError(f"{each}: two names that differ in case alone")
            self._refuse(self._loop, error)
        said = "\n".join(self._lines)
        robot = self._types.functions + [
            text.replace("@", name)
            for text, name in self._constants.items()
            if re.search(rf"\b{name}\b", said)
        ]
        robot += ["", *self._lines]
        for part in ("term", "input", "task", "port", "guard", "output"):
            robot += _table(part, tables[part])
        floats = any("real" in line for line in self._types.lines + robot)
        source = filled(
            "robot.c",
            math="#include <math.h>\n" if floats else "",
            counts=", ".join(
                f"ES_{k.upper()}S = {len(rows)}" for k, rows in tables.items()
            ),
            every=self._loop.every,
            gap=gap,
            odd=odd,
            core=filled("core.c") + (filled("core_float.c") if floats else ""),
            robot="\n".join(robot),
            armed=_c(self._armed),
        )
        return Program(self._types, self._inputs, self._outputs, parts, source, floats)

    def _all(
        self, parts: Sequence[Any], kind: Callable[[Any], Type]
    ) -> dict[str, Type]:
        found = {}
        for part in parts:
            try:
                in_c(part.name)
                found[part.name] = kind(part)
            except RefusedError as error:
                self._refuse(part, error)
                self._unknown.add(part.name)
                found[part.name] = REAL
        return found

    def _taken(self, actuator: Any) -> Type:
        kind = self._types.of_value(actuator.safe)
        limits = self._loop.outputs[actuator.name].limits
        if limits and (kind is BOOL or ("" in limits and kind.fields)):
            raise RefusedError(
                f"limits of {kind.said}: leave them out, or name those of each field as "
                "{'linear': (-1.0, 1.0)}"
            )
        return kind

    def _given(self, sensor: Any) -> Type:
        """Return what a sensor gives: by example, or by what annotations say."""
        if hasattr(sensor, "example"):
            return self._types.of_value(sensor.example)
        said = [_hints(type(sensor).read).get("return")]
        for task, _, terms, *_ in self._loop.tasks:
            for key, source, *_ in terms:
                if source.name == sensor.name:
                    said += [
                        _hints(task.reaction.react).get(key),
                        dict(minimal.declared(task.reaction))[key].type,
                    ]
        for hint in said:
            known = hint not in {None, type(None)}
            if known and (kind := self._types.of_annotation(hint)) is not None:
                return kind
        raise RefusedError(
            "what it gives is not known: give its class `example = ...`, a reading as it "
            "gives them, each row in its full length"
        )

    def _input(self, name: str, kind: Type) -> list[str]:
        test = "\n    ".join(_unfit(kind, "value"))
        empty = "{0}" if kind.fields else "0"
        return _code("sensor.c", type=kind.c, name=name, test=test, empty=empty)

    def _output(self, name: str) -> list[str]:
        kind, output = self._outputs[name], self._loop.outputs[name]
        values = {
            "type": kind.c,
            "name": name,
            "safe": self._types.braces(output.safe, kind),
            "still": equal(kind, f"*(const {kind.c} *)command", f"safe_{name}"),
            "checks": "\n    ".join(self._checks(output, kind)),
        }
        lines = _code("actuator.c", **values)
        if not output.guards:
            return lines
        parts = {kind.field(n): each for n, each in enumerate(kind.fields)}
        less = [
            f"value{f} = es_less{'_real' * (t is REAL)}(value{f}, most{f}, safe_{name}{f});"
            for f, t in (parts or {"": kind}).items()
        ]
        return lines + _code(
            "guarded.c",
            **values,
            less="\n    ".join(less),
            is_last=equal(kind, f"pass_{name}", f"last_{name}"),
            is_less=equal(kind, "passed", "less"),
        )

    def _checks(self, output: Any, kind: Type) -> list[str]:
        """Write what a command must be to be sent."""
        lines = []
        for number, each in enumerate(kind.fields or (kind,)):
            value = "command" + (kind.field(number) if kind.fields else "")
            if each is REAL:
                lines.append(f"if (!isfinite({value})) es_fail();")
            limits = output.limits.get(kind.names[number] if kind.names else "")
            if limits is None or each is BOOL:
                continue
            low, high = limits
            least, most = float(low), float(high)
            if each is INT:
                least = -(2**31) if low < -(2**31) else math.ceil(low)
                most = 2**31 - 1 if high > 2**31 - 1 else math.floor(high)
            least_c, most_c = (self._types.literal(x, each) for x in (least, most))
            if output.clamp:
                if each is INT:  # as MIN moves it: towards zero
                    least = math.trunc(max(low, -(2**31)))
                    most = math.trunc(min(high, 2**31 - 1))
                at = [self._types.literal(x, each) for x in (least, most)]
                lines.append(f"if ({value} < {least_c}) {value} = {at[0]};")
                lines.append(f"else if ({value} > {most_c}) {value} = {at[1]};")
            else:
                lines.append(
                    f"if (!({value} >= {least_c} && {value} <= {most_c})) es_fail();"
                )
        return lines or ["(void)command;"]

    def _task(self, wired: Any) -> str:
        task, _, terms, *_ = wired
        first, name = len(self._terms), task.name
        for _, source, age, optional in terms:
            number = [*self._inputs].index(source.name)
            self._terms.append(
                f"{{&es_inputs[{number}], {age}, {_c(optional)}, false}}"
            )
        guarding = any(hasattr(port, "latch") for port in task.ports.values())
        used = {source.name for _, source, *_ in terms}
        used |= {port.output.name for port in task.ports.values()}
        if used & self._unknown:
            return ""
        try:
            in_c(name)
            if guarding:
                self._guard(task, terms, first)
            else:
                self._reaction(task, terms, first)
        except RefusedError as error:
            self._refuse(task.reaction, error)
        pace = 0 if task.reaction.rate is None else task.pace
        react = "NULL" if guarding else f"react_{name}"
        return (
            f"{{{self._turn('0', pace)}, {react}, es_terms + {first}, {len(terms)}, "
            f"ROBOT_REACTION_{name.upper()}, 0, {_c(guarding)}, false, false}}"
        )

    def _turn(self, age: str, pace: int) -> str:
        every = self._loop.every
        slow, due = _c(0 < pace < every), _c(pace >= every)
        return f"{{{age}, {pace}, ES_EVERY, {slow}, {due}}}"

    def _readings(self, terms: Any, first: int) -> dict[str, Value]:
        found = {}
        for number, (key, source, _, optional) in enumerate(terms, first):
            kind = self._inputs[source.name]
            text = f"in_{source.name}"
            if optional:
                kind = self._types.option(kind)
                text = f"({kind.c}){{es_terms[{number}].there, {text}}}"
            found[key] = Value(kind, text, True)
        return found

    def _reaction(self, task: Any, terms: Any, first: int) -> None:
        takes = {
            key: self._outputs[port.output.name] for key, port in task.ports.items()
        }
        functions = Functions(task.reaction, self._types, self._constants, takes)
        readings = self._readings(terms, first)
        args = functions.memory.bound(task.reaction.react, (), readings)
        react = functions.translate([(task.reaction.react, args)])[0]
        result = react.result or NONE
        inner = result.of or result
        several = inner.fields and any(each.of for each in inner.fields)
        lines = [
            f"{'' if result is NONE else f'{result.c} wish = '}{react.called(args)};"
        ]
        commands: list[str] = []
        for key, port in task.ports.items():
            number, name = self._ports.index(port), port.output.name
            self._lines.append(f"static {takes[key].c} said_{number};")
            wish, kind = "wish", result
            if several:
                place = inner.names.index(key)
                wish = f"wish{'.value' if result.of else ''}{inner.field(place)}"
                kind = inner.fields[place] if inner.fields else NONE
            some = "false" if result is NONE else f"{wish}.some" if kind.of else "true"
            if several and result.of:
                some = f"wish.some && {some}"
            commands.append(f"es_ask(&es_ports[{number}], {some});")
            if result is not NONE:
                value = f"{wish}.value" if kind.of else wish
                commands.append(f"if ({some}) said_{number} = fit_{name}({value});")
        self._lines += [
            *functions.lines(),
            *_function(f"react_{task.name}", [*lines, *commands]),
        ]

    def _guard(self, task: Any, terms: Any, first: int) -> None:
        if len(task.ports) > 1:
            raise RefusedError("it guards and has another port: make two of it")
        ((key, port),) = task.ports.items()
        name, reaction = port.output.name, task.reaction
        kind = self._outputs[name]
        functions = Functions(reaction, self._types, self._constants, {key: kind})
        command = Value(kind, f"pass_{name}", True)
        readings = {**self._readings(terms, first), key: command}
        args = functions.memory.bound(reaction.react, (), readings)
        roots = [(reaction.react, args)]
        blind = reaction.blind
        if getattr(blind, "__func__", None) not in _SAYS_NOTHING:
            roots.append((blind, functions.memory.bound(blind, (command,), {})))
        made = functions.translate(roots)
        if made[1:] and made[1].timed:
            raise RefusedError("blind() asks for the time: it has none, only react has")
        self._lines += functions.lines()
        for what, function, given in zip(
            ("react", "blind"), made, (r[1] for r in roots), strict=False
        ):
            result = function.result or NONE
            lines = [
                f"{'' if result is NONE else f'{result.c} wish = '}{function.called(given)};"
            ]
            if result is not NONE:
                test = "if (wish.some) " if result.of else ""
                lines.append(f"{test}let_{name}(wish{'.value' if result.of else ''});")
            self._lines += _function(f"{what}_{task.name}", lines)
        self._blind_of[task.name] = f"blind_{task.name}" if made[1:] else "NULL"

    def _input_row(self, name: str) -> str:
        node = self._loop.inputs[name]
        turn = self._turn("ES_OLD", node.pace)
        return f"{{{turn}, take_{name}, ROBOT_SENSOR_{name.upper()}}}"

    def _port_row(self, port: Any) -> str:
        bar = "ES_NEVER" if math.isinf(port.bar) else str(port.bar)
        if not -30000 <= port.priority <= 30000:
            error = RefusedError("a priority beyond 30000: take a smaller one")
            self._refuse(port.task.reaction, error)
        return (
            f"{{{self._ends_of(port)}, &said_{self._ports.index(port)}, {port.hold}, "
            f"{port.priority}, {bar}, false}}"
        )

    def _guard_row(self, port: Any) -> str:
        name = port.task.name
        return (
            f"{{{self._ends_of(port)}, react_{name}, "
            f"{self._blind_of.get(name, 'NULL')}, {_c(port.latch)}, false}}"
        )

    def _output_row(self, name: str) -> str:
        output = self._loop.outputs[name]
        lessen = (
            f"still_{name}, lessen_{name}, &safe_{name}, &pass_{name}, &last_{name}"
        )
        if not output.guards:
            lessen = f"still_{name}, NULL, &safe_{name}, NULL, NULL"
        outputs = [*self._loop.outputs.values()]
        before = outputs[: outputs.index(output)]
        first = [sum(len(o.ports) for o in before), sum(len(o.guards) for o in before)]
        return (
            f"{{send_{name}, {lessen}, es_ports + {first[0]}, es_guards + {first[1]}, "
            f"{output.hold}, 0, NULL, NULL, NULL, sizeof safe_{name}, {len(output.ports)}, "
            f"{len(output.guards)}, ROBOT_ACTUATOR_{name.upper()}, false, false, false, false}}"
        )

    def _ends_of(self, port: Any) -> str:
        task = self._tasks.index(port.task)
        output = [*self._outputs].index(port.output.name)
        return f"&es_tasks[{task}], &es_outputs[{output}]"


_SAYS_NOTHING = {minimal.Reaction.blind, actions.Reaction.blind}


def _unfit(kind: Type, value: str) -> list[str]:
    """Write what keeps a reading out that is not finite; in a row infinity may be."""
    if kind is REAL:
        return [f"if (!isfinite({value})) return false;"]
    if kind.row is REAL:
        count, test = len(kind.fields), f"if (isnan({value}.v[i])) return false;"
        return [f"for (int i = 0; i < {count}; i++) {test}"]
    found = list[str]()
    for n, each in enumerate(kind.fields):
        field = value + kind.field(n)
        if each is REAL and not kind.names:
            found.append(f"if (isnan({field})) return false;")
        else:
            found += _unfit(each, field)
    return found


def filled(file: str, **values: object) -> str:
    """Return a file of C that lies beside this one, with these values in it."""
    text = importlib.resources.files(__package__).joinpath(file).read_text("utf-8")
    return string.Template(text).substitute(values)


def _code(file: str, **values: object) -> list[str]:
    lines = filled(file, **values).splitlines()
    return [each for each in lines if each.strip() or not each]


def _table(kind: str, rows: Sequence[str]) -> list[str]:
    head = f"static es_{kind} es_{kind}s[ES_{kind.upper()}S] = {{"
    return [head, *(f"    {row}," for row in rows), "};", ""] if rows else []


def _function(name: str, lines: Sequence[str]) -> list[str]:
    return [
        f"static void {name}(void)",
        "{",
        *(f"    {each}" for each in lines),
        "}",
        "",
    ]


def _hints(method: Any) -> dict[str, Any]:
    try:
        return typing.get_type_hints(method)
    except Exception:  # an annotation that only a type checker understands
        return {}


def _c(value: object) -> str:
    return "true" if value else "false"
