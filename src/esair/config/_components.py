"""From the tables of buses, devices and behaviors to their objects.

A key of a component is, in this order, a keyword of its constructor, a setting
that its class declares, or a public attribute of its class that holds plain data
(``speed: float = 0.3``). Anything else is a mistake.
"""

from __future__ import annotations

import ast
import enum
import functools
import inspect
import sys
import textwrap
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import attrs

from esair import abc, minimal
from esair.actions import (
    Behavior,
    Derived,
    Guards,
    Need,
    ProfiledAction,
    Reaction,
    Reads,
    Writes,
    adapt_action,
)
from esair.buses import Bus
from esair.config._classes import BUSES, find_class, searched_first
from esair.config._draft import Draft, Part, Variant
from esair.config._mistakes import Lines, Mistakes, below, dotted, unknown
from esair.config._source import Source
from esair.config._values import INVALID, Field, fields_of, make_of, wanted
from esair.exceptions import BadValueError, ConfigError
from esair.resources import (
    APPLIED,
    Actuator,
    Resource,
    Sensor,
    Setting,
    adapt_resource,
    settings_of,
    wrong_bus,
)
from esair.values import check_name, hints_of, once_for_class, snake_case, value_type


def named_tables(
    source: Source, kind: str, suffix: str = ""
) -> list[tuple[str, dict[str, Any]]]:
    holder = source.data.get(kind, {})
    found: list[tuple[str, dict[str, Any]]] = []
    for name, table in list(holder.items()):
        key = dotted(kind, name)
        good = source.is_name(kind, name.removesuffix(suffix), key)
        if good and isinstance(table, dict):
            found.append((name, table))
            continue
        if good:
            source.wrong(key, f"a table [{kind}.NAME]", table)
        del holder[name]
    return found


def variant_of(
    draft: Draft, key: str, table: Mapping[str, Any], driver: str
) -> Variant:
    real = {name: value for name, value in table.items() if name != "sim"}
    keys = {name: below(key, name) for name in real}
    sim = table.get("sim")
    if "sim" in table and not isinstance(sim, dict):
        draft.source.wrong(f"{key}.sim", "a table of what replaces the real keys", sim)
    if not draft.simulated or not isinstance(sim, dict):
        return Variant(real, keys)
    inherited: frozenset[str] = frozenset()
    if driver in sim:  # another class: it has its own keys, and is on its own bus
        real.pop("bus", None)
        inherited = frozenset(real) - frozenset(sim)
    keys.update({name: below(f"{key}.sim", name) for name in sim})
    return Variant({**real, **sim}, keys, inherited, is_simulated=True)


def class_of(
    draft: Draft, key: str, variant: Variant, field: str, base: type, group: str
) -> type | None:
    """Return the class that a table names, or note why it cannot serve."""
    mistakes = draft.source.mistakes
    if field not in variant.table:
        known = ", ".join(map(repr, BUSES)) if base is Bus else "an installed name"
        mistakes.add(
            key, f"the key {field!r} is missing: expected {known} or 'module:Class'"
        )
        return None
    name = variant.table[field]
    where = variant.keys[field]
    if not isinstance(name, str):
        draft.source.wrong(where, wanted(str), name)
        return None
    found = find_class(
        name,
        where,
        mistakes,
        group=group,
        folder=draft.source.folder,
        kind=(base, _KINDS[base]),
        built_in=BUSES if base is Bus else None,
    )
    if found is None or issubclass(found, (base, _MINIMAL.get(base, base))):
        return found
    mistakes.add(where, f"expected {_KINDS[base]}, {name!r} is {_kind_of(found)}")
    return None


_KINDS: Final[Mapping[type, str]] = {
    Sensor: "a Sensor",
    Actuator: "an Actuator",
    ProfiledAction: "a Behavior or Reaction",
    Bus: "a Bus",
}
_MINIMAL: Final[Mapping[type, type]] = {
    Sensor: minimal.Sensor,
    Actuator: minimal.Actuator,
    ProfiledAction: minimal.Reaction,
}
"""What was written for a microcontroller serves too; it gets an adapter."""

