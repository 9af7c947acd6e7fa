"""Which classes may cross, and how an object of each is taken apart and made."""

from __future__ import annotations

import asyncio
import builtins
import dataclasses
import enum
import sys
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import attrs

from esair import exceptions

LIMIT: Final = 1 << 20
"""How many bytes a message may have unless its user says otherwise."""

DEPTH: Final = 64
"""How deep values may be nested."""

PATH: Final = 60
"""How much of the path to a part an error tells, in characters, from the outside."""

STRANGERS: Final = 256
"""How many classes a table knows by name only, and how many definitions it keeps."""


class CodecError(ValueError):
    """A value cannot cross, or bytes are not what a sender writes.

    Attributes:
        path: Which part of the value it is, such as ``.pose.x``; empty for the whole.
        reason: What is the matter with it.
    """

    def __init__(self, reason: str, path: str = "") -> None:
        super().__init__(f"{path.removeprefix('.')}: {reason}" if path else reason)
        self.path = path
        self.reason = reason

    def below(self, part: str) -> CodecError:
        """Return the same error as that of the holder of the part."""
        path = self.path if len(self.path) < PATH else f"{self.path[:PATH]}..."
        return CodecError(self.reason, f"{part}{path}")


class Form(enum.Enum):
    """How objects of a class are made, with the tag that they have."""

    RECORD = b"o"  # by their fields: attrs classes, data classes
    TUPLE = b"n"  # a named tuple
    ENUM = b"e"
    ERROR = b"X"

    if not TYPE_CHECKING:  # an override that checkers cannot follow
        __hash__ = object.__hash__  # hot: that of an enum is a call


class Shape(NamedTuple):
    """How objects of a class are taken apart and made.

    Attributes:
        form: What kind of class it is.
        fields: The names of its fields, in their order.
        slots: What sets those fields that are slots, by name.
        defaults: What a field is that was not there when the value was sent.
        has_more: Whether an object may have attributes beside its fields.
    """

    form: Form
    fields: tuple[str, ...] = ()
    slots: Mapping[str, Any] = types.MappingProxyType({})
    defaults: Mapping[str, Any] = types.MappingProxyType({})
    has_more: bool = False


def shape_of(kind: type) -> Shape | None:
    """Return how objects of a class are made; None if they are no plain data."""
    if any("__del__" in vars(base) for base in kind.__mro__):
        return None  # it would be called
    if issubclass(kind, BaseException):
        return Shape(Form.ERROR)
    if issubclass(kind, enum.Enum):
        return Shape(Form.ENUM)
    has_more = bool(kind.__dictoffset__)
    if issubclass(kind, tuple):
        names = getattr(kind, "_fields", None)
        is_named = isinstance(names, tuple) and all(type(each) is str for each in names)
        return Shape(Form.TUPLE, names or (), has_more=has_more) if is_named else None
    defaults: dict[str, Any] = {}
    if attrs.has(kind):
        fields: tuple[Any, ...] = attrs.fields(kind)
        for each in fields:
            if each.default is not attrs.NOTHING and not isinstance(
                each.default,
                attrs.Factory,  # type: ignore[arg-type]
            ):
                defaults[each.name] = each.default
    elif dataclasses.is_dataclass(kind):
        fields = dataclasses.fields(kind)
        for field in fields:
            if field.default is not dataclasses.MISSING:
                defaults[field.name] = field.default
    else:
        return None
    try:
        object.__new__(kind)
    except TypeError:  # it is abstract, or made by something else
        return None
    names = tuple(each.name for each in fields)
    slots = {
        name: vars(base)[name]
        for base in reversed(kind.__mro__)
        for name in vars(base)
        if isinstance(vars(base)[name], types.MemberDescriptorType)
    }
    if not has_more and not set(names) <= set(slots):
        return None
    return Shape(Form.RECORD, names, slots, defaults, has_more)


def name_of(kind: type) -> str:
    """Return under which name a class crosses."""
    return f"{kind.__module__}:{kind.__qualname__}"


