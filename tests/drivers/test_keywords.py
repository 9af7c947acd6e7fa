"""What type checkers know of a constructor's keywords is what it takes."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing
from typing import Any

import pytest

import esair
import esair.buses
import esair.drivers
from esair.config._components import accepted_by
from esair.drivers.ads1115 import Ads1115
from esair.drivers.line import LineActuator
from esair.exceptions import BadValueError
from esair.resources import (
    ActuatorSettings,
    Resource,
    ResourceSettings,
    SensorSettings,
    settings_of,
)

DRIVERS = esair.drivers.__path__

NAMES = {"Bus": esair.buses.Bus}
"""What the code imports for type checkers only."""

Keywords = dict[str, tuple[Any, bool]]
"""The type of each keyword, and whether it must be there."""


def parts() -> list[type[Resource]]:
    """The classes of `esair.drivers` that robots are made of."""
    found: dict[type[Resource], None] = {}
    for name in (
        each.name for each in pkgutil.walk_packages(DRIVERS, "esair.drivers.")
    ):
        if "._" in name:
            continue
        module = importlib.import_module(name)
        for word in getattr(module, "__all__", [*vars(module)]):
            value = getattr(module, word)
            is_part = inspect.isclass(value) and issubclass(value, Resource)
            if is_part and value.__module__.startswith(name) and word[0] != "_":
                found[value] = None
    return list(found)


def by_code(cls: type[Resource]) -> Keywords:
    """By the constructors, each of which hands the rest on, and the settings."""
    found: Keywords = {
        name: (each.type, False) for name, each in settings_of(cls).items()
    }
    for holder in cls.__mro__:
        if issubclass(holder, Resource) and "__init__" in vars(holder):
            for name, keyword in of_constructor(holder).items():
                found.setdefault(name, keyword)
    return found


def of_constructor(cls: type[Resource]) -> Keywords:
    """What a constructor itself names."""
    constructor: Any = vars(cls)["__init__"]
    hints = typing.get_type_hints(constructor, localns=NAMES)
    return {
        each.name: (hints[each.name], each.default is each.empty)
        for each in inspect.signature(constructor).parameters.values()
        if each.kind is each.KEYWORD_ONLY
    }


def of_dictionary(keywords: Any) -> Keywords:
    """What a `TypedDict` names."""
    hints = typing.get_type_hints(keywords, localns=NAMES, include_extras=True)
    return {
        name: (typing.get_args(hint)[0], True)
        if typing.get_origin(hint) is typing.Required
        else (hint, False)
        for name, hint in hints.items()
    }


def by_checkers(cls: type[Resource]) -> Keywords:
    """By one constructor alone, which is all that type checkers look at."""
    holder = next(each for each in cls.__mro__ if "__init__" in vars(each))
    constructor: Any = vars(holder)["__init__"]
    (rest,) = [
        each.name
        for each in inspect.signature(constructor).parameters.values()
        if each.kind is each.VAR_KEYWORD
    ]
    (keywords,) = typing.get_args(typing.get_type_hints(constructor)[rest])
    return of_constructor(holder) | of_dictionary(keywords)


@pytest.mark.parametrize("cls", parts(), ids=lambda each: each.__name__)
def test_type_checkers_know_what_a_part_takes(cls: type[Resource]) -> None:
    """Each keyword with its type, whether it must be there, and no other."""
    assert by_checkers(cls) == by_code(cls)


@pytest.mark.parametrize("cls", parts(), ids=lambda each: each.__name__)
def test_a_file_may_say_what_a_part_takes(cls: type[Resource]) -> None:
    """As keywords, and no other."""
    accepted = accepted_by(cls).items()

    assert {name for name, each in accepted if each.is_keyword} == by_code(cls).keys()


@pytest.mark.parametrize(
    ("base", "keywords"),
    [
        (Resource, ResourceSettings),
        (esair.Sensor, SensorSettings),
        (esair.Actuator, ActuatorSettings),
    ],
)
def test_what_every_part_takes_is_what_its_base_takes(base: Any, keywords: Any) -> None:
    """The dictionary and the constructor."""
    assert of_dictionary(keywords) == by_code(base)


def test_a_wrong_keyword_is_told_with_the_nearest_right_one() -> None:
    """Of the part's own keywords too, not of its settings alone."""
    wrong: dict[str, Any] = {"adress": 0x49, "rat": 5.0}

    with pytest.raises(BadValueError) as told:
        Ads1115(**wrong)

    assert str(told.value) == (
        "ads1115: adress: there is no such setting; did you mean 'address'?; "
        "rat: there is no such setting; did you mean 'rate'?"
    )


@pytest.mark.promise("RS-8")
@pytest.mark.parametrize("word", ["command_timeout", "slew", "deadline"])
def test_what_a_class_says_of_itself_is_no_keyword_and_how_it_is_given_is_told(
    word: str,
) -> None:
    """And nobody is sent to another word, which means that the device stops by itself."""
    with pytest.raises(BadValueError) as caught:
        LineActuator(name="pump", safe=0.0, **{word: 1.0})  # type: ignore[arg-type]

    assert str(caught.value) == (
        f"pump: {word}: there is no such setting; it is an attribute: "
        f"pump.{word} = ... after it was made, or in a subclass"
    )