_PLACES: Final[Mapping[type, str]] = {
    Sensor: "[sensor.NAME]",
    Actuator: "[actuator.NAME]",
    ProfiledAction: "[behavior.NAME]",
    Bus: "[bus.NAME]",
}


def _kind_of(cls: type) -> str:
    for base, text in _KINDS.items():
        if issubclass(cls, base):
            return f"{text}: its place is {_PLACES[base]}"
    bases = ", ".join(each.__name__ for each in cls.__bases__)
    return f"none: its bases are {bases}"


_PLAIN: Final = (bool, int, float, str, tuple, frozenset, enum.Enum)
_NONE: Final[Mapping[str, Any]] = {}

# Keys of buses that their classes hand on to the packages behind them: only these are
# known by name, so that a misspelling is found; the rest goes into ``options = { ... }``.
_SERIAL: Final[Mapping[str, Any]] = {
    "bytesize": Literal[5, 6, 7, 8],
    "parity": Literal["N", "E", "O", "M", "S"],
    "stopbits": Literal[1, 2] | float,
    "xonxoff": bool,
    "rtscts": bool,
    "dsrdtr": bool,
}
_CAN: Final[Mapping[str, Any]] = {
    "bitrate": int,
    "data_bitrate": int,
    "fd": bool,
    "receive_own_messages": bool,
    "local_loopback": bool,
}


OPTIONS: Final = "options"
"""The key of a table with keywords for the package behind a class."""


@attrs.frozen
class Accepted:
    """One key that a class accepts."""

    field: Field  # Its type, and whether it must be there
    setting: Setting | None = None
    is_keyword: bool = False  # Of the constructor; else it is set as an attribute


_FURTHER = Accepted(Field(dict[str, Any], required=False))
"""A table of keywords for what is behind the class."""


@once_for_class
def accepted_by(cls: type) -> Mapping[str, Accepted]:
    """Return the keys that a class accepts, by name.

    A constructor with ``**keywords`` is taken to hand them on to the next class,
    one with ``**options`` to hand them on to something else.
    """
    attributes, keywords = _attributes_of(cls), keywords_of(cls)
    found: dict[str, Accepted] = {}
    if issubclass(cls, Resource):
        for name, setting in settings_of(cls).items():
            field = Field(setting.type, required=False)
            found[name] = Accepted(field, setting, keywords.takes_settings)
    for name, kind in attributes.items():
        found.setdefault(name, Accepted(Field(kind, required=False)))
    for name, field in keywords.fields.items():
        known = found.get(name)
        if field.kind is Any and known is not None:
            field = attrs.evolve(field, kind=known.field.kind)
        found[name] = Accepted(field, known.setting if known else None, is_keyword=True)
    if issubclass(cls, minimal.Sensor) and "rate" in found:  # its adapter checks it so
        found["rate"] = attrs.evolve(found["rate"], setting=settings_of(Sensor)["rate"])
    if keywords.takes_options:
        for name, kind in _options_of(cls).items():
            option = Accepted(Field(kind, required=False), is_keyword=True)
            found.setdefault(name, option)
        found[OPTIONS] = _FURTHER
    return found


@attrs.frozen
class Keywords:
    """What the constructor of a class takes."""

    fields: dict[str, Field]
    takes_settings: bool = False  # Whether it takes the settings of a resource too
    takes_options: bool = False  # Whether it takes whatever a package behind it takes


