"""What one component declares: is it sound, whatever the robot?

Can its methods be called as they will be, are its values of the right kinds, do they fit? Can
it live in a process of its own? There it is made of a class by name, and what that is
constructed with; never of a copy: what a component that runs knows of its robot must not cross.
"""

from __future__ import annotations

import ast
import dis
import enum
import inspect
import os
import sys
import types
import typing
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, Final

from esair.abc import Component, made_of
from esair.actions import (
    Behavior,
    Derived,
    Guards,
    MinimalReaction,
    Need,
    Reaction,
    Reads,
    Takes,
    ThreadBehavior,
    Writes,
    declared_requests,
    guards,
    is_request,
    reads,
    takes,
    writes,
)
from esair.codec import CodecError, Kinds, declared, encode, inner_of
from esair.connections import (
    CommandCheck,
    ReadingCheck,
    kind_of,
    limits_by_field,
    part_of,
)
from esair.exceptions import BadValueError, ConfigError, describe
from esair.flaws import fields_of
from esair.messages import Reading, Restart, Stamped, placement_of
from esair.plan._plan import Finding, mistake, warning
from esair.resources import (
    HOLD,
    Actuator,
    Sensor,
    Setting,
    flaws_of,
    operations_of,
    setting,
    settings_of,
    wrong_bus,
    wrong_operations,
)
from esair.values import (
    check_name,
    checked_class,
    hints_of,
    is_positive,
    once_for_class,
    same_type,
    type_name,
)

_BEHAVIOR = ("setup", "run", "teardown", "provide")


def wrong_signatures(
    resource: Sensor[Any] | Actuator[Any],
) -> Iterator[tuple[str, str]]:
    """Yield each method of a resource that cannot be called, and what was expected."""
    yield from _wrong_methods(resource, ("open", "close", "identify"))
    changes = dict.fromkeys(settings_of(type(resource)))
    if told := _cannot(resource.apply, **changes):
        yield "apply", f"expected a method that takes its settings by name: {told}"
    if isinstance(resource, Actuator):
        takes = "with one parameter, the command"
        yield from _wrong_methods(resource, ("write",), None, takes=takes)
        return
    if resource.can_be_asked:
        returns = "returns one value: name it stream"
        yield from _wrong_methods(resource, ("read",), returns=returns)
    if resource.pushes:
        if told := _cannot(resource.stream):
            yield "stream", f"expected a method without parameters: {told}"
        elif inspect.iscoroutinefunction(resource.stream):
            yield "stream", "expected a method that yields its values"


def _wrong_methods(
    component: object,
    fields: Iterable[str],
    *values: object,
    takes: str = "without parameters",
    returns: str = "does not yield",
) -> Iterator[tuple[str, str]]:
    for field in fields:
        method = getattr(component, field)
        if told := _cannot(method, *values):
            yield field, f"expected a method {takes}: {told}"
        elif yields(method):
            yield field, f"expected a method that {returns}"


def wrong_react(reaction: Reaction) -> Iterator[str]:
    """Yield what is wrong with ``react``: its kind, its parameters, their types."""
    if getattr(reaction.react, "__func__", None) is Reaction.react:
        yield "a reaction must have a react method"
    else:
        kind = "readings and the command" if reaction.guarded else "readings"
        yield from _wrong_step(reaction.react, _given(reaction), kind)


def wrong_compute(derived: Derived[Any]) -> Iterator[str]:
    """Yield what is wrong with ``compute``: its kind, its parameters, their types."""
    if getattr(derived.compute, "__func__", None) is Derived.compute:
        yield "a derived sensor must have a compute method"
        return
    wrong = list(_wrong_step(derived.compute, derived.inputs, "readings"))
    yield from wrong or _mistyped(derived.compute, derived.inputs)


def _wrong_step(
    step: Callable[..., Any], given: Mapping[str, Need], kind: str
) -> Iterator[str]:
    if inspect.iscoroutinefunction(step):
        yield "expected a plain function, not async"
    elif yields(step):
        yield "expected a plain function that does not yield"
    elif told := _cannot(step, **dict.fromkeys(given)):
        names = ", ".join(given) or "none"
        yield f"its parameters must be its {kind} ({names}): {told}"


def wrong_blind(guard: Reaction, port: str) -> str | None:
    """Say what is wrong with the ``blind`` of a guard."""
    if inspect.iscoroutinefunction(guard.blind):
        return "expected a plain function"
    if told := _cannot(guard.blind, **{port: None}):
        return f"its parameter must be the command ({port}): {told}"
    return None


