"""An object of a package: made at each opening, used, closed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from esair.drivers._path import Path, imported
from esair.exceptions import ConfigError, DeviceLostError, describe
from esair.resources import Resource

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
        self._make = self._called(library, hint)
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
        self.it = self.use(lambda: self._make(*first, *self._listed, **self._named))
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
