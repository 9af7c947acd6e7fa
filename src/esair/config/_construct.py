"""From a table of a file to an object: keywords, settings, attributes.

A key of a component is, in this order, a keyword of its constructor, a setting
that its class declares, or a public attribute of its class that holds plain data
(``speed: float = 0.3``). Anything else is a mistake.
"""

from __future__ import annotations

import enum
import inspect
import typing
from collections.abc import Mapping
from typing import Any, Final, Literal

import attrs

from esair import abc
from esair.config._classes import searched_first
from esair.config._draft import Variant
from esair.config._mistakes import Mistakes, below, unknown
from esair.config._records import Field, fields_of, make_of
from esair.config._source import Source
from esair.config._values import INVALID, wanted
from esair.exceptions import BadValueError
from esair.resources import Resource, Setting, settings_of
from esair.values import hints_of, once_for_class

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
                kind = hints.get(parameter.name, _kind_of(parameter.default))
                required = parameter.default is parameter.empty
                found.setdefault(parameter.name, Field(kind, required))
        if holder is Resource:
            return Keywords(found, takes_settings=True)
        rest = [each.name for each in parameters if each.kind is each.VAR_KEYWORD]
        if rest == [OPTIONS]:
            return Keywords(found, takes_options=True)
        if not rest:
            break
    return Keywords(found)


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
            found[name] = _kind_of(value)
    return found


def _options_of(cls: type) -> Mapping[str, Any]:
    """Return the types of the further keys that a class of buses takes, by name."""
    names = {
        each.__name__ for each in cls.__mro__ if each.__module__.startswith("esair.")
    }
    if "SerialBus" in names:
        return _SERIAL
    return _CAN if "CanBus" in names else {}


def _kind_of(default: object) -> Any:
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
            kind = kinds.get(field, accepted[field].field.kind)
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
