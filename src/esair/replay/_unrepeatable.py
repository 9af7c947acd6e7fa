"""What in a robot's own code cannot repeat: found in its source, which is only read.

Nothing is imported and nothing is made: a recording, and the folder that it lies in, may
be somebody else's.
"""

from __future__ import annotations

import ast
import builtins
import importlib.metadata
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import attrs

from esair import config
from esair.exceptions import ConfigError
from esair.values import snake_case

_CLOCK = "the wall clock; esair.now() is the robot's time, also in a replay"
_RANDOM = "randomness that no seed repeats; esair.random is seeded and recorded"
_FILE = "a file: a replay reads what is in it then"
_PROCESS = "of this process alone: another one has another; use a setting of the robot"
_NETWORK = "the network; what comes in that way should come from a sensor"
_THREAD = "a thread or process of its own, which nobody orders"
_ANYIO = "a thread of anyio, which nobody orders; those of asyncio.to_thread repeat"
_PLACED = (
    "a thread of a placed component, which nobody orders; without placement it repeats"
)

_CALLS: Final = {
    name: why
    for why, names in {
        _CLOCK: """
            datetime.date.today datetime.datetime.now datetime.datetime.today
            datetime.datetime.utcnow time.clock_gettime time.clock_gettime_ns
            time.ctime time.gmtime time.localtime time.monotonic time.monotonic_ns
            time.perf_counter time.perf_counter_ns time.process_time
            time.process_time_ns time.strftime time.thread_time time.thread_time_ns
            time.time time.time_ns timeit.default_timer
        """,
        _RANDOM: """
            numpy.random os.getrandom os.urandom random secrets uuid.uuid1
            uuid.uuid4
        """,
        _ANYIO: "anyio.from_thread anyio.to_thread",
        _FILE: """
            anyio.Path anyio.open_file builtins.input glob io.open os.listdir os.open
            os.path.exists os.path.getmtime os.path.getsize os.path.isdir
            os.path.isfile os.scandir os.stat os.walk pathlib.Path shutil sqlite3
            tempfile
        """,
        _PROCESS: "builtins.hash os.environ os.getenv",
        _NETWORK: """
            aiohttp anyio.connect_tcp anyio.connect_unix anyio.create_tcp_listener
            anyio.create_udp_socket asyncio.open_connection asyncio.start_server http.client httpx
            requests socket urllib
        """,
        _THREAD: """
            _thread.start_new_thread anyio.open_process anyio.run_process
            anyio.to_interpreter anyio.to_process asyncio.create_subprocess_exec
            asyncio.create_subprocess_shell concurrent.futures multiprocessing
            os.fork os.popen os.system subprocess threading.Thread threading.Timer
        """,
    }.items()
    for name in names.split()
}

_REPEATS_WITH = {
    "numpy.random.RandomState": 1,
    "numpy.random.default_rng": 1,
    "random.Random": 1,
    "time.ctime": 1,
    "time.gmtime": 1,
    "time.localtime": 1,
    "time.strftime": 2,
}
"""What gives the same again if it has so many arguments: a seed, a time."""


@attrs.frozen
class Unrepeatable:
    """A call that may give something else in a replay.

    Attributes:
        component: Whose code it is in.
        file: The file of the code.
        line: The line in it.
        call: What is called.
        why: What is wrong with it, and what to use instead.
    """

    component: str
    file: str
    line: int
    call: str
    why: str

    def __str__(self) -> str:
        return f"{self.component}: {self.file}:{self.line}: {self.call}: {self.why}"


LARGEST: Final = 1 << 20
"""How large a file of source may be, in bytes."""

_TYPES: Final = {"socket.socket", "datetime.date", "datetime.datetime"}
"""What begins with a small letter, and is no function where it is only named."""

_BASES: Final = {"Behavior", "Reaction", "ThreadBehavior"}
"""What the classes of a program derive from that are looked at."""