def _given(reaction: Reaction) -> dict[str, Need]:
    """Return the ports that give ``react`` its parameters."""
    return {
        name: need
        for name, need in reaction.needs.items()
        if not isinstance(need, Writes)
    }


def _mistyped(step: Callable[..., Any], given: Mapping[str, Need]) -> Iterator[str]:
    hints = hints_of(inspect.unwrap(step))
    for name, need in given.items():
        hint = hints.get(name, Any)
        if typing.get_origin(hint) is typing.Annotated:
            hint = typing.get_args(hint)[0]
        if not same_type(need.type, _value_of(hint)):
            doing = "reads" if isinstance(need, Reads) else "guards"
            yield (
                f"its parameter {name!r} is a {_text(hint)}, but the port {name!r} "
                f"{doing} {type_name(need.type)}: annotate it as {type_name(need.type)}"
            )


def _value_of(hint: Any) -> Any:
    """Return the type of the value in ``T | None``, or ``Reading[T]``."""
    if typing.get_origin(hint) in {typing.Union, types.UnionType}:
        parts = tuple(_value_of(part) for part in typing.get_args(hint))
        return typing.Union[parts]  # noqa: UP007 - the parts are known now only
    if typing.get_origin(hint) is Reading:
        return typing.get_args(hint)[0]
    return Any if hint is Reading or isinstance(hint, typing.TypeVar) else hint


def _text(hint: Any) -> str:
    return type_name(hint) if inspect.isclass(hint) else str(hint).replace("esair.", "")


def yields(method: Callable[..., Any]) -> bool:
    """Tell whether a method is a generator, and so would do nothing when called."""
    return inspect.isgeneratorfunction(method) or inspect.isasyncgenfunction(method)


def _cannot(
    method: Callable[..., Any], /, *values: object, **named: object
) -> str | None:
    """Say why a method cannot be called so; None if it can, or if nobody knows."""
    try:
        signature = inspect.signature(method)
    except ValueError:  # else of a class written in C, say
        return "it does not take self" if inspect.ismethod(method) else None
    except TypeError as error:
        return str(error)
    try:
        signature.bind(*values, **named)
    except TypeError as error:
        return str(error)
    return None


_FASTEST = 100_000.0  # The highest rate of a reaction, in Hz


def mistakes_in_action(action: Behavior | Reaction) -> Iterator[Finding]:
    """Find what is wrong with the class of an action, or with its values."""
    for field, told in _in_action(action):
        yield mistake("declaration", action, field, told)


def idle(action: Behavior | Reaction) -> Iterator[Finding]:
    """Find a class that says nothing of what it does: the name is mistyped, maybe."""
    of, base = type(action), Behavior
    if isinstance(action, ThreadBehavior):
        base = ThreadBehavior
    if of is base or not issubclass(of, base) or hasattr(of, "react"):
        return
    own = any(getattr(of, each) is not getattr(base, each) for each in _BEHAVIOR)
    if not own and not declared_requests(of):
        told = "it does nothing: its class has no run, and answers nothing"
        yield warning("declaration", action, "run", told)


def mistyped(reaction: Reaction) -> Iterator[Finding]:
    """Find parameters of ``react`` whose annotations do not fit the ports."""
    if not isinstance(reaction, MinimalReaction):  # its types are for readers only
        for told in _mistyped(reaction.react, _given(reaction)):
            yield mistake("declaration", reaction, "react", told)


def _in_instance(component: Component) -> Iterator[tuple[str, str]]:
    """Yield each port that only an object has: nothing is registered for it."""
    for attribute, value in vars(component).items():
        if isinstance(value, Reads | Writes | Takes):
            told = "a port is an attribute of the class: write it there, not in "
            told += "__init__"
            if not isinstance(value, Takes):
                told += ", or give it to super().__init__(reads={...}, writes={...})"
            yield attribute, told


@once_for_class
def _computed(cls: type[Component]) -> list[str]:
    """Return what the rules ask of a component that its class computes by a property."""
    bases = (Sensor, Actuator, Behavior, Reaction)
    base = next((each for each in bases if issubclass(cls, each)), cls)
    computed = inspect.getmembers_static(cls, lambda value: isinstance(value, property))
    esairs = {**hints_of(base), **dict(inspect.getmembers_static(base))}
    later = {"can_tell_set_up", "counted", "counts", "is_set_up"}  # of an open device
    later |= {"elapsed_ms", "now_ms", "supervisor"}  # of a running robot
    asked = {n for n, each in computed if esairs.get(n, each) is not each}
    return sorted(asked - later)


