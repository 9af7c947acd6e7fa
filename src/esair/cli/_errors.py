"""How the command line says that something is wrong: in lines, never a traceback."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Sequence
from typing import Final

from esair.config import ConfigFileError
from esair.exceptions import ConfigError, describe, did_you_mean
from esair.values import printable

CANNOT_USE: Final = 2
"""The exit code for a command line, file or installation that cannot be used."""


def tell(message: str) -> None:
    """Write one line to the standard error."""
    print(f"esair: {message}", file=sys.stderr)  # noqa: T201 - this is the command line


def show_mistakes(mistakes: Sequence[ConfigError]) -> int:
    """Write every mistake of a configuration to the standard error."""
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for mistake in mistakes:
        line = Text()
        if isinstance(mistake, ConfigFileError):
            where = f":{mistake.line}" if mistake.line is not None else ""
            line.append(f"{mistake.file}{where}: ", "bold")
            line.append(f"{mistake.key}: " if mistake.key else "", "cyan")
            line.append(mistake.reason)
        else:
            line.append(str(mistake))
        console.print(line)
    count = len(mistakes)
    words = "1 mistake" if count == 1 else f"{count} mistakes"
    console.print(Text(f"{words}; nothing was opened, nothing moved", "bold red"))
    return CANNOT_USE


def cannot_read(error: Exception) -> int:
    """Say why a recording cannot be used."""
    if isinstance(error, FileNotFoundError):
        tell(f"{error.filename}: there is no such file")
    else:
        tell(describe(error))
    return CANNOT_USE


def has_unknown(option: str, given: Iterable[str], known: Collection[str]) -> bool:
    """Say which word after an option names nothing; return whether there is one."""
    for word in given:
        if word not in known:
            hint = (
                did_you_mean(word, known) or f"; there are {', '.join(sorted(known))}"
            )
            tell(printable(f"{option}: there is no {word!r:.80}{hint}"))
            return True
    return False


def missing_extra(error: ModuleNotFoundError, extra: str) -> int | None:
    """Say how to install what an import found missing."""
    package = (error.name or "").partition(".")[0]
    if package in {"", "esair"}:
        return None
    tell(f'this needs {package}, which is not installed: pip install "esair[{extra}]"')
    return CANNOT_USE