def keywords_of(cls: type) -> Keywords:
    """Return what the constructor of a class takes."""
    found: dict[str, Field] = {}
    given: set[str] = set()
    for holder in cls.__mro__:
        constructor = vars(holder).get("__init__")
        if holder is object or not inspect.isfunction(constructor):
            continue
        hints = hints_of(constructor)
        parameters = list(inspect.signature(constructor).parameters.values())[1:]
        for parameter in parameters:
            if parameter.kind in {
                parameter.POSITIONAL_OR_KEYWORD,
                parameter.KEYWORD_ONLY,
            }:
                kind = hints.get(parameter.name, _type_of(parameter.default))
                required = parameter.default is parameter.empty
                if parameter.name not in given:
                    found.setdefault(parameter.name, Field(kind, required))
        given |= _given_by(constructor)
        if holder is Resource:
            return Keywords(found, takes_settings=True)
        rest = [each.name for each in parameters if each.kind is each.VAR_KEYWORD]
        if rest == [OPTIONS]:
            return Keywords(found, takes_options=True)
        if not rest:
            break
    return Keywords(found)


@functools.lru_cache(maxsize=256)
def _given_by(constructor: Any) -> frozenset[str]:
    """Return the keywords that a constructor gives to the next one by itself."""
    try:
        source = ast.parse(textwrap.dedent(inspect.getsource(constructor)))
    except (OSError, SyntaxError):  # there is none: it was made by attrs, say
        return frozenset()
    return frozenset(
        str(keyword.arg)
        for node in ast.walk(source)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "super().__init__"
        for keyword in node.keywords
    )


def _attributes_of(cls: type) -> dict[str, Any]:
    hints = hints_of(cls)
    found: dict[str, Any] = {}
    for name in [*hints, *(name for holder in cls.__mro__ for name in vars(holder))]:
        if name.startswith("_") or name in found:
            continue
        hint = hints.get(name)
        if hint is typing.ClassVar or typing.get_origin(hint) is typing.ClassVar:
            continue
        value = inspect.getattr_static(cls, name, None)
        if (
            isinstance(value, Setting)
            or inspect.isroutine(value)
            or hasattr(value, "__get__")
        ):
            continue
        if isinstance(hint, typing.TypeVar):
            hint = Any
        if hint is not None:
            found[name] = hint
        elif isinstance(value, _PLAIN) or (
            value is not None and fields_of(type(value))
        ):
            found[name] = _type_of(value)
    return found


def _options_of(cls: type) -> Mapping[str, Any]:
    """Return the types of the further keys that a class of buses takes, by name."""
    names = {
        each.__name__ for each in cls.__mro__ if each.__module__.startswith("esair.")
    }
    if "SerialBus" in names:
        return _SERIAL
    return _CAN if "CanBus" in names else {}


def _type_of(default: object) -> Any:
    """Return the type of values that may stand for a default without a type."""
    if type(default) is int:
        return int | float  # ``speed = 1`` does not mean whole numbers only
    if isinstance(default, _PLAIN) or fields_of(type(default)) is not None:
        return type(default)
    return Any


def construct(
    source: Source,
    cls: type,
    name: str,
    key: str,
    variant: Variant,
    *,
    given: Mapping[str, Any] = _NONE,
    kinds: Mapping[str, Any] = _NONE,  # those that the class itself cannot say
    later: frozenset[str] = frozenset(),  # keys that somebody else takes care of
    make: bool = True,
) -> Any:
    """Make a component from its table, or note every mistake; None if there is one."""
    mistakes, table, keys = source.mistakes, variant.table, variant.keys
    accepted = accepted_by(cls)
    known = {each for each in accepted if each not in {"name", *given}}
    make = make and not any(each.startswith(f"{key}.") for each in mistakes.spoiled)
    before = len(mistakes.errors)
    values: dict[str, Any] = {}
    for field, value in table.items():
        if field in later:
            continue
        if field not in known:
            if field not in variant.inherited:
                wrong = unknown("key", field, known.difference(later))
                mistakes.add(keys[field], wrong)
            continue
        setting = accepted[field].setting
        if setting is not None:
            values[field] = _check_setting(setting, value, keys[field], mistakes)
        else:
            kind = kinds.get(field, Any)
            kind = accepted[field].field.kind if kind is Any else kind
            values[field] = source.convert(value, kind, keys[field])
    for field, accept in accepted.items():
        if accept.field.required and field not in {"name", *given, *table}:
            kind = wanted(accept.field.kind)
            mistakes.add(key, f"the key {field!r} is missing: expected {kind}")
    options: dict[str, Any] = {}
    if accepted.get(OPTIONS) is _FURTHER and OPTIONS in values:
        options = values.pop(OPTIONS)
        for field in options if isinstance(options, dict) else ():
            if field in accepted:
                where = below(keys[OPTIONS], field)
                mistakes.add(where, f"its place is {below(key, field)}")
    if len(mistakes.errors) > before or not make:
        return None
    values |= {**options, **given}
    with searched_first(source.folder):  # a key may name a class, as ``library`` does
        return _make(cls, name, values, accepted, key, mistakes)