def raising(component: object) -> Finding | None:
    """Find a property that raises: nothing else can be told of the component then."""
    fields = _computed(type(component)) if isinstance(component, Component) else ()
    for field in fields:
        try:
            getattr(component, field)
        except Exception as error:
            told = f"expected a value, its property raises {describe(error)}"
            return mistake("declaration", component, field, told)
    return None


@once_for_class
def _in_class(cls: type[Component]) -> list[tuple[str, str]]:
    """Return each declaration that a class of this kind does not take, and why."""
    if not issubclass(cls, Behavior):
        found = [(n, "only a behavior takes requests") for n in declared_requests(cls)]
    else:
        found = list(_wrong_requests(cls))
    if issubclass(cls, Behavior | Reaction):
        only = "only a sensor or an actuator has"
        told = (
            f"{only} settings: an attribute of an action is plain: speed: float = 0.3"
        )
        found += ((name, told) for name in settings_of(cls))
        told = f"{only} operations: a behavior answers requests: esair.answers"
        found += ((name, told) for name in operations_of(cls))
    elif not issubclass(cls, Derived):
        told = (
            "only a behavior, a reaction or a derived sensor (esair.Derived) has ports"
        )
        ports = inspect.getmembers_static(cls, lambda v: isinstance(v, Reads | Writes))
        found += ((name, told) for name, _ in ports)
    makers = (reads, writes, guards, takes, setting)
    for name, value in inspect.getmembers_static(cls):
        found += (
            (name, f"expected esair.{each.__name__}(...), not the function")
            for each in makers
            if value is each
        )
    told = "an annotation declares nothing: write = instead of :"
    declares = (Reads, Writes, Guards, Takes, Setting)
    found += ((n, told) for n, h in hints_of(cls).items() if isinstance(h, declares))
    return [*found, *_hidden(cls)]


def _hidden(cls: type[Component]) -> Iterator[tuple[str, str]]:
    """Yield each port that a method assigns to: nobody would find it any more."""
    members = inspect.getmembers_static(cls)
    ports = {n for n, v in members if isinstance(v, Reads | Writes | Guards | Takes)}
    for method, function in members:
        code = getattr(function, "__code__", None)
        if code is None or not code.co_argcount or ports.isdisjoint(code.co_names):
            continue
        before = ""
        for each in dis.get_instructions(code):
            itself = before.rpartition(", ")[2] == code.co_varnames[0]
            if each.opname == "STORE_ATTR" and itself and each.argval in ports:
                told = f"{method} hides the port by self.{each.argval} = ...: "
                how = "return it" if hasattr(cls, "react") else "use its write(...)"
                told += f"to send a command {how}, to keep a value choose another name"
                yield each.argval, told
            before = each.argrepr


def _in_action(action: Behavior | Reaction) -> Iterator[tuple[str, str]]:
    yield from _in_instance(action)
    yield from _in_class(type(action))
    for attribute, need in action.needs.items():
        yield from wrong_port(attribute, need)
        if isinstance(action, Behavior):
            if isinstance(need, Guards):
                yield attribute, "only a reaction guards: make one of it"
            elif getattr(need, "every", False):
                told = "only a reaction runs on every reading; here the newest wins"
                yield f"{attribute}.every", told
    if isinstance(action, Reaction):
        yield from _in_plain(action, _OF_REACTION)
        yield from _in_reaction(action)
    else:
        yield from _in_plain(action, _OF_BEHAVIOR)
        of = type(action)
        for method in _BEHAVIOR:
            if getattr(of, method) is not getattr(Behavior, method):
                yield from _wrong_methods(action, (method,))
        is_inherited = of.run is Behavior.run or of.run is ThreadBehavior.run
        is_step = inspect.isfunction(getattr(of, "react", None))
        if is_step and is_inherited and "react" not in declared_requests(of):
            yield "react", "it never runs: derive from esair.Reaction, or write run"
        if isinstance(action, ThreadBehavior) and inspect.iscoroutinefunction(of.run):
            yield "run", "expected a plain function, not async: it runs in a thread"
    if not isinstance(action.restart, Restart):
        yield "restart", "expected an esair.Restart"


