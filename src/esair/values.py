"""What every layer asks of a plain value: names, numbers, durations, types."""

from __future__ import annotations

import contextlib
import functools
import inspect
import numbers
import os
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

from esair.exceptions import BadValueError, ConfigError
from esair.exceptions import printable as printable

if TYPE_CHECKING:
    from pathlib import Path

T = TypeVar("T")

_NAME = re.compile(r"[a-z][a-z0-9_]{0,62}\Z")

_NUMBERS: dict[type, type] = {int: numbers.Integral, float: numbers.Real}


def once_for_class(function: Callable[[type], T]) -> Callable[[type], T]:
    """Have a function compute once for each class; the class itself keeps what it gave.

    In a table beside it a class that was swapped out would be kept for ever.
    """
    key = f"_esair_{function.__name__}"

    @functools.wraps(function)
    def known(cls: type) -> T:
        attributes = vars(cls)
        if key in attributes:
            return attributes[key]  # type: ignore[no-any-return]
        found = function(cls)
        with contextlib.suppress(TypeError):  # a built-in class
            setattr(cls, key, found)
        return found

    return known


def check_name(kind: str, name: object) -> str:
    """Return the name of a component, or say what a name must look like.

    Raises:
        ConfigError: It is not ``[a-z][a-z0-9_]{0,62}``.
    """
    if isinstance(name, str) and _NAME.match(name):
        return name
    raise ConfigError(
        f"{kind} {name!r:.80}",
        "name",
        "expected a lower-case letter, then letters, digits or '_', 63 at most",
    )


def as_path(path: str | os.PathLike[str]) -> Path:
    """Return a path; what it is made of is loaded by those who need one."""
    from pathlib import Path

    return Path(path)


_ABROAD = re.compile(r"[a-z][a-z0-9_]{0,62}:/[A-Za-z0-9_/]{1,126}\Z")


def check_party(kind: str, name: object) -> str:
    """Return the name of who acts here: a component, or a topic such as ``ros:/cmd_vel``.

    Raises:
        ConfigError: It is no name of such.
    """
    is_abroad = isinstance(name, str) and _ABROAD.match(name)
    return str(name) if is_abroad else check_name(kind, name)


_REAL = (int, float)
_LARGEST = sys.float_info.max


def is_positive(value: object) -> bool:
    """Tell whether a value is a time or a rate: a positive, finite int or float.

    NumPy's ``float64`` is a float too; a bool is no number here.
    """
    return (
        isinstance(value, _REAL)
        and not isinstance(value, bool)
        and 0 < value <= _LARGEST
    )


def passes_as(value: object, wanted: type) -> bool:
    """Tell whether a number of another class, NumPy's say, may stand for one wanted.

    Any whole number passes as an int, any real one as a float; a bool as neither.
    """
    kind = _NUMBERS.get(wanted)
    return kind is not None and isinstance(value, kind) and not isinstance(value, bool)