def _check_setting(
    setting: Setting, value: object, key: str, mistakes: Mistakes
) -> Any:
    try:
        return setting.check("", value)
    except BadValueError as error:
        mistakes.add(key, str(error).removeprefix(f": {setting.name}: "))
        return INVALID


def _make(
    cls: type,
    name: str,
    values: Mapping[str, Any],
    accepted: Mapping[str, Accepted],
    key: str,
    mistakes: Mistakes,
) -> Any:
    takes_name = "name" in accepted and accepted["name"].is_keyword

    def made_of(**everything: Any) -> Any:
        keywords = {
            field: value
            for field, value in everything.items()
            if field not in accepted or accepted[field].is_keyword
        }
        made = cls(**({"name": name} if takes_name else {}), **keywords)
        if not takes_name and isinstance(made, abc.Component) and made.name != name:
            abc.Component.__init__(made, name=name)  # a constructor that takes no name
        for field, value in everything.items():
            if field not in keywords:
                setattr(made, field, value)
        return made

    def refused(error: BaseException) -> None:
        mistakes.caught(key, error, f"{cls.__name__}(...)")

    return make_of(made_of, values, refused)


FLOWS: Final = ("reads", "writes", "guards")
"""The keys that change the profile of a behavior or reaction."""

_OF_FLOW: Final[Mapping[str, type[Need]]] = {
    "reads": Reads,
    "writes": Writes,
    "guards": Guards,
}


def set_profile(
    action: ProfiledAction | Derived[Any],
    table: Mapping[str, object],
    keys: Mapping[str, str],
    source: Source,
) -> None:
    """Change what an action reads, writes or guards as the file says, or note why not."""
    before = len(source.mistakes.errors)
    given: dict[str, dict[str, Any]] = {flow: {} for flow in FLOWS}
    needs: Mapping[str, Need]
    needs = action.inputs if isinstance(action, Derived) else action.needs
    for attribute, need in needs.items():
        given[_flow_of(need)][attribute] = need
    for flow in FLOWS[:1] if isinstance(action, Derived) else FLOWS:
        if flow not in table:
            continue
        ports = table[flow]
        if not isinstance(ports, dict):
            source.wrong(keys[flow], "a table with a key for each port", ports)
            continue
        for attribute, changes in ports.items():
            where = below(keys[flow], attribute)
            declared = needs.get(attribute)
            if declared is not None and _flow_of(declared) != flow:
                doing = _flow_of(declared)
                told = f"its class declares {attribute!r} the other way round: it {doing} it"
                source.mistakes.add(where, told)
                continue
            changed = _changed(flow, given[flow].get(attribute), changes, where, source)
            if changed is not None:
                given[flow][attribute] = changed
    if len(source.mistakes.errors) > before:
        return
    if isinstance(action, Derived):
        action.set_reads(given["reads"])
        return
    try:
        # Again, and not through the class: its own constructor may not hand them on.
        ProfiledAction.__init__(action, name=action.name, **given)
    except ConfigError as error:
        port = error.field
        flow = next(flow for flow in FLOWS if port in given[flow])
        told = str(error).removeprefix(f"{error.component}: {port}: ")
        source.mistakes.add(below(keys[flow], port), told)


def _flow_of(need: Need) -> str:
    return next(flow for flow, kind in _OF_FLOW.items() if isinstance(need, kind))


