"""The condition that ends a reaction, by the names of the readings that it wants."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from esair.actions._reaction import Reaction
from esair.exceptions import BadValueError


def by_name(
    until: Callable[..., bool], reaction: Reaction
) -> Callable[[Mapping[str, Any]], bool]:
    """Adapt a condition that names the readings it wants."""
    if not callable(until):
        raise BadValueError(
            reaction.name, "until", f"expected a function, not {until!r:.80}"
        )
    parameters = inspect.signature(until).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return lambda values: until(**values)
    wanted = [
        p.name
        for p in parameters
        if p.default is p.empty and p.kind is not p.VAR_POSITIONAL
    ]
    unknown = [name for name in wanted if name not in reaction.inputs]
    if unknown:
        raise BadValueError(
            reaction.name,
            "until",
            f"its parameters must be readings ({', '.join(reaction.inputs)}), "
            f"not {', '.join(unknown)}",
        )
    return lambda values: until(**{name: values[name] for name in wanted})