_HOMES: Final = {"posix.": "os.", "posixpath.": "os.path."}
"""Where functions come from, and where people know them."""

_Code = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def unrepeatable(made_of: str | os.PathLike[str]) -> list[Unrepeatable]:
    """Name the calls in the code of behaviors and reactions that cannot repeat.

    It reads the source of their classes, and of what they use of their own package or
    folder. It does not see what libraries do inside.

    Args:
        made_of: A robot.toml, ``module:robot``, ``file.py:robot`` or a program.

    Raises:
        ConfigError: There is no such file, or it or the source of a class that it names
            cannot be read.
    """
    target = str(made_of)
    if config.is_of_module(target) or target.endswith(".py"):
        begin = [*_of_program(target)]
    else:
        begin = [*_of_file(Path(target))]
    found: dict[tuple[str, int, str], Unrepeatable] = {}
    for name, source, code, is_placed in begin:
        for each in _in_code(name, source, code, is_placed=is_placed):
            found.setdefault((each.file, each.line, each.call), each)
    return sorted(found.values(), key=lambda each: (each.file, each.line))


class Source:
    """One module of the robot, as a tree.

    Attributes:
        module: Its dotted name.
        path: Its file.
        code: Its functions and classes.
        names: What other names in it mean, as dotted paths.
    """

    def __init__(
        self,
        module: str,
        path: Path,
        places: tuple[str, ...],
        known: dict[str, Source | None] | None = None,
    ) -> None:
        self.module = module
        self.path = path
        self.places = places
        self.known = {} if known is None else known
        text = path.read_bytes()
        if len(text) > LARGEST:
            raise ConfigError(str(path), "", f"expected at most {LARGEST} bytes")
        try:
            tree = ast.parse(text)
        except (SyntaxError, ValueError, RecursionError) as error:
            told = f"it is no Python: {type(error).__name__}"
            raise ConfigError(str(path), "", told) from None
        self.code: dict[str, _Code] = {}
        self.names: dict[str, str] = {}
        self.names = self.imported(tree.body)
        for node in tree.body:
            if isinstance(node, _Code):
                self.code[node.name] = node
            elif isinstance(node, ast.Assign):
                self.assigned(node)

    def imported(self, nodes: Iterable[ast.AST]) -> dict[str, str]:
        """Return what statements import, as dotted paths."""
        names: dict[str, str] = {}
        for node in nodes:
            if isinstance(node, ast.Import):
                for each in node.names:
                    top = each.name.partition(".")[0]
                    names[each.asname or top] = each.name if each.asname else top
            elif isinstance(node, ast.ImportFrom):
                parts = self.module.split(".")[: -node.level] if node.level else []
                if node.level and self.path.name == "__init__.py":
                    parts = self.module.split(".")[: len(parts) + 1]
                base = ".".join([*parts, *([node.module] if node.module else [])])
                for each in node.names:
                    names[each.asname or each.name] = f"{base}.{each.name}"
        return names

    def assigned(self, node: ast.Assign) -> None:
        """Keep what a name of the module is: another name, or made by a call."""
        value: ast.expr = node.value
        given = 0
        if isinstance(value, ast.Call):
            given = len(value.args) + len(value.keywords)
            value = value.func
        path = self.resolved(value, self.names)
        if path and given < _REPEATS_WITH.get(path, sys.maxsize):
            for target in node.targets:
                if isinstance(target, ast.Name):
                    self.names[target.id] = path

    def resolved(self, node: ast.expr, names: dict[str, str]) -> str:
        """Return the dotted path of what an expression names; empty if of nothing."""
        parts: list[str] = []
        while isinstance(node, ast.Attribute):
            parts.append(node.attr)
            node = node.value
        if not isinstance(node, ast.Name):
            return ""
        if node.id in self.code:
            begin = f"{self.module}.{node.id}"
        elif node.id in names:
            begin = names[node.id]
        elif node.id == "open":
            begin = "io.open"
        else:
            begin = f"builtins.{node.id}" if hasattr(builtins, node.id) else ""
        path = ".".join([begin, *reversed(parts)]) if begin else ""
        if path and node.id in names:
            path = self.known_as(path)
        for hidden, known in _HOMES.items():
            if path.startswith(hidden):
                return known + path.removeprefix(hidden)
        return path

    def find(self, path: str) -> tuple[Source, _Code] | None:
        """Return the function or class of a dotted path, if it is the robot's own."""
        module, _, name = path.rpartition(".")
        source = self if module == self.module else self.beside(module)
        return (source, source.code[name]) if source and name in source.code else None

    def beside(self, module: str) -> Source | None:
        """Return a module of the same package or folder."""
        if module not in self.known:
            top = self.module.partition(".")[0]
            own = self.places[:1] if module.partition(".")[0] != top else self.places
            file = _file_of(module, own)
            self.known[module] = None
            if file is not None:
                self.known[module] = Source(module, file, self.places, self.known)
        return self.known[module]

    def known_as(self, path: str, depth: int = 8) -> str:
        """Return what a path means that goes by the names of another own module."""
        module = path
        while depth and (module := module.rpartition(".")[0]):
            source = self.beside(module)
            if source is None:
                continue
            name, _, rest = path[len(module) + 1 :].partition(".")
            further = source.names.get(name)
            if further is None or name in source.code:
                return path
            return source.known_as(f"{further}.{rest}".rstrip("."), depth - 1)
        return path