def wrong_port(attribute: str, need: Need) -> Iterator[tuple[str, str]]:
    """Yield each field of a declared port that is wrong, and what was expected."""
    try:
        check_name("resource", need.provider)
    except ConfigError as error:
        yield attribute, str(error)
    if need.type is None or isinstance(need.type, str | bytes | int | float):
        yield (
            attribute,
            f"expected a type such as float, not {need.type!r:.80} "
            "(a name is given by name=)",
        )
    for field, told in _in_plain(need, _OF_PORT):
        yield f"{attribute}.{field}", told


def _in_reaction(reaction: Reaction) -> Iterator[tuple[str, str]]:
    guards = [key for key, need in reaction.needs.items() if isinstance(need, Guards)]
    if len(guards) > 1 or (guards and reaction.outputs):
        others = ", ".join([*guards[1:], *reaction.outputs])
        told = "a guard guards one actuator and writes none"
        yield guards[0], f"{told}: make {others} part of another reaction"
    known: dict[tuple[str, int], str] = {}
    for attribute, need in reaction.outputs.items():
        first = known.setdefault((need.resource, need.priority), attribute)
        if first != attribute:
            told = f"it writes {need.resource!r} by {first!r} already: "
            yield attribute, told + "one port is enough, unless their priorities differ"
    if reaction.rate is None and not reaction.inputs and not guards:
        yield "rate", "it reads no sensor, so it needs a rate (Hz) to run at"
    for told in wrong_react(reaction):
        yield "react", told
    if guards and (wrong := wrong_blind(reaction, guards[0])):
        yield "blind", wrong