def _changed(
    flow: str, declared: Any, changes: object, key: str, source: Source
) -> Need | None:
    if isinstance(changes, str):
        changes = {"name": changes}
    if not isinstance(changes, dict):
        source.wrong(key, "the name of a resource, or a table", changes)
        return None
    known = fields_of(_OF_FLOW[flow]) or {}
    fields = {n: f.kind for n, f in known.items() if n not in {"type", "attribute"}}
    values: dict[str, Any] = {}
    for field, value in changes.items():
        where = below(key, field)
        if field not in fields:
            source.mistakes.add(where, unknown("key", field, fields))
            continue
        result = source.convert(value, fields[field], where)
        if result is INVALID:
            continue
        if field in {"max_age", "hold"} and not result > 0:
            source.wrong(where, f"{wanted(float)} > 0, in seconds", value)
            continue
        if field == "name":
            resource = result.removesuffix(APPLIED)
            if not source.is_name("resource", resource, where):
                continue
        values[field] = result
    if declared is not None:
        changed: Need = attrs.evolve(declared, **values)
        return changed
    return _OF_FLOW[flow](Any, **values)


def make_bus(draft: Draft, name: str, table: Mapping[str, Any]) -> Bus | None:
    key = f"bus.{name}"
    variant = variant_of(draft, key, table, "type")
    cls = class_of(draft, key, variant, "type", Bus, "esair.buses")
    if cls is None:
        return None
    later = frozenset({"type"})
    made: Bus | None = construct(draft.source, cls, name, key, variant, later=later)
    return made


def make_behavior(
    draft: Draft, name: str, table: Mapping[str, Any]
) -> Behavior | Reaction | None:
    key = f"behavior.{name}"
    variant = Variant(dict(table), {field: below(key, field) for field in table})
    cls = class_of(draft, key, variant, "driver", ProfiledAction, "esair.drivers")
    if cls is None:
        return None
    later = frozenset({"driver", *FLOWS})
    made = construct(draft.source, cls, name, key, variant, later=later)
    if made is None:
        return None
    action: Behavior | Reaction = adapt_action(made)
    if not table.keys().isdisjoint(FLOWS):
        set_profile(action, table, variant.keys, draft.source)
    return action


def make_device(
    draft: Draft, key: str, name: str, table: Mapping[str, Any], base: type[Resource]
) -> Part:
    variant = variant_of(draft, key, table, "driver")
    cls = class_of(draft, key, variant, "driver", base, "esair.drivers")
    given: dict[str, Any] = {}
    before = len(draft.source.mistakes.errors)
    bus = _find_bus(draft, key, variant, cls, given)
    has_bus = len(draft.source.mistakes.errors) == before and None not in given.values()
    derived = cls is not None and issubclass(cls, Derived)
    if not derived:  # what is computed is the same in a simulation
        _needs_simulation(draft, key, bus, variant)
    if cls is None:
        return Part(base.__name__.lower(), name, None, bus)
    made: Resource | None = construct(
        draft.source,
        cls,
        name,
        key,
        variant,
        given=given,
        kinds={"safe": _command_type(cls)}
        if base is Actuator
        else {"initial": value_type(cls, Sensor)},
        later=frozenset({"driver", "bus", "reads"} if derived else {"driver", "bus"}),
        make=has_bus,
    )
    if isinstance(made, Derived):
        set_profile(made, variant.table, variant.keys, draft.source)
    return Part(base.__name__.lower(), name, adapt_resource(made), bus)


