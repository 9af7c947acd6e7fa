"""How the command line says that something is wrong: in lines, never a traceback."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import textwrap
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, TextIO

from esair.config import ConfigFileError
from esair.exceptions import (
    ConfigError,
    EsairError,
    RecordingBrokenError,
    RecordingError,
    describe,
    hint_for,
)
from esair.seat import NoRobotError
from esair.standard import leaves
from esair.values import printable

if TYPE_CHECKING:
    from rich.console import Console

INTERRUPTED: Final = 130  # The exit code after Ctrl-C: 128 and the number of SIGINT
NOT_DONE: Final = 1  # The exit code if a robot has not done what it was told
CANNOT_USE: Final = 2  # That of a command line, file or package that cannot be used

_EXTRAS: Final = {
    **dict.fromkeys(("mcap", "foxglove", "lz4", "zstandard"), "record"),
    **dict.fromkeys(("starlette", "uvicorn", "websockets"), "page"),
    **dict.fromkeys(("cantools", "matplotlib", "numpy", "pymunk"), "sim"),
}
"""Which extra of esair brings a package that a verb needs."""


def show(line: str, stream: TextIO | None = None) -> None:
    """Write one line; to a terminal as several, which begin with whole words."""
    stream = stream or sys.stdout
    if stream.isatty():
        line = textwrap.fill(
            line,
            os.get_terminal_size(stream.fileno()).columns or 80,
            subsequent_indent=" " * (len(line) - len(line.lstrip()) + 2),
            break_long_words=False,
            break_on_hyphens=False,
        )
    print(line, file=stream)


@contextlib.contextmanager
def heeded(console: Console) -> Iterator[None]:
    """Write what is printed within: the exit code counts, whatever of it is read."""
    with console.capture() as shown:
        yield
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(shown.get())


def say(line: str) -> None:
    """Write a line to the standard error, if it takes one: nothing depends on it."""
    with contextlib.suppress(OSError):  # a full disk, a reader that has gone
        show(line, sys.stderr)


def tell(message: str) -> None:
    """Write a message to the standard error."""
    for line in f"esair: {message}".split("\n"):
        say(line)


def exit_code_of(error: Exception) -> int | None:
    """Say what has ended a verb; return its exit code, None if nobody expected it."""
    if isinstance(error, ConfigError | ExceptionGroup):
        found = list(leaves(error))
        strange = not all(isinstance(each, ConfigError) for each in found)
        return None if strange else _show_mistakes(found)
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        extra = _EXTRAS.get(package)
        if extra is None:
            return None
        how = f'pip install "esair[{extra}]"'
        tell(f"this needs {package}, which is not installed: {how}")
        return CANNOT_USE
    if isinstance(error, RecordingBrokenError | RecordingError):
        tell(describe(error))
        return CANNOT_USE
    if isinstance(error, EsairError | TimeoutError):
        tell(printable(str(error)))
        return CANNOT_USE if isinstance(error, NoRobotError) else NOT_DONE
    if isinstance(error, FileNotFoundError) and error.filename:
        tell(printable(f"{error.filename}: there is no such file"))
        return CANNOT_USE
    if isinstance(error, OSError) and error.filename and error.errno != errno.ENOSPC:
        tell(describe(error))
        return CANNOT_USE
    return None


def _show_mistakes(mistakes: Sequence[BaseException]) -> int:
    """Write every mistake of a configuration to the standard error."""
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True, highlight=False)
    console.soft_wrap = not console.is_terminal
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
    told = f"{counted(len(mistakes), 'mistake')}; nothing was opened, nothing moved"
    console.print(Text(told, "bold red"))
    return CANNOT_USE


def has_unknown(option: str, given: Iterable[str], known: Collection[str]) -> bool:
    """Say which word after an option names nothing; return whether there is one."""
    for word in given:
        if word not in known:
            hint = hint_for(word, sorted(known))
            tell(printable(f"{option}: there is no {word!r:.80}{hint}"))
            return True
    return False


def is_no_picture(target: Path) -> bool:
    """Say which pictures can be drawn, if this is none of them; return whether."""
    from matplotlib.figure import Figure

    kinds = Figure().canvas.get_supported_filetypes()
    return has_unknown("--out", [target.suffix[1:].lower() or "png"], kinds)


def counted(number: int, word: str) -> str:
    """Return how many there are, in words."""
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def wrong_seconds(seconds: float | None, option: str = "--for") -> bool:
    """Say what is wrong with how long it takes; return whether something is."""
    wrong = seconds is not None and not 0 < seconds < float("inf")
    if wrong:
        tell(f"{option}: expected seconds > 0, not {seconds:g}")
    return wrong