def _file_of(module: str, places: Iterable[str]) -> Path | None:
    """Return the file of a module; it is looked for by name, nothing is imported."""
    parts = module.split(".")
    if not module or not all(part.isidentifier() for part in parts):
        return None
    for place in places:
        path = Path(place or ".", *parts)
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if file.is_file():
                return file
    return None


def _places(folder: Path) -> tuple[str, ...]:
    return (str(folder), *sys.path)


_Found = tuple[str, Source, _Code, bool]
"""A class by the name of its component, and whether that is placed."""


def _of_file(path: Path) -> Iterator[_Found]:
    """Yield the classes of the behaviors that a robot.toml names."""
    tables = config.tables_of(path).get("behavior")
    folder = path.resolve().parent
    for name, table in tables.items() if isinstance(tables, dict) else ():
        driver = table.get("driver") if isinstance(table, dict) else None
        if not isinstance(driver, str):
            continue
        code = driver
        if ":" not in driver:
            points = importlib.metadata.entry_points(group="esair.drivers")
            code = next((each.value for each in points if each.name == driver), "")
        module, _, wanted = code.partition(":")
        if module.partition(".")[0] == "esair":
            continue
        places = _places(folder)
        file, found = _file_of(module, places), None
        if file is not None:
            source = Source(module, file, (str(_root(file, module)), *places))
            found = source.find(f"{module}.{wanted}")
        if found is None:
            told = f"there is no source of {driver!r} to be looked at"
            raise ConfigError(str(path), f"behavior.{name}.driver", told)
        placement = table.get("placement")
        is_placed = _is_placed(*found) if placement is None else placement != "task"
        yield (name, *found, is_placed)


def _root(file: Path, module: str) -> Path:
    """Return the folder in which the first part of a module's name lies."""
    depth = module.count(".") + (file.name == "__init__.py")
    return file.resolve().parents[depth]