def _find_bus(
    draft: Draft, key: str, variant: Variant, cls: type | None, given: dict[str, Any]
) -> str | None:
    """Put the bus of a device into what is given to it; return the bus's name."""
    mistakes = draft.source.mistakes
    kind = cls if cls is not None and issubclass(cls, Resource) else None
    if "bus" not in variant.table:
        if kind is not None and wrong_bus(kind, None):
            needed = wanted(hints_of(kind).get("bus", Any))
            told = f"the key 'bus' is missing: expected the name of {needed}"
            mistakes.add(key, told)
        return None
    name, where = variant.table["bus"], variant.keys["bus"]
    buses = draft.buses
    if not isinstance(name, str):
        draft.source.wrong(where, "the name of a bus", name)
    elif name not in buses:
        mistakes.add(where, f"{name!r:.80}: {unknown('bus', name, buses)}")
    else:
        bus = given["bus"] = buses[name]
        if bus is not None and kind is not None and (wrong := wrong_bus(kind, bus)):
            if draft.simulated and not variant.is_simulated:
                wrong += ": give the device sim = { driver = ... } too"
            mistakes.add(where, wrong)
        return str(name)
    return None


def _needs_simulation(
    draft: Draft, key: str, bus_name: str | None, variant: Variant
) -> None:
    """See to it that a simulated robot opens nothing real by an omission."""
    if not draft.simulated:
        return
    if bus_name is not None:
        tables = draft.source.data.get("bus", {})
        if "sim" not in tables.get(bus_name, {}):
            draft.source.mistakes.add(
                f"bus.{bus_name}",
                "nothing stands for this bus in the simulation: expected sim = { ... } "
                "with what replaces the real one (sim = {} if it is harmless as it is)",
            )
    elif not variant.is_simulated:
        draft.source.mistakes.add(
            key,
            "nothing stands for this device in the simulation: expected sim = { driver "
            "= ... } (sim = {} if it is harmless as it is)",
        )


def _command_type(cls: type) -> Any:
    declared = value_type(cls, Actuator)
    if declared is Any and hasattr(cls, "safe"):
        return type(cls.safe)
    return declared


_BASES = (
    ("sensor", (Sensor, minimal.Sensor)),
    ("actuator", (Actuator, minimal.Actuator)),
    ("behavior", (ProfiledAction, minimal.Reaction)),
)


def is_imported(driver: str) -> bool:
    """Tell whether the module of a class is there."""
    return driver.partition(":")[0] in sys.modules


def find_module(driver: str, folder: Path) -> None:
    """Import the module of a class; if it cannot be, `make_component` tells why."""
    find_class(
        driver, "", Mistakes("", Lines("")), group="esair.drivers", folder=folder
    )


def make_component(
    driver: str, values: Mapping[str, Any], buses: Iterable[Bus], folder: Path
) -> Resource | Behavior | Reaction:
    """Make a component as a table of a file would.

    Args:
        driver: Its class, ``module:Class``.
        values: The values of its keys; ``name`` is its name, that of the class unless
            given.
        buses: The buses that it may be on, by their names.
        folder: Where its module is found, beside those that are installed.

    Raises:
        ConfigError: There is no such class, or a key is wrong.
        ExceptionGroup: Several are.
    """
    mistakes = Mistakes(driver, Lines(""))
    cls = find_class(driver, "", mistakes, group="esair.drivers", folder=folder)
    kind = next((k for k, bases in _BASES if cls and issubclass(cls, bases)), None)
    if cls is not None and kind is None:
        mistakes.add("", "expected a Sensor, an Actuator, a Behavior or a Reaction")
    made: Resource | Behavior | Reaction | None = None
    if cls is not None and kind is not None:
        table = {"driver": driver, **values}
        name = check_name(kind, table.pop("name", snake_case(cls.__name__)))
        source = Source(folder / "typed", "", "", {kind: {name: table}}, mistakes)
        draft = Draft(source, simulated=False)
        draft.parts += [Part("bus", each.name, each) for each in buses]
        if kind == "behavior":
            made = make_behavior(draft, name, table)
        else:
            base = Sensor if kind == "sensor" else Actuator
            made = make_device(draft, f"{kind}.{name}", name, table, base).made
    if len(mistakes.errors) == 1:
        raise mistakes.errors[0]
    mistakes.raise_all()
    if made is None:
        raise ConfigError(driver, "", "it cannot be made")
    return made
