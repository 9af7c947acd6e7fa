"""What is wrong in a file: collected, with lines, and raised together."""

from __future__ import annotations

import re
from collections.abc import Iterable

from esair.exceptions import BadValueError, ConfigError, describe, hint_for

_BARE = re.compile(r"[A-Za-z0-9_-]+\Z")
_HEADER = re.compile(r"\s*\[\[?([^\]]+)\]")
_KEY = re.compile(
    r"""\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*="""
)
_PART = re.compile(r"""[\w-]+|"([^"]*)"|'([^']*)'""")
_LONG_STRING = re.compile(r"'''|\"\"\"")


def dotted(*parts: str) -> str:
    """Join the parts of a key, quoting those that TOML would want quoted."""
    shown = []
    for part in parts:
        if not _BARE.match(part):
            part = repr(part)  # escapes whatever a terminal should not see
        shown.append(part if len(part) <= 80 else part[:77] + "...")
    return ".".join(shown)


def below(key: str, name: str) -> str:
    """Return the key of something inside the table of another key."""
    return f"{key}.{dotted(name)}"


def show(value: object) -> str:
    """Show a value of a TOML file in an error, shortly."""
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """Say that a name is unknown, and the nearest, or else all that are known."""
    return f"there is no such {what}{hint_for(name, sorted(known))}"


class Lines:
    """Where the keys of a TOML text are, found by a scan of its lines.

    Keys in inline tables are found at the line of the key that holds them.
    """

    def __init__(self, text: str) -> None:
        self._lines: dict[str, int] = {}
        table: list[str] = []
        inside = ""  # the quotes of a string over several lines
        for number, line in enumerate(text.splitlines(), 1):
            if not inside:
                if header := _HEADER.match(line):
                    table = _parts(header[1])
                    for length in range(1, len(table) + 1):
                        self._lines.setdefault(dotted(*table[:length]), number)
                elif key := _KEY.match(line):
                    path = table + _parts(key[1])
                    for length in range(len(table) + 1, len(path) + 1):
                        self._lines.setdefault(dotted(*path[:length]), number)
            for quotes in _LONG_STRING.findall(line):
                inside = quotes if not inside else ("" if quotes == inside else inside)

    def put(self, key: str, instead: str) -> None:
        """Let a key that is not in the text be found where another one is, or its table."""
        if (line := self.of(instead)) is not None:
            self._lines.setdefault(key, line)

    def of(self, key: str) -> int | None:
        """Return the line of a key, or of the nearest key above it."""
        while key:
            if key in self._lines:
                return self._lines[key]
            key = key.rpartition(".")[0]
        return None


def _parts(key: str) -> list[str]:
    return [
        found[1] or found[2] or found[0].strip("\"'") for found in _PART.finditer(key)
    ]


class ConfigFileError(ConfigError):
    """A mistake in a configuration file.

    Attributes:
        file: The file, as it was named.
        line: The line of the key, counted from 1; None if it is not known.
        key: The key, as a dotted path; empty for the whole file.
        reason: What was expected, without file, line and key.
    """

    def __init__(self, file: str, line: int | None, key: str, reason: str) -> None:
        super().__init__(file, key, reason)
        where = f"{file}:{line}" if line is not None else file
        self.args = (f"{where}: {key}: {reason}" if key else f"{where}: {reason}",)
        self.file = file
        self.line = line
        self.key = key
        self.reason = reason

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        return type(self), (self.file, self.line, self.key, self.reason)


class Mistakes:
    """All mistakes of one file."""

    def __init__(self, file: str, lines: Lines) -> None:
        self.file = file
        self.lines = lines
        self.errors: list[ConfigFileError] = []
        self.spoiled: set[str] = set()  # Keys whose values are no good for anything
        self._told: set[str] = set()

    def add(self, key: str, reason: str) -> None:
        """Note a mistake; the same one is noted once, of what is spoiled only that."""
        if key in self.spoiled:
            return
        error = ConfigFileError(self.file, self.lines.of(key), key, reason)
        if str(error) not in self._told:
            self._told.add(str(error))
            self.errors.append(error)

    def caught(self, key: str, error: BaseException, doing: str) -> None:
        """Note what a class raised while it was made from the file."""
        if isinstance(error, BaseExceptionGroup):
            for part in error.exceptions:
                self.caught(key, part, doing)
        elif isinstance(error, ConfigError | BadValueError):
            where = f"{key}.{error.field}" if _is_key(error.field) else key
            self.add(where, reason_of(error))
        else:
            self.add(key, f"{doing} raised {describe(error)}")

    def raise_all(self) -> None:
        """Raise every mistake at once, in the order of the file."""
        if self.errors:
            count = len(self.errors)
            raise ExceptionGroup(
                f"{self.file}: {count} mistake{'s' if count > 1 else ''}",
                in_order(self.errors),
            )


def in_order(errors: Iterable[ConfigFileError]) -> list[ConfigFileError]:
    """Sort mistakes by line; those without a line come first."""
    return sorted(errors, key=lambda error: error.line or 0)


def _is_key(field: str) -> bool:
    return bool(field) and all(_BARE.match(part) for part in field.split("."))


def reason_of(error: BaseException) -> str:
    """Return what an error of esair expected; name any other error."""
    if not isinstance(error, ConfigError | BadValueError):
        return describe(error)
    text = str(error).removeprefix(f"{error.component}: ")
    return text.removeprefix(f"{error.field}: ") if _is_key(error.field) else text