def snake_case(name: str) -> str:
    """Turn the name of a class into the name of a component: ``MyArm`` → ``my_arm``."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    return words.lower().strip("_")


def check_duration(component: str, field: str, value: object) -> float:
    """Return a positive, finite number of seconds.

    Raises:
        BadValueError: It is something else.
    """
    if is_positive(value):
        return typing.cast("float", value)
    raise BadValueError(component, field, f"expected seconds > 0, not {value!r:.80}")


def check_moment(component: str, field: str, value: object) -> None:
    """Pass with a moment on the loop's clock: a number of seconds, also infinite.

    Raises:
        BadValueError: It is something else.
    """
    if type(value) is bool or not isinstance(value, _REAL) or value != value:
        told = f"expected a moment in seconds, not {value!r:.80}"
        raise BadValueError(component, field, told)


def value_type(cls: type, base: type) -> Any:
    """Return ``T`` of ``class X(Sensor[T])``; `typing.Any` if it does not say."""
    for klass in cls.__mro__:
        for generic in getattr(klass, "__orig_bases__", ()):
            origin = typing.get_origin(generic)
            if inspect.isclass(origin) and issubclass(origin, base):
                (argument, *_) = typing.get_args(generic)
                if isinstance(argument, typing.ForwardRef):
                    return _resolved(argument.__forward_arg__, klass)
                return Any if isinstance(argument, typing.TypeVar) else argument
    return Any


def same_type(given: Any, wanted: Any) -> bool:
    """Tell whether values of one type may be used where another is wanted."""
    return all(
        any(_same_type(one, other) for other in alternatives(wanted))
        for one in alternatives(given)
    )


def alternatives(kind: Any) -> tuple[Any, ...]:
    """The types of a union; any other type alone."""
    if typing.get_origin(kind) in {typing.Union, types.UnionType}:
        return typing.get_args(kind)
    return (kind,)


def _same_type(given: Any, wanted: Any) -> bool:
    if given is Any or wanted is Any or given is object or wanted is object:
        return True
    given_class = typing.get_origin(given) or given
    wanted_class = typing.get_origin(wanted) or wanted
    if not (inspect.isclass(given_class) and inspect.isclass(wanted_class)):
        return bool(given == wanted)
    if wanted_class is float and given_class is int:
        return True
    if _has_no_instances(wanted_class):
        return given_class is wanted_class
    return issubclass(given_class, wanted_class)


def fits(value: object, kind: Any) -> bool:
    """Tell whether a value is of a type, or of one of a union, as far as that can be seen."""
    for each in alternatives(kind):
        cls = checked_class(each)
        if cls is None:
            if each is not None or value is None:
                return True
        elif passes_as(value, cls) or (
            isinstance(value, cls) and (cls not in _REAL or type(value) is not bool)
        ):
            return True
    return False


def checked_class(kind: Any) -> type | None:
    """Return the class that values can be checked for; None if any value will do."""
    cls = typing.get_origin(kind) or kind
    if cls is Any or cls is object or not inspect.isclass(cls):
        return None
    if cls is types.UnionType or _has_no_instances(cls):
        return None
    return cls


def _has_no_instances(cls: type) -> bool:
    """Tell whether a class describes values that are instances of other classes."""
    if typing.is_typeddict(cls):
        return True
    return getattr(cls, "_is_protocol", False) and not getattr(
        cls, "_is_runtime_protocol", False
    )


def type_name(kind: Any) -> str:
    """Name a type in an error message."""
    return getattr(kind, "__name__", str(kind))


def check_seconds(component: str, field: str, value: object) -> float:
    """Return a positive, finite number of seconds.

    Raises:
        ConfigError: It is something else.
    """
    if is_positive(value):
        return float(typing.cast("float", value))
    raise ConfigError(
        component, field, f"expected a number of seconds > 0, not {value!r:.80}"
    )


def check_choice(component: str, field: str, value: object, choices: Iterable[T]) -> T:
    """Return a value that is one of several.

    Raises:
        ConfigError: It is none of them.
    """
    known = list(choices)
    for each in known:
        if value == each and type(value) is type(each):
            return each
    *most, last = map(repr, known)
    raise ConfigError(
        component, field, f"expected {', '.join(most)} or {last}, not {value!r:.80}"
    )


def is_whole(value: object, least: int, most: int) -> bool:
    """Tell whether a value is a whole number within bounds, which count."""
    return passes_as(value, int) and least <= typing.cast("int", value) <= most


def check_bytes(component: str, field: str, data: Any) -> bytes:
    """Return bytes as they are now: whoever gave them may change them later.

    Raises:
        BadValueError: There are no bytes in it.
    """
    if type(data) is bytes:
        return data
    with contextlib.suppress(TypeError, ValueError):
        return bytes(data if isinstance(data, list | tuple) else memoryview(data))
    raise BadValueError(component, field, f"expected bytes, not {data!r:.80}")


def check_whole(
    component: str, field: str, value: object, least: int, most: int | None = None
) -> int:
    """Return a whole number within its bounds, which count.

    Raises:
        ConfigError: It is another one, or none.
    """
    if type(value) is int and least <= value and (most is None or value <= most):
        return value
    bounds = f"{least} or more" if most is None else f"{least} to {most}"
    raise ConfigError(component, field, f"expected {bounds}, not {value!r:.80}")


def digits_of(number: float) -> str:
    """Return a number in digits, with all that it has; a whole one without a point."""
    if isinstance(number, int):
        return f"{number:d}"
    return repr(float(number)).removesuffix(".0")


def hints_of(something: Any) -> dict[str, Any]:
    """Return the types that a class or function names, by field or parameter.

    What cannot be resolved at run time is `typing.Any`.
    """
    try:
        return typing.get_type_hints(something)
    except Exception:  # a name imported for type checkers only, or nonsense
        holders = [something]
    if inspect.isclass(something):
        holders = list(reversed(something.__mro__))
    return {
        name: _resolved(hint, holder)
        for holder in holders
        for name, hint in inspect.get_annotations(holder).items()
    }


def _resolved(hint: object, holder: object) -> Any:
    if not isinstance(hint, str):
        return hint
    import pathlib  # only where hints cannot be had at once

    try:
        names = getattr(holder, "__globals__", None) or vars(inspect.getmodule(holder))
        # Many import it for type checkers only, and it is a path here all the same.
        return eval(hint, {"Path": pathlib.Path, **names})
    except Exception:  # as above, but for this name only
        return Any
