"""Settings: the named attributes of a resource that can be configured."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Mapping
from typing import Any, TypeVar, cast

import attrs

from esair import abc
from esair.exceptions import BadValueError, did_you_mean
from esair.values import passes_as

T = TypeVar("T")

_WORDS: Mapping[type, str] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "a text",
}

HIDDEN = "(secret)"  # what is shown of the value of a secret setting


@attrs.frozen
class Setting:
    """The description of a setting: its type, unit, and limits.

    Attributes:
        default: The value until somebody configures another; its type is the
            type of the setting.
        unit: The unit, such as ``"Hz"``; empty if it has none.
        min: The least value allowed.
        max: The greatest value allowed.
        choices: The only values allowed.
        doc: What the setting does, in one line.
        name: The name, as the class gives it.
        secret: Its values are never recorded and never shown.
    """

    default: Any
    unit: str = ""
    min: float | None = None
    max: float | None = None
    choices: Collection[object] | None = None
    doc: str = ""
    name: str = ""
    secret: bool = False

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", name)

    def __get__(self, instance: object, owner: type) -> Any:
        # A configured value lies in the instance and is found before this.
        return self if instance is None else self.default

    @property
    def type(self) -> type:
        """The type that values of this setting have."""
        return type(self.default)

    def check(self, component: str, value: object) -> object:
        """Return the value in the type of the setting."""
        wanted = self.type
        if type(value) is not wanted and passes_as(value, wanted):
            with contextlib.suppress(OverflowError):  # refused below
                value = wanted(value)
        if wrong := self._wrong(value):
            if self.secret:
                wrong = "its value is not allowed; it is secret and not shown"
            raise BadValueError(component, self.name, wrong)
        return value

    def _wrong(self, value: object) -> str:
        """Say what is wrong with a value; nothing if it is allowed."""
        if self.default is not None and type(value) is not self.type:
            return f"expected {self._in_words()}, not {value!r:.80}"
        if isinstance(value, float) and not math.isfinite(value):
            return f"expected a finite number, not {value}"
        if self.choices is not None and value not in self.choices:
            names = ", ".join(repr(choice) for choice in self.choices)
            return f"expected one of {names}, not {value!r:.80}"
        number = cast("float", value)
        if self.min is not None and number < self.min:
            return f"expected at least {self.min}{self._in_unit()}, not {value}"
        if self.max is not None and number > self.max:
            return f"expected at most {self.max}{self._in_unit()}, not {value}"
        return ""

    def _in_words(self) -> str:
        words = _WORDS.get(self.type, self.type.__name__)
        return f"{words} in {self.unit}" if self.unit else words

    def _in_unit(self) -> str:
        return f" {self.unit}" if self.unit else ""


def setting(
    default: T,
    *,
    unit: str = "",
    min: float | None = None,  # noqa: A002 - the word that everybody expects
    max: float | None = None,  # noqa: A002 - the word that everybody expects
    choices: Collection[T] | None = None,
    doc: str = "",
    secret: bool = False,
) -> T:
    """Declare a setting of a resource, as a class attribute.

    The attribute holds the current value. It is changed by the constructor
    (``Sonar(rate=20.0)``), the configuration file, or at run time by
    ``port.configure(rate=20.0)``, which checks every value first.

    Args:
        default: The value to begin with. Its type is the type of the setting.
        unit: The unit, such as ``"Hz"``.
        min: The least value allowed.
        max: The greatest value allowed.
        choices: The only values allowed.
        doc: What the setting does, in one line.
        secret: Its values are never recorded and never shown: a password, say.

    Example:
        >>> class Sonar(esair.Sensor[float]):
        ...     rate = esair.setting(20.0, unit="Hz", min=1.0, max=50.0)
        ...     gain = esair.setting(3, min=0, max=7, doc="amplification step")
    """
    # The static type is that of the value, as with attrs.field and its kin.
    return cast("T", Setting(default, unit, min, max, choices, doc, secret=secret))


def settings_of(component: type[abc.Resource]) -> dict[str, Setting]:
    """Return the settings that a class of resources declares, by name.

    What is computed is never asked, and has no rate.
    """
    found: dict[str, Setting] = {}
    for cls in reversed(component.__mro__):
        found.update(
            (name, value)
            for name, value in vars(cls).items()
            if isinstance(value, Setting)
        )
    if getattr(component, "is_computed", False):
        found.pop("rate", None)
    return found


def shown(resource: abc.Resource, values: Mapping[str, object]) -> dict[str, object]:
    """Return values of settings as they may be recorded and shown."""
    known = settings_of(type(resource))
    return {
        name: HIDDEN if name in known and known[name].secret else value
        for name, value in values.items()
    }


def check_settings(
    resource: abc.Resource,
    changes: Mapping[str, object],
    keywords: Collection[str] = (),
) -> dict[str, object]:
    """Return the changes in the right types, or name every mistake at once.

    A name that there is not may have been meant for one of the keywords.
    """
    known = settings_of(type(resource))
    checked: dict[str, object] = {}
    mistakes: list[str] = []
    fields: list[str] = []
    for name, value in changes.items():
        if name not in known:
            there = f"there are {', '.join(sorted(known))}" if known else "it has none"
            hint = did_you_mean(name, [*known, *keywords]) or f"; {there}"
            mistakes.append(f"{name}: there is no such setting{hint}")
            fields.append(name)
            continue
        try:
            checked[name] = known[name].check(resource.name, value)
        except BadValueError as error:
            mistakes.append(str(error).removeprefix(f"{resource.name}: "))
            fields.append(name)
    if mistakes:
        refusal = BadValueError(resource.name, "", "; ".join(mistakes))
        refusal.field = ", ".join(fields)
        raise refusal
    return checked
