"""A configuration file: read once, parsed, and looked over as a whole."""

from __future__ import annotations

import functools
import hashlib
import math
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, Final

import attrs

from esair.config._mistakes import ConfigFileError, Lines, Mistakes, below, dotted, show
from esair.config._values import INVALID, convert
from esair.exceptions import ConfigError
from esair.values import check_name

LIMIT: Final = 1_048_576  # How large a configuration file may be, in bytes
TABLES: Final = 512  # How many tables a configuration file may have
DEPTH: Final = 16  # How deeply its tables and lists may be nested

_HEADERS: Final = re.compile(r"^[ \t]*\[", re.MULTILINE)
_INTEGER: Final = 2**63  # what TOML promises to keep


@attrs.frozen
class Source:
    """The text of one configuration file, parsed."""

    path: Path
    digest: str  # SHA-256 of its bytes, in hexadecimal: what was loaded, exactly
    text: str
    data: dict[str, Any]
    mistakes: Mistakes
    implied: set[str] = attrs.field(factory=set)  # Parts that a board brings along

    def convert(self, value: object, kind: Any, key: str) -> Any:
        """Return a value as a type, or `INVALID`; what is wrong is a mistake."""
        return convert(value, kind, key, self.mistakes.add, self.folder)

    def wrong(self, key: str, expected: str, value: object) -> None:
        """Note that something else was expected."""
        self.mistakes.add(key, f"expected {expected}, not {show(value)}")

    def is_name(self, kind: str, name: str, key: str) -> bool:
        """Tell whether something may have a name; if not, that is a mistake."""
        try:
            check_name(kind, name)
        except ConfigError as error:
            told = f"a name is {str(error).rpartition('expected ')[2]}"
            self.mistakes.add(key, told)
            return False
        return True

    def value(self, key: str) -> object:
        """Return what stands at a key; None if nothing does."""
        found: object = self.data
        for part in key.split("."):
            found = found.get(part) if isinstance(found, dict) else None
        return found

    @functools.cached_property
    def folder(self) -> Path:
        """Where the file lies: relative paths and modules are found there."""
        return self.path.resolve().parent


def read_source(path: str | os.PathLike[str], text: str | None = None) -> Source:
    """Read and parse a configuration file, once."""
    shown = str(path)
    raw = _bytes_of(path, shown) if text is None else text.encode()
    try:
        text = raw.decode().removeprefix("\ufeff")  # which some editors put there
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigFileError(shown, line, "", "expected text in UTF-8") from None
    # Before it is parsed: that alone may take minutes.
    if len(_HEADERS.findall(text)) > TABLES:
        raise ConfigFileError(shown, None, "", f"expected at most {TABLES} tables")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        reason = f"expected at most {DEPTH} tables or lists inside each other"
        raise ConfigFileError(shown, None, "", reason) from None
    except ValueError as error:  # with "(at line 3, column 5)"
        reason = f"this is no TOML: {' '.join(str(error).split())}"
        if shown.endswith(".py"):
            reason = f"this is a program, 'python {shown}' runs it; check and torture "
            reason += f"take the robot in it: {shown}:robot"
        raise ConfigFileError(shown, None, "", reason) from None
    if sum(len(each) for each in data.values() if isinstance(each, dict)) > TABLES:
        raise ConfigFileError(shown, None, "", f"expected at most {TABLES} tables")
    mistakes = Mistakes(shown, Lines(text))
    _look_over(data, mistakes)
    digest = hashlib.sha256(raw).hexdigest()
    return Source(Path(path), digest, text, data, mistakes)


def digest_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a configuration file, in hexadecimal.

    Raises:
        ConfigError: It cannot be read.
    """
    return hashlib.sha256(_bytes_of(path, str(path))).hexdigest()


def tables_of(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a configuration file says, unchecked; nothing is made of it.

    Raises:
        ConfigError: It cannot be read, or is no TOML.
    """
    return read_source(path).data


def _bytes_of(path: str | os.PathLike[str], shown: str) -> bytes:
    try:
        # Without a wait: nobody may ever write to a FIFO.
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            if not stat.S_ISREG(os.fstat(number).st_mode):
                reason = "expected a file, not a device, pipe or folder"
                raise ConfigFileError(shown, None, "", reason)
            with os.fdopen(number, "rb", closefd=False) as file:
                raw = file.read(LIMIT + 1)
        finally:
            os.close(number)
    except ConfigFileError:
        raise
    except FileNotFoundError:
        reason = "there is no such file"
        if ":" in shown:
            reason += ": a robot of a module is run by its program, by esair.run(robot)"
        raise ConfigFileError(shown, None, "", reason) from None
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = f"it cannot be read: {getattr(error, 'strerror', None) or error}"
        raise ConfigFileError(shown, None, "", reason) from None
    if len(raw) > LIMIT:
        raise ConfigFileError(shown, None, "", f"expected at most {LIMIT} bytes")
    return raw


def _look_over(data: dict[str, Any], mistakes: Mistakes) -> None:
    """Note, and take out, what no key of any component can want: it is `INVALID`."""
    waiting: list[tuple[str, Any, int]] = [("", data, 0)]
    while waiting:
        key, holder, depth = waiting.pop()
        items = holder.items() if isinstance(holder, dict) else enumerate(holder)
        for name, value in list(items):
            where = below(key, str(name)) if key else dotted(str(name))
            problem = _problem(value, where, depth)
            if problem:
                mistakes.add(where, problem)
                mistakes.spoiled.add(where)
                holder[name] = INVALID
            elif isinstance(value, dict | list):
                waiting.append((where, value, depth + 1))


def _problem(value: object, key: str, depth: int) -> str | None:
    if isinstance(value, dict | list) and depth >= DEPTH:
        return f"expected at most {DEPTH} tables or lists inside each other"
    if isinstance(value, float) and not math.isfinite(value):
        if "limits" in key.split(".") and not math.isnan(value):
            return None  # a limit on one side only
        return f"expected a finite number, not {show(value)}"
    if isinstance(value, int) and not -_INTEGER <= value < _INTEGER:
        return "expected a whole number of 64 bits"
    return None