class Kinds:
    """The classes that may cross, by identity.

    Classes of errors need not be named: one that the receiver does not know becomes a
    class of the same name, derived from the nearest that it does.

    Args:
        kinds: Classes; the classes of their fields may cross, too.
        strangers: Whether an object of a class that is not here comes back as a
            dictionary of its fields; else that is an error.
        more: Called with the table when a class is not here: components come and go.
        fits: Tells of what is in a field whether its annotation names it; without it
            there may be anything in a field.
    """

    def __init__(
        self,
        kinds: Iterable[Any] = (),
        *,
        strangers: bool = False,
        more: Callable[[Kinds], object] | None = None,
        fits: Callable[[Any, Any], bool] | None = None,
    ) -> None:
        self.strangers = strangers
        self.fits = fits
        self._hints: dict[type, dict[str, Any]] = {}
        self.programs: list[str] = []
        """Modules that may have had other names when a value was sent."""
        self._more = more
        self._shapes: dict[type, Shape] = {}
        self._named: dict[str, type] = {}
        self._doubled: set[str] = set()
        self._unknown: dict[tuple[str, str], type] = {}
        self.definitions: dict[type, bytes] = {}
        """What is written of a class where it is named first."""
        self.known: dict[tuple[Form, bytes], Any] = {}
        """What was read of such definitions."""
        for module in (builtins, exceptions):
            for each in vars(module).values():
                if isinstance(each, type) and issubclass(each, BaseException):
                    self.add(each)
        self.add(asyncio.CancelledError)
        for kind in kinds:
            self.add(kind)

    def add(self, kind: Any) -> None:
        """Let a class cross, and those that the annotations of its fields name."""
        waiting = [kind]
        while waiting:
            each = waiting.pop()
            waiting += typing.get_args(each)
            each = typing.get_origin(each) or each
            if not isinstance(each, type) or each in self._shapes:
                continue
            shape = shape_of(each)
            if shape is None:
                continue
            self._shapes[each] = shape
            if self._named.setdefault(name_of(each), each) is not each:
                self._doubled.add(name_of(each))
            if shape.form in {Form.RECORD, Form.TUPLE}:
                self._hints[each] = hints_of(each)
                waiting += self._hints[each].values()

    def __contains__(self, kind: object) -> bool:
        return kind in self._shapes

    def shape(self, kind: type) -> Shape:
        """Return how objects of a class are taken apart.

        Raises:
            CodecError: They may not cross.
        """
        shape = self._shapes.get(kind)
        if shape is None and self._more is not None:
            self._more(self)
            shape = self._shapes.get(kind)
        if shape is not None:
            if self._doubled and name_of(kind) in self._doubled:
                raise CodecError(f"there are two classes {name_of(kind)}")
            return shape
        if issubclass(kind, BaseException) and (found := shape_of(kind)) is not None:
            return found
        what = f"{kind.__module__}.{kind.__qualname__}"
        if kind is types.FunctionType or shape_of(kind) is None:
            raise CodecError(
                f"{what} is no plain data: expected an attrs class, a data class, a "
                "named tuple or plain values"
            )
        raise CodecError(
            f"{what} is not declared: name it where a port, a driver or a request says "
            "what it gives"
        )

    def check(self, kind: type, parts: Iterable[tuple[str, Any]]) -> None:
        """Look whether there is in the fields of an object what their annotations say.

        Raises:
            CodecError: There is something else in one.
        """
        hints, fits = self._hints.get(kind, {}), self.fits
        for name, part in parts:
            if name in hints and fits is not None and not fits(part, hints[name]):
                wanted = getattr(hints[name], "__name__", hints[name])
                told = f"expected {wanted}, not {type(part).__name__}"
                raise CodecError(f"{kind.__qualname__}.{name}: {told}")

    def find(self, name: str) -> tuple[type, Shape] | None:
        """Return the class of a name, and how its objects are made."""
        found = self._known_as(name)
        if found is None and self._more is not None:
            self._more(self)
            found = self._known_as(name)
        return None if found is None else (found, self._shapes[found])

    def _known_as(self, name: str) -> type | None:
        found = self._named.get(name)
        if found is None:
            rest = name.partition(":")[2]
            others = (self._named.get(f"{each}:{rest}") for each in self.programs)
            found = next((each for each in others if each is not None), None)
        return found

    def base_of(self, kind: type) -> str:
        """Return the name of the nearest class of an error that everybody knows."""
        known = (each for each in kind.__mro__ if each.__module__ in _KNOWN)
        return name_of(next(known))

    def error(self, name: str, base: str) -> type:
        """Return the class of an error, or one that is called the same."""
        if (found := self.find(name)) is not None and found[1].form is Form.ERROR:
            return found[0]
        known = self._unknown.get((name, base))
        if known is not None:
            return known
        parent = self._named.get(base)
        if parent is None or parent.__module__ not in _KNOWN:
            raise CodecError(f"{base!r:.80} is no error")
        module, _, qualified = name.partition(":")
        if len(self._unknown) >= STRANGERS or not all(
            part.isidentifier()
            for part in f"{module}.{qualified}".replace("<locals>", "x").split(".")
        ):
            return parent
        # `type` alone, on a parent of Python or esair: no code of anybody else.
        made = type(qualified.rpartition(".")[2], (parent,), {"__module__": module})
        self._unknown[name, base] = made
        return made


