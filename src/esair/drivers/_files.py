"""Files that describe devices: read once, while they are the same."""

from __future__ import annotations

import functools
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


@functools.lru_cache(maxsize=16)
def _loaded(load: Any, path: str, args: Any, _modified: int, _size: int) -> Any:
    return load(path, *args)