def _wrong_requests(cls: type[Behavior]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the requests that a behavior takes."""
    by_type: dict[Any, str] = {}
    for attribute, each in declared_requests(cls).items():
        if isinstance(each, str):
            yield attribute, each
        elif not is_request(each.type):
            told = f"expected a class derived from esair.Request, not {each.type!r:.80}"
            yield attribute, told
        elif type(each.queue) is not int or each.queue < 1:
            yield attribute, f"expected a queue of 1 or more, not {each.queue!r:.80}"
        elif type(each.newest) is not bool:
            told = f"expected newest=True or False, not {each.newest!r:.80}"
            yield attribute, told
        elif each.type in by_type:
            told = f"{each.type.__name__} is taken by {by_type[each.type]!r} already"
            yield attribute, told
        else:
            by_type[each.type] = attribute


def wrong_derived(derived: Derived[Any]) -> Iterator[tuple[str, str]]:
    """Yield each field of a derived sensor that is wrong, and what was expected."""
    yield from _in_instance(derived)
    for attribute, need in derived.inputs.items():
        yield from wrong_port(attribute, need)
        if need.configure:
            told = "what is computed of a sensor does not change its settings"
            yield f"{attribute}.configure", told
    if not derived.inputs:
        yield "", "it is computed of nothing: declare what with esair.reads"
    if derived.can_be_asked or derived.pushes or hasattr(derived, "initial"):
        told = "a derived sensor has no read, stream or initial value: write compute"
        yield "compute", told
    if derived.bus is not None:
        yield "bus", "it is computed, and is on no bus"
    if inspect.iscoroutinefunction(derived.open):
        yield "open", "expected a plain function, not async"
    yield from _in_plain(derived, _OF_DERIVED)
    for name in derived.operations:
        if not inspect.iscoroutinefunction(getattr(derived, name)):
            told = "expected async def: a thread would meet compute at work"
            yield name, told
    for told in wrong_compute(derived):
        yield "compute", told


def mistakes_in_resource(resource: Sensor[Any] | Actuator[Any]) -> Iterator[Finding]:
    """Find what is wrong with the class of a resource, or with its values."""
    for field, told in _in_resource(resource):
        yield mistake("declaration", resource, field, told)
    if isinstance(resource, Actuator):
        if resource.blocking:
            yield from _blocks_safe(resource)
        yield from _slews_from_nowhere(resource)


def _in_resource(
    resource: Sensor[Any] | Actuator[Any],
) -> Iterator[tuple[str, str]]:
    yield from _in_plain(resource, _OF_RESOURCE)
    yield from _in_limits(resource)
    yield from flaws_of(type(resource))
    if resource.identity is not None and not resource.identifies:
        yield "identity", "its class has no identify to compare it with"
    if wrong_one := wrong_bus(type(resource), resource.bus):
        yield "bus", wrong_one
    if isinstance(resource, Actuator):
        yield from _in_actuator(resource)
        if getattr(resource.write, "__func__", None) is Actuator.write:
            yield "write", "an actuator must have a write method"
    elif isinstance(resource, Derived):
        yield from wrong_derived(resource)
    else:
        if not (resource.can_be_asked or resource.pushes):
            yield "read", "a sensor must have a read or stream method"
        yield from _in_initial(resource)
    yield from wrong_signatures(resource)
    yield from wrong_operations(type(resource))
    yield from _in_class(type(resource))


def _blocks_safe(actuator: Actuator[Any]) -> Iterator[Finding]:
    """Find plain operations that keep the safe command waiting for too long."""
    for name, each in actuator.operations.items():
        limit = actuator.deadline if each.deadline is None else each.deadline
        plain = not inspect.iscoroutinefunction(getattr(actuator, name))
        if plain and is_positive(limit) and limit > actuator.deadline:
            told = (
                f"it blocks its thread for up to {limit:g} s, and the safe "
                "command waits behind it"
            )
            advice = "write it as async def, or let it only begin what the device does"
            yield warning("time", actuator, name, told, advice)


_NOTHING = None, "None"
"""How a method says that it returns nothing."""


def _slews_from_nowhere(actuator: Actuator[Any]) -> Iterator[Finding]:
    """Find who bounds changes and never says from where the first one goes."""
    returns = getattr(actuator.write, "__annotations__", {}).get("return", "")
    stays = getattr(actuator, "safe", None) is HOLD
    if actuator.slew is not None and stays and returns in _NOTHING:
        told = "its first command after each opening is not bounded: nobody knows from where"
        advice = "return the place from write when it is told esair.HOLD"
        yield warning("protect", actuator, "slew", told, advice)


def _in_actuator(actuator: Actuator[Any]) -> Iterator[tuple[str, str]]:
    if not hasattr(actuator, "safe"):
        yield "safe", "an actuator must declare its safe command: safe = ..."
        return
    wrong_slew = [*_in_slew(actuator)]
    yield from wrong_slew
    if (
        actuator.safe is HOLD
        or wrong_slew
        or any(_in_plain(actuator, _OF_RESOURCE))
        or any(_in_limits(actuator))
    ):
        return
    field = "safe"
    try:
        check = CommandCheck(actuator)
        safe = check.checked(actuator.safe)
        field = "slew"
        check.slewed(safe, actuator.safe, 1.0)
    except (BadValueError, TypeError) as error:
        yield field, f"does not fit: {error}"


def _in_initial(sensor: Sensor[Any]) -> Iterator[tuple[str, str]]:
    """Find what a sensor says at its opening, and nobody would ever hear."""
    if hasattr(sensor, "initial") and not any(_in_limits(sensor)):
        value = sensor.initial
        if type(value) is Stamped:
            value = value.value
        wrong = ReadingCheck(sensor).wrong(value)
        if wrong is not None:
            yield "initial", f"it is no reading of this sensor: {wrong}"


def _in_slew(actuator: Actuator[Any]) -> Iterator[tuple[str, str]]:
    for field, slew in limits_by_field(actuator.slew).items():
        if not is_positive(slew):
            told = f"expected a change per second > 0, not {slew!r:.80}"
            yield f"slew.{field}".rstrip("."), told
        kind = kind_of(actuator, field)
        if isinstance(kind, type) and issubclass(kind, enum.Enum):
            told = f"{kind.__name__} has no steps between its members: leave it out"
            yield f"slew.{field}".rstrip("."), told


_Plain = tuple[tuple[str, bool, str, Any], ...]


def _plain(*rows: tuple[str, Any, str]) -> _Plain:
    """Say what is expected of some fields, by which test or type; ? where None is good."""
    return tuple(
        (field.rstrip("?"), field.endswith("?"), wanted, is_one)
        for wanted, is_one, fields in rows
        for field in fields.split()
    )


def _in_plain(declared: object, table: _Plain) -> Iterator[tuple[str, str]]:
    """Yield each plain value of a component or a port that is none of its kind."""
    for field, may_lack, wanted, is_one in table:
        value = getattr(declared, field, _NONE_HERE)
        if value is _NONE_HERE or (may_lack and value is None):
            continue
        if not (
            value.__class__ is is_one
            or (is_one.__class__ is not type and is_one(value))
        ):
            yield field, f"expected {wanted}, not {value!r:.80}"


def plain_mistakes(values: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Find what attributes that every device has cannot be, by their names."""
    yield from _in_plain(types.SimpleNamespace(**values), _OF_RESOURCE)


_NONE_HERE = object()


def _is_count(value: Any) -> bool:
    return type(value) is int and value > 0


_OF_RESOURCE = _plain(
    ("seconds > 0", is_positive, "deadline set_up_period command_timeout"),
    ("seconds > 0 or None", is_positive, "own_timeout? period?"),
    ("a whole number > 0", _is_count, "fault_limit history_size max_repeat?"),
    ("bytes >= 0", lambda value: type(value) is int and value >= 0, "traffic"),
    ("True or False", bool, "required blocking clamp safe_moves"),
)
_OF_DERIVED = _plain(("seconds > 0", is_positive, "budget?"))
_OF_REACTION = _plain(
    (
        f"Hz > 0, at most {_FASTEST:.0f}",
        lambda value: is_positive(value) and value <= _FASTEST,
        "rate?",
    ),
    ("seconds > 0", is_positive, "budget?"),
    ("seconds >= 0", lambda value: value == 0 or is_positive(value), "mute_limit"),
    ("a whole number", lambda n: type(n) is int and n >= 0, "overrun_limit?"),
)
_POLICIES = ("reject", "drop_oldest", "latest")
_OF_BEHAVIOR = _plain(
    ("a whole number > 0", _is_count, "inbox_size outbox_size"),
    (
        "'reject', 'drop_oldest' or 'latest'",
        _POLICIES.__contains__,
        "inbox_policy outbox_policy",
    ),
)
_OF_PORT = _plain(
    ("seconds > 0", is_positive, "max_age? hold?"),
    ("a whole number", int, "priority"),
    ("'safe' or 'release'", ("safe", "release").__contains__, "blind?"),
    ("True or False", bool, "configure every optional latch"),
)


def _in_limits(resource: Sensor[Any] | Actuator[Any]) -> Iterator[tuple[str, str]]:
    safe = getattr(resource, "safe", HOLD)
    for field, bounds in limits_by_field(resource.limits).items():
        try:
            part = None if safe is HOLD else part_of(safe, field)
        except (AttributeError, LookupError):
            yield f"limits.{field}", f"{safe!r:.80} has no such field"
            continue
        if safe is HOLD and (told := _not_limited(resource.value_type, field, bounds)):
            yield f"limits.{field}".rstrip("."), told
            continue
        try:
            low, high = bounds
            told = "" if low <= high else f"not {bounds!r:.80}"
        except (TypeError, ValueError):
            told = f"not {bounds!r:.80}"
        if told:
            yield f"limits.{field}".rstrip("."), f"expected (least, greatest), {told}"
            continue
        try:
            if part is not None and not low <= part <= high:
                yield "safe", f"{safe!r} is outside the limits"
        except (TypeError, ValueError):  # several numbers, maybe an array of NumPy
            told = f"expected a pair for each field of {part!r:.80}, not {bounds!r:.80}"
            yield f"limits.{field}".rstrip("."), told


def _not_limited(kind: Any, field: str, bounds: object) -> str:
    """Say why values of a type cannot have these limits, as far as the type tells."""
    cls = checked_class(kind)
    if cls is None or (field and issubclass(cls, Mapping)):
        return ""
    if not field:
        unordered = inspect.getattr_static(cls, "__ge__") is vars(object)["__ge__"]
        each = f"a pair for each field of {type_name(cls)}"
        is_whole = unordered or issubclass(cls, Collection)  # compares with no number
        return f"expected {each}, not {bounds!r:.80}" if is_whole else ""
    fields = fields_of(cls)
    if field in fields or field in hints_of(cls) or hasattr(cls, field):
        return ""
    # Else its instances alone know what they have.
    has_told = fields or cls.__module__ == "builtins"
    return f"{type_name(cls)} has no such field" if has_told else ""


SCRIPT: Final = "__main__"


def unplaceable(component: Any) -> Iterator[Finding]:
    """Find why a component cannot live in a process of its own, if it shall."""
    place = getattr(component, "placement", None)
    if place is None or place == "task":
        return
    found = _reason(component)
    if found is not None:
        field, wrong, advice = found
        yield mistake("placement", component, field, wrong, advice)


def recipe_of(component: Any) -> dict[str, Any]:
    """Return what a child makes this component of; ``args`` and ``options`` are values."""
    inner = inner_of(component)
    kind = type(inner)
    args: tuple[Any, ...] = ()
    options: dict[str, Any] | None = None
    if isinstance(inner, Component):
        args, options = made_of(inner)
    module = sys.modules.get(kind.__module__)
    return {
        "module": kind.__module__,
        "class": kind.__qualname__,
        "args": args,
        "options": options,
        "fields": dict(vars(inner)) if options is None else {},
        "name": component.name,
        # It may have come from a file that no path leads to.
        "file": getattr(module, "__file__", None),
        # What the script is of a package: python -m package.module
        "within": getattr(getattr(module, "__spec__", None), "name", SCRIPT),
    }


def _reason(component: Any) -> tuple[str, str, str] | None:
    """Return which field is wrong, why, and what to do."""
    try:
        placement_of(component.placement)
    except ValueError as error:
        return "placement", str(error), ""
    if isinstance(component, Actuator):
        return (
            "placement",
            "an actuator stays in the robot's process, where its safe command is",
            "place what decides, or what is read",
        )
    if getattr(component, "is_computed", False):
        return "placement", "what is computed of readings stays with them", ""
    if isinstance(component, Reaction) and component.guarded is not None:
        return (
            "placement",
            "a guard stays in the robot's process: commands cannot wait for another",
            "place what it reads as a sensor, or write it as a reaction",
        )
    if isinstance(component, Sensor) and component.bus is not None:
        return (
            "bus",
            f"its bus {component.bus.name!r} has one owner, the robot's process",
            "let the driver open its own device, or place what reads it",
        )
    if not isinstance(component, Behavior | Reaction | Sensor):
        return None
    return _unnamed(component) or _unsendable(component) or _impossible()


def _impossible() -> tuple[str, str, str] | None:
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (AttributeError, OSError) as error:  # another system; an old container
        told = f"this computer cannot watch a process of its own: {describe(error)}"
        return "placement", told, "it takes Linux 5.3, and pidfd_open"
    return None


def _unnamed(component: Any) -> tuple[str, str, str] | None:
    recipe = recipe_of(component)
    module, path = recipe["module"], recipe["class"]
    found: Any = sys.modules.get(module)
    for part in path.split("."):
        found = getattr(found, part, None)
    inner = inner_of(component)
    if found is not type(inner):
        advice = "define it at the top of a module"
        return "placement", f"its class cannot be imported as {module}:{path}", advice
    no_file = (recipe["file"] or ">")[-1] == ">"  # such as <stdin>
    if no_file and recipe["within"] == SCRIPT:  # nor does an importer know of it
        return "placement", "its class is in no file", "put it into a module"
    return _of_script(path.partition(".")[0]) if module == SCRIPT else None


def _of_script(name: str) -> tuple[str, str, str] | None:
    """Return why a child has no such class of the script, as far as its text tells."""
    try:
        text = ast.parse(inspect.getsource(sys.modules[SCRIPT]))
    except (OSError, TypeError, SyntaxError):
        return None
    if not _asks(text):
        advice = "put what runs under if __name__ == '__main__':"
        return "placement", "a child imports the script, and would run it", advice
    made = [each for each in ast.walk(text) if getattr(each, "name", "") == name]
    runs = [each for each in text.body if isinstance(each, ast.If) and _asks(each.test)]
    inside = [each for run in runs for each in run.body if each in made]
    if made and made == inside:
        advice = "define it above if __name__ == '__main__':"
        return "placement", "a child imports the script without this class", advice
    return None


def _asks(text: ast.AST) -> bool:
    """Whether a part of the script asks if it is the one that is run."""
    told = ast.walk(text)
    return any(isinstance(each, ast.Constant) and each.value == SCRIPT for each in told)


def _unsendable(component: Any) -> tuple[str, str, str] | None:
    recipe = recipe_of(component)
    if not (recipe["args"] or recipe["options"] or recipe["fields"]):
        return None
    try:
        kinds = Kinds(declared(type(inner_of(component))))
        encode((recipe["args"], recipe["options"], recipe["fields"]), kinds)
    except CodecError as error:
        what = error.path.partition("]")[2].removeprefix(".") or "what it is made of"
        advice = "give plain data, and make the rest of it in setup or open"
        return (
            "placement",
            f"{what} cannot be sent to a process: {error.reason}",
            advice,
        )
    return None