_KNOWN: Final = {"builtins", exceptions.__name__}


def kinds_of(
    components: Callable[[], Iterable[Any]],
    always: Iterable[Any] = (),
    *,
    strangers: bool = False,
) -> Kinds:
    """Return the classes that a robot's components declare, those added later too.

    They are looked up when a value needs them: that takes some ms for each module.

    Args:
        components: Returns the components that there are, or their classes.
        always: Classes that may cross whatever they declare.
        strangers: As for `Kinds`.
    """
    seen: set[type] = set()

    def add(kinds: Kinds) -> None:
        for each in list(components()):
            kind = each if isinstance(each, type) else type(inner_of(each))
            if kind not in seen:
                seen.add(kind)
                kinds.programs.append(kind.__module__)
                for found in (*declared(kind), getattr(each, "value_type", None)):
                    kinds.add(found)

    kinds = Kinds(always, strangers=strangers, more=add)
    kinds.programs.append("__main__")
    return kinds


def inner_of(component: Any) -> Any:
    """Return what the user has written: a class of ESAIR MIN is in an adapter."""
    fields = vars(component)
    inner = fields.get("reaction", fields.get("device"))
    return component if inner is None else inner


def hints_of(something: Any) -> dict[str, Any]:
    """Return the annotations of a class or function, as far as they can be resolved."""
    try:
        return typing.get_type_hints(something)
    except Exception:  # such as a name that is for type checkers alone
        found: dict[str, Any] = {}
        for base in getattr(something, "__mro__", (something,)):
            found.update(vars(base).get("__annotations__", {}))
        return found


_FRAMEWORK: Final = {"abc", "actions", "resources", "connections", "minimal", "loop"}
"""The rooms of esair whose classes say nothing of a robot's own data."""


def declared(kind: type) -> Iterator[Any]:
    """Yield the types that the class of a component declares, some more than once.

    They are those of its ports, requests and annotations, and the classes that stand
    beside it in its module, or in a module that is named there. Nothing is imported.
    """
    for base in kind.__mro__:
        room = base.__module__.split(".")
        if room[0] in {"builtins", "typing", "abc"} or (
            room[0] == "esair" and room[1] in _FRAMEWORK
        ):
            continue
        yield from getattr(base, "__orig_bases__", ())
        yield from hints_of(base).values()
        for each in vars(base).values():
            if isinstance(each, types.FunctionType):
                yield from hints_of(each).values()
            else:
                yield getattr(each, "type", None)  # a port
        yield from _in_module(base.__module__)


def _in_module(name: str) -> Iterator[type]:
    module = sys.modules.get(name)
    for each in list(vars(module).values()) if module is not None else ():
        if isinstance(each, type):
            yield each
        elif isinstance(each, types.ModuleType):
            for other in list(vars(each).values()):
                if isinstance(other, type) and other.__module__ == each.__name__:
                    yield other
