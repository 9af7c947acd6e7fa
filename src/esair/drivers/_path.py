"""Ways from an object to what is read of it or told to it: ``channels[0].voltage``."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Callable
from typing import Any

from esair.exceptions import ConfigError, describe
from esair.resources import Resource


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
        for kind, what in self._steps:
            found = _step(found, kind, what)
        return found

    def put(self, found: Any, value: Any) -> None:
        """Go the way; assign a value to its end, or call that with it before all else."""
        for kind, what in self._steps[:-1]:
            found = _step(found, kind, what)
        kind, what = self._steps[-1]
        if kind == "call":
            told, named = what
            found(value, *told, **named)
        else:
            setattr(found, what, value)


def _step(found: Any, kind: str, what: Any) -> Any:
    if kind == "attribute":
        return getattr(found, what)
    if kind == "item":
        return found[what]
    told, named = what
    return found(*told, **named)


def imported(owner: Resource, library: str, *, hint: str) -> Callable[..., Any]:
    """Return the class or function that ``module:name`` names.

    Raises:
        ConfigError: There is none, or it cannot be called.
    """
    module, colon, name = library.partition(":")
    if not (module and colon and name):
        raise ConfigError(
            owner.name, "library", f"expected 'module:Class', not {library!r:.80}"
        )
    try:
        found = getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        raise ConfigError(
            owner.name, "library", f"{error.name!r} is not installed; {hint}"
        ) from error
    except Exception as error:  # some packages refuse to be imported on some boards
        raise ConfigError(
            owner.name, "library", f"{library!r} cannot be used: {describe(error)}"
        ) from error
    if not callable(found):
        raise ConfigError(owner.name, "library", f"{library!r} is no class")
    made: Callable[..., Any] = found
    return made
