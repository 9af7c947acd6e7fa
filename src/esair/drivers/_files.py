"""Files that describe devices: read once, while they are the same; and their limits."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from esair.exceptions import ConfigError, describe

T = TypeVar("T")


def described(
    component: str, field: str, path: Path | str, load: Callable[..., T], *args: Any
) -> T:
    """Return what a function makes of a file.

    Raises:
        ConfigError: It cannot be read, or the function raises, whatever it is.
    """
    try:
        state = Path(path).stat()
        found: T = _loaded(load, str(path), args, state.st_mtime_ns, state.st_size)
    except OSError as error:
        wrong = f"{path} cannot be read: {error.strerror}"
        raise ConfigError(component, field, wrong) from error
    except Exception as error:  # people write such files by hand
        wrong = f"{path} cannot be understood: {describe(error)}"
        raise ConfigError(component, field, wrong) from error
    return found


def narrowed(
    component: str,
    field: str,
    given: Any,
    allowed: tuple[float, float] | None,
    by: str = "the file",
) -> tuple[float, float]:
    """Return limits that are within those of a file, or of a part, if it has any.

    Raises:
        ConfigError: They are not, or are no limits.
    """
    try:
        low, high = given
        fits = -math.inf <= low <= high <= math.inf
    except (TypeError, ValueError):
        fits = False
    if not fits:
        wrong = f"expected (least, greatest), not {given!r:.80}"
        raise ConfigError(component, field, wrong)
    if allowed is not None and not (allowed[0] <= low and high <= allowed[1]):
        wrong = f"{by} allows {allowed[0]:g} to {allowed[1]:g}, not {given!r:.80}"
        raise ConfigError(component, field, wrong)
    return low, high


@functools.lru_cache(maxsize=16)
def _loaded(load: Any, path: str, args: Any, _modified: int, _size: int) -> Any:
    return load(path, *args)