def _of_program(target: str) -> Iterator[_Found]:
    """Yield the classes of a program, and of the modules beside it, that act."""
    where = target if target.endswith(".py") else target.rpartition(":")[0]
    file = (
        Path(where) if where.endswith(".py") else _file_of(where, _places(Path.cwd()))
    )
    if file is None or not file.is_file():
        raise ConfigError(target, "", "there is no such file")
    folder = file.resolve().parent
    module = file.stem if where.endswith(".py") else where
    begin = Source(module, file, _places(folder))
    waiting, seen = [begin], {file}
    while waiting:
        source = waiting.pop()
        for name, code in source.code.items():
            if isinstance(code, ast.ClassDef) and _acts(source, code):
                yield snake_case(name), source, code, _is_placed(source, code)
        for path in source.names.values():
            for each in (path, path.rpartition(".")[0]):
                beside = _file_of(each, source.places[:1])
                if beside is not None and beside not in seen:
                    seen.add(beside)
                    waiting.append(Source(each, beside, source.places))


def _acts(source: Source, code: ast.ClassDef, depth: int = 8) -> bool:
    """Tell whether a class is that of a behavior or reaction."""
    for base in code.bases:
        path = source.resolved(base, source.names)
        if path.partition(".")[0] == "esair" and path.rpartition(".")[2] in _BASES:
            return True
        found = source.find(path) if path and depth else None
        if (
            found is not None
            and isinstance(found[1], ast.ClassDef)
            and _acts(found[0], found[1], depth - 1)
        ):
            return True
    return False


def _is_placed(source: Source, code: _Code, depth: int = 8) -> bool:
    """Tell whether a class says that it lives in a process of its own."""
    if not isinstance(code, ast.ClassDef):
        return False
    for node in code.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if any(isinstance(t, ast.Name) and t.id == "placement" for t in targets):
            value = node.value  # type: ignore[attr-defined]
            return not (isinstance(value, ast.Constant) and value.value != "process")
    bases = [source.find(source.resolved(each, source.names)) for each in code.bases]
    return any(_is_placed(*each, depth - 1) for each in bases if each and depth)


def _in_code(
    name: str, source: Source, code: _Code, *, is_placed: bool
) -> Iterator[Unrepeatable]:
    waiting = [(source, code)]
    seen: set[tuple[Path, int]] = set()
    while waiting:
        source, code = waiting.pop()
        if (source.path, code.lineno) in seen:
            continue
        seen.add((source.path, code.lineno))
        names = {**source.names, **source.imported(ast.walk(code))}
        for node, given in _used(code):
            path = source.resolved(node, names)
            why = _why(path)
            if is_placed and path == "asyncio.to_thread":
                why = _PLACED
            if why and (given is not None or _is_function(path)):
                if (given or 0) < _REPEATS_WITH.get(path, sys.maxsize):
                    yield Unrepeatable(name, str(source.path), node.lineno, path, why)
            elif path and (found := source.find(path)) is not None:
                waiting.append(found)


def _is_function(path: str) -> bool:
    """Tell whether what is only named may be called by somebody: it is no type."""
    last = path.rpartition(".")[2]
    is_module = path in _CALLS and f"{path}." in _MODULES
    return last.islower() and path not in _TYPES and not is_module and "." in path


def _used(tree: ast.AST) -> Iterator[tuple[ast.expr, int | None]]:
    """Yield what is called, with how many arguments, and what is named, with None."""
    own = {each.arg for each in ast.walk(tree) if isinstance(each, ast.arg)}
    inner: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            inner.add(id(node.func))
            yield node.func, len(node.args) + len(node.keywords)
        elif isinstance(node, ast.Attribute):
            inner.add(id(node.value))
        elif isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load):
            own.add(node.id)
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and id(node) not in inner:
            begin: ast.expr = node
            while isinstance(begin, ast.Attribute):
                begin = begin.value
            if not (isinstance(begin, ast.Name) and begin.id in own):
                yield node, None


_MODULES: Final = {
    "concurrent.futures.", "http.client.", "numpy.random.", "urllib.request.",
}  # fmt: skip
"""Modules in modules: naming one calls nothing."""


def _why(path: str) -> str:
    while path:
        if path in _CALLS:
            return _CALLS[path]
        path = path.rpartition(".")[0]
    return ""
