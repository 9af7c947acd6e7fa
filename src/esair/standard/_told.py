"""What has gone wrong, for the developer: what, where, what to do; no traceback."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from types import TracebackType

from esair.exceptions import (
    ConfigError,
    EsairError,
    describe,
    line_of,
    wants_traceback,
)
from esair.values import printable

_shown: list[BaseException] = []
"""The error with which the last robot of the program has ended."""


def class_of(part: object) -> str:
    """Return where the class of a part is written, if it is the user's; or nothing."""
    cls = part if isinstance(part, type) else type(part)
    try:
        file, (_, line) = inspect.getsourcefile(cls), inspect.getsourcelines(cls)
    except (OSError, TypeError):
        return ""
    if file is None or cls.__module__.startswith("esair."):
        return ""
    return printable(f"{file}, line {line}, class {cls.__name__}")


def told(error: BaseException) -> list[str]:
    """Return one block of lines: what has gone wrong, where, and what to do."""
    lines = []
    if isinstance(error, BaseExceptionGroup):
        lines.append(printable(error.message))
    for each in leaves(error):
        lines.append(describe(each))
        where = getattr(each, "__notes__", None) or [line_of(each)]
        lines += [f"  where: {place}" for place in where if place]
    started = not isinstance(error, BaseExceptionGroup | ConfigError)
    todo = "mend that line" if started else "nothing was opened, nothing moved: mend it"
    if any(line.startswith("  where: ") for line in lines):
        lines.append(f"  to do: {todo}; --traceback shows how it came to that")
    return lines


def leaves(error: BaseException) -> Iterator[BaseException]:
    """Yield the errors of a group, of groups in it, too; or the error itself."""
    if isinstance(error, BaseExceptionGroup):
        for each in error.exceptions:
            yield from leaves(each)
    else:
        yield error


def show_at_the_end(error: BaseException) -> None:
    """If this error ends the program, let a block stand for its traceback."""
    if all(isinstance(each, EsairError) for each in leaves(error)):
        _shown[:] = [error]
        if sys.excepthook is sys.__excepthook__ and not wants_traceback():
            sys.excepthook = _hook


def _hook(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    if error not in _shown:
        sys.__excepthook__(kind, error, trace)
        return
    print("\n".join(told(error)), file=sys.stderr)  # noqa: T201 - in place of Python's
