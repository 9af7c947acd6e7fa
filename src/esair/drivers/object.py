"""Any object of any package, as a sensor or an actuator.

What reads or sets something by an attribute or a method needs no driver of its own. The
object is made at each opening and closed at each loss, and used on one worker thread::

    [sensor.water]
    driver = "object"
    library = "w1thermsensor:W1ThermSensor"
    value = "get_temperature()"
    limits = [-55.0, 125.0]

    [actuator.fan]
    driver = "object"
    library = "gpiozero:PWMOutputDevice"
    arguments = { pin = 17, frequency = 25000 }
    attribute = "value"
    safe = 0.0
    limits = [0.0, 1.0]
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Unpack

from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError, describe
from esair.resources import (
    HOLD,
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)

__all__ = ["Made", "ObjectActuator", "ObjectSensor"]


class Path:
    """A way from an object: attributes, items, and calls with plain arguments.

    Nothing is evaluated: names, numbers and texts are looked up one after the other.

    Args:
        owner: The resource whose setting this is.
        field: The name of the setting, for an error.
        text: The way, such as ``"temperature"``, ``"channels[0].duty_cycle"``,
            ``"get_temperature()"`` or ``"read(0, gain=2)"``.
        to_assign: Whether it has to end at an attribute.

    Raises:
        ConfigError: It is no such way.
    """

    def __init__(
        self, owner: Resource, field: str, text: str, *, to_assign: bool = False
    ) -> None:
        self.text = text
        self.is_call: bool = False
        """Whether the last step is a call."""
        self._steps: list[tuple[str, Any]] = []
        try:
            self._take(ast.parse(text, mode="eval").body)
        except (SyntaxError, ValueError, TypeError):
            raise ConfigError(
                owner.name,
                field,
                "expected an attribute such as 'temperature', 'channels[0].duty_cycle' "
                f"or 'read(0)', not {text!r:.80}",
            ) from None
        self.is_call = self._steps[-1][0] == "call"
        if to_assign and self._steps[-1][0] != "attribute":
            raise ConfigError(owner.name, field, f"expected an attribute, not {text!r}")

    def _take(self, node: ast.expr) -> None:
        match node:
            case ast.Name(id=name) if not name.startswith("__"):
                self._steps.append(("attribute", name))
            case ast.Attribute(value=inner, attr=name) if not name.startswith("__"):
                self._take(inner)
                self._steps.append(("attribute", name))
            case ast.Subscript(value=inner, slice=key):
                self._take(inner)
                self._steps.append(("item", ast.literal_eval(key)))
            case ast.Call(func=inner, args=args, keywords=keywords):
                self._take(inner)
                told = tuple(map(ast.literal_eval, args))
                named = {str(k.arg): ast.literal_eval(k.value) for k in keywords}
                self._steps.append(("call", (told, named)))
            case _:
                raise ValueError(node)

    def get(self, found: Any) -> Any:
        """Go the way from an object; return what is there."""
        return functools.reduce(_step, self._steps, found)

    def put(self, found: Any, value: Any) -> None:
        """Go the way; assign a value to its end, or call that with it before all else."""
        found = functools.reduce(_step, self._steps[:-1], found)
        kind, what = self._steps[-1]
        if kind == "call":
            told, named = what
            found(value, *told, **named)
        else:
            setattr(found, what, value)


def _step(found: Any, step: tuple[str, Any]) -> Any:
    kind, what = step
    if kind == "attribute":
        return getattr(found, what)
    if kind == "item":
        return found[what]
    told, named = what
    return found(*told, **named)


def imported(
    owner: Resource, library: str, *, hint: str, field: str = "library"
) -> Callable[..., Any]:
    """Return the class or function that ``module:name`` names.

    Raises:
        ConfigError: There is none, or it cannot be called.
    """

    def wrong(told: str) -> ConfigError:
        return ConfigError(owner.name, field, told)

    module, colon, name = library.partition(":")
    if not (module and colon and name):
        raise wrong(f"expected 'module:Class', not {library!r:.80}")
    try:
        found = getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        raise wrong(f"{error.name!r} is not installed; {hint}") from error
    except Exception as error:  # some packages refuse to be imported on some boards
        raise wrong(f"{library!r} cannot be used: {describe(error)}") from error
    if not callable(found):
        raise wrong(f"{library!r} is no class")
    made: Callable[..., Any] = found
    return made


Arguments = Mapping[str, Any] | Sequence[Any] | None
Lost = Sequence[str | type[Exception]]


class Made:
    """The object of a resource.

    Args:
        owner: The resource, which errors name.
        library: Its class as ``module:Class``, or anything that is called and makes it.
        arguments: What that is called with: keywords, or a list of values.
        set_up: Attributes that are assigned at each opening, by their ways.
        lost: Errors that say that the device is gone.
        hint: What to do if the package is not installed, in words.
        around: What is entered around each use of the object.

    Raises:
        ConfigError: The package is not installed, or a way is none.
    """

    def __init__(
        self,
        owner: Resource,
        library: str | Callable[..., Any],
        arguments: Arguments = None,
        set_up: Mapping[str, Any] | None = None,
        lost: Lost = (),
        *,
        hint: str = "install the package that has it",
        around: Callable[[], contextlib.AbstractContextManager[None]] = (
            contextlib.nullcontext
        ),
    ) -> None:
        self._owner = owner
        self._around = around
        self.make: Callable[..., Any] = self._called(library, hint)
        """What is called and makes the object."""
        is_list = isinstance(arguments, Sequence)
        self._listed = tuple(arguments) if isinstance(arguments, Sequence) else ()
        self._named = {} if is_list else dict(arguments or {})
        self._lost = tuple(self._error(each, hint) for each in lost)
        self.set_up: dict[str, tuple[Path, Any]] = {
            text: (Path(owner, f"set_up.{text}", text, to_assign=True), value)
            for text, value in (set_up or {}).items()
        }
        """What is assigned at each opening, by its way."""
        self.it: Any = None
        """The object, between `open` and `close`."""

    def _called(self, library: Any, hint: str) -> Callable[..., Any]:
        if isinstance(library, str):
            return imported(self._owner, library, hint=hint)
        made: Callable[..., Any] = library
        return made

    def _error(self, error: str | type[Exception], hint: str) -> type[Exception]:
        found: Any = self._called(error, hint)
        if not (isinstance(found, type) and issubclass(found, Exception)):
            raise ConfigError(
                self._owner.name, "lost", f"{error!r} is no class of errors"
            )
        return found

    def open(self, *first: Any) -> None:
        """Make the object, with what comes before its arguments, and set it up."""
        self.close()
        self.it = self.use(lambda: self.make(*first, *self._listed, **self._named))
        for path, value in self.set_up.values():
            self.use(path.put, self.it, value)

    def close(self) -> None:
        """Close the object, if it can be closed, and forget it."""
        made, self.it = self.it, None
        close = getattr(made, "close", None)
        if callable(close):
            close()

    def get(self, path: Path) -> Any:
        """Return what is at the end of a way from the object."""
        return self.use(path.get, self._there())

    def reading(self, value: str | Sequence[str]) -> Callable[[], Any]:
        """Return what reads a value, or a dictionary of several.

        Raises:
            ConfigError: There is none, or it is no way.
        """
        texts = [value] if isinstance(value, str) else list(value)
        if not texts:
            raise ConfigError(
                self._owner.name, "value", "expected at least one attribute"
            )
        paths = {text: Path(self._owner, "value", text) for text in texts}
        if isinstance(value, str):
            return lambda: self.get(paths[value])
        return lambda: {text: self.get(path) for text, path in paths.items()}

    def telling(self, attribute: str) -> Callable[[Any], None]:
        """Return what assigns a command to an attribute, or calls it with one."""
        is_call = isinstance(attribute, str) and attribute.endswith(")")
        path = Path(self._owner, "attribute", attribute, to_assign=not is_call)
        return lambda command: self.use(path.put, self._there(), command)

    def _there(self) -> Any:
        if self.it is None:
            raise DeviceLostError(self._owner.name, "it is not open")
        return self.it

    def use(self, function: Callable[..., Any], *told: Any) -> Any:
        """Call what uses the object.

        Raises:
            DeviceLostError: It raised one of the errors that say so.
        """
        try:
            with self._around():
                return function(*told)
        except self._lost as error:
            raise DeviceLostError(self._owner.name, describe(error)) from error


class OnObject(Resource):
    """What is an object of a package, which is made at each opening."""

    deadline: float = 2.0
    object: Made

    def open(self) -> None:
        """Make the object, and set it up; nothing moves by it."""
        self.object.open()

    def close(self) -> None:
        """Close the object, if it can be closed."""
        self.object.close()


class MadeSensor(OnObject, Sensor[Any]):
    """A sensor that is an object of a package."""

    _read: Callable[[], Any]

    def _reads(self, made: Made, value: str | Sequence[str], limits: Any) -> None:
        """Read a value of an object, or several."""
        self.object = made
        self._read = made.reading(value)
        if limits is not None:
            self.limits: tuple[float, float] = limits

    def read(self) -> Any:
        """Read it; on the thread of the object.

        Raises:
            DeviceFaultError: Each of several values is None, as those of a part are that
                has restarted and is not set up.
        """
        value = self._read()
        parts = value.values() if isinstance(value, Mapping) else value
        several = isinstance(value, tuple | list | Mapping) and value
        if several and all(each is None for each in parts):
            raise DeviceFaultError(self.name, "it has no value: has it restarted?")
        return value


class MadeActuator(OnObject, Actuator[Any]):
    """An actuator that is an object of a package."""

    _tell: Callable[[Any], Any]

    @property
    def value_type(self) -> Any:
        """The type of the commands."""
        return float if self.safe is HOLD else type(self.safe)

    def write(self, command: Any) -> None:
        """Tell it; what is to hold keeps what it was told."""
        if command is not HOLD:
            self._tell(command)


class ObjectSensor(MadeSensor):
    """What an attribute or a method of an object gives.

    Args:
        library: The class of the object as ``module:Class``, or anything that is called
            and makes it.
        value: What is read: an attribute such as ``"temperature"``, a way to one such as
            ``"channels[0].voltage"``, a call such as ``"read(0)"``. If there are
            several, a reading is a dictionary of them.
        arguments: What the class is called with: keywords, or a list of values.
        set_up: Attributes that are assigned at each opening, by their ways.
        lost: Errors of the package, as ``module:Error`` or classes, that say that the
            device is gone rather than at fault. Those of the system (`OSError`) and of
            time (`TimeoutError`) are known.
        limits: Least and greatest value; what is outside is a fault of the device.
    """

    def __init__(
        self,
        *,
        library: str | Callable[..., Any],
        value: str | Sequence[str],
        arguments: Arguments = None,
        set_up: Mapping[str, Any] | None = None,
        lost: Lost = (),
        limits: tuple[float, float] | None = None,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        self._reads(Made(self, library, arguments, set_up, lost), value, limits)


class ObjectActuator(MadeActuator):
    """What an attribute of an object is set to, or a method of it is called with.

    Args:
        library: The class of the object, as of an `ObjectSensor`.
        attribute: What a command is assigned to, such as ``"value"``; with arguments
            behind it, such as ``"move()"`` or ``"move(speed=0.5)"``, it is called, the
            command first.
        safe: The safe command; commands are of its type. `esair.HOLD`, in a file
            ``"hold"``, if commands are places to go (numbers then): the object stays
            where it is.
        arguments: What the class is called with: keywords, or a list of values.
        set_up: Attributes that are assigned at each opening, by their ways.
        lost: Errors of the package that say that the device is gone; as of
            `ObjectSensor`.
        limits: Least and greatest command, or of each of its fields.
    """

    def __init__(
        self,
        *,
        library: str | Callable[..., Any],
        attribute: str,
        safe: Any,
        arguments: Arguments = None,
        set_up: Mapping[str, Any] | None = None,
        lost: Lost = (),
        limits: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
        **settings: Unpack[ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        self.object = Made(self, library, arguments, set_up, lost)
        self._tell = self.object.telling(attribute)
        self.safe: Any = HOLD if safe == "hold" else safe
        self.limits = limits
        self.claim: str = f"{attribute} of {library} {arguments or ''}"
