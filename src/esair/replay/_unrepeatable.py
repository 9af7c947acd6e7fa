"""What in a robot's own code cannot repeat: found in its source, before a run."""

from __future__ import annotations

import ast
import builtins
import inspect
import os.path
import sys
import textwrap
import types
from collections.abc import Iterable, Iterator
from typing import Any

import attrs

_CLOCK = "the wall clock; esair.now() is the robot's time, also in a replay"
_RANDOM = "randomness that no seed repeats; esair.random is seeded and recorded"
_FILE = "a file: a replay reads what is in it then"
_NETWORK = "the network; what comes in that way should come from a sensor"
_THREAD = "a thread or process of its own, which nobody orders"

_CALLS = {
    "_thread.start_new_thread": _THREAD,
    "asyncio.create_subprocess_exec": _THREAD,
    "asyncio.create_subprocess_shell": _THREAD,
    "asyncio.open_connection": _NETWORK,
    "asyncio.start_server": _NETWORK,
    "concurrent.futures": _THREAD,
    "datetime.date.today": _CLOCK,
    "datetime.datetime.now": _CLOCK,
    "datetime.datetime.today": _CLOCK,
    "datetime.datetime.utcnow": _CLOCK,
    "aiohttp": _NETWORK,
    "glob": _FILE,
    "http.client": _NETWORK,
    "httpx": _NETWORK,
    "io.open": _FILE,
    "multiprocessing": _THREAD,
    "numpy.random": _RANDOM,
    "os.fork": _THREAD,
    "os.getrandom": _RANDOM,
    "os.listdir": _FILE,
    "os.open": _FILE,
    "os.path.exists": _FILE,
    "os.path.getmtime": _FILE,
    "os.path.getsize": _FILE,
    "os.path.isdir": _FILE,
    "os.path.isfile": _FILE,
    "os.popen": _THREAD,
    "os.scandir": _FILE,
    "os.stat": _FILE,
    "os.system": _THREAD,
    "os.urandom": _RANDOM,
    "os.walk": _FILE,
    "pathlib.Path": _FILE,
    "random": _RANDOM,
    "requests": _NETWORK,
    "secrets": _RANDOM,
    "shutil": _FILE,
    "socket": _NETWORK,
    "sqlite3": _FILE,
    "subprocess": _THREAD,
    "tempfile": _FILE,
    "threading.Thread": _THREAD,
    "threading.Timer": _THREAD,
    "time.clock_gettime": _CLOCK,
    "time.clock_gettime_ns": _CLOCK,
    "time.ctime": _CLOCK,
    "time.gmtime": _CLOCK,
    "time.localtime": _CLOCK,
    "time.monotonic": _CLOCK,
    "time.monotonic_ns": _CLOCK,
    "time.perf_counter": _CLOCK,
    "time.perf_counter_ns": _CLOCK,
    "time.process_time": _CLOCK,
    "time.process_time_ns": _CLOCK,
    "time.strftime": _CLOCK,
    "time.thread_time": _CLOCK,
    "time.thread_time_ns": _CLOCK,
    "time.time": _CLOCK,
    "time.time_ns": _CLOCK,
    "urllib": _NETWORK,
    "uuid.uuid1": _RANDOM,
    "uuid.uuid4": _RANDOM,
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


def unrepeatable(components: Iterable[Any]) -> list[Unrepeatable]:
    """Name the calls in the code of behaviors and reactions that cannot repeat.

    It reads the source of their classes, and of what they use of their own package or
    folder. It does not see what libraries do inside.

    Args:
        components: Behaviors and reactions; drivers are not called in a replay.
    """
    found: dict[tuple[str, int, str], Unrepeatable] = {}
    for component in components:
        inner = getattr(component, "reaction", component)
        for each in _in_code(str(component.name), _code_of(type(inner))):
            found.setdefault((each.file, each.line, each.call), each)
    return sorted(found.values(), key=lambda each: (each.file, each.line))


def _code_of(kind: type) -> Iterator[Any]:
    """Yield the classes of a component that are its author's."""
    for each in kind.__mro__:
        if each.__module__.partition(".")[0] not in {"esair", "builtins", "typing"}:
            yield each


def _in_code(name: str, begin: Iterable[Any]) -> Iterator[Unrepeatable]:
    waiting = [*begin]
    seen: set[Any] = set()
    while waiting:
        code = waiting.pop()
        if code in seen:
            continue
        seen.add(code)
        try:
            lines, first = inspect.getsourcelines(code)
            tree = ast.parse(textwrap.dedent("".join(lines)))
            file = inspect.getsourcefile(code) or "?"
        except (OSError, TypeError, SyntaxError):  # made by a program, or of C
            continue
        module = sys.modules.get(code.__module__)
        names = {
            **vars(builtins),
            **(vars(module) if module else {}),
            **_imported(tree),
        }
        for node, given in _used(tree):
            path, used = _resolved(node, names)
            why = _why(path)
            if given is None and not isinstance(used, _FUNCTIONS):
                continue  # such as a type in an annotation
            if why and (given or 0) < _REPEATS_WITH.get(path, sys.maxsize):
                line = first + node.lineno - 1
                yield Unrepeatable(name, file, line, path, why)
            elif isinstance(used, types.FunctionType | type) and _beside(used, code):
                waiting.append(used)


_FUNCTIONS = (types.FunctionType, types.BuiltinFunctionType, types.MethodType)


def _used(tree: ast.AST) -> Iterator[tuple[ast.expr, int | None]]:
    """Yield what is called, with how many arguments, and what is named, with None."""
    own = {each.arg for each in ast.walk(tree) if isinstance(each, ast.arg)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield node.func, len(node.args) + len(node.keywords)
        elif isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load):
            own.add(node.id)
    called = {id(each.func) for each in ast.walk(tree) if isinstance(each, ast.Call)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and id(node) not in called:
            begin: ast.expr = node
            while isinstance(begin, ast.Attribute):
                begin = begin.value
            if not (isinstance(begin, ast.Name) and begin.id in own):
                yield node, None


def _beside(used: Any, code: Any) -> bool:
    """Tell whether something is of the same package or folder as code that uses it."""
    names = [each.__module__ or "" for each in (used, code)]
    if len({each.partition(".")[0] for each in names}) == 1:
        return True
    files = [getattr(sys.modules.get(each), "__file__", None) for each in names]
    return None not in files and len({os.path.dirname(str(f)) for f in files}) == 1


def _imported(tree: ast.AST) -> dict[str, Any]:
    """Return what code imports inside of functions, as far as it is loaded."""
    names: dict[str, Any] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for each in node.names:
                top = each.name.partition(".")[0]
                names[each.asname or top] = sys.modules.get(
                    each.name if each.asname else top
                )
        elif isinstance(node, ast.ImportFrom):
            module = sys.modules.get(node.module or "")
            for each in node.names:
                names[each.asname or each.name] = getattr(module, each.name, None)
    return {name: value for name, value in names.items() if value is not None}


_HOMES = {
    "_io.": "io.",
    "genericpath.": "os.path.",
    "posix.": "os.",
    "posixpath.": "os.path.",
}
"""Where functions come from, and where people know them."""


def _resolved(node: ast.expr, names: dict[str, Any]) -> tuple[str, Any]:
    """Return the full name of what an expression names, and that itself."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name) or node.id not in names:
        return "", None
    value = names[node.id]
    if isinstance(value, types.ModuleType):
        path = value.__name__
    else:
        owner = getattr(value, "__self__", None)  # such as random.choice
        kind = value if owner is None or isinstance(owner, types.ModuleType) else None
        kind = type(owner) if kind is None else kind
        module = getattr(kind, "__module__", "") or ""
        path = f"{module}.{getattr(value, '__qualname__', node.id)}"
    for part in reversed(parts):
        value = getattr(value, part, None)
        if isinstance(value, types.ModuleType):
            path = value.__name__
        else:
            path += f".{part}"
    for hidden, known in _HOMES.items():
        if path.startswith(hidden):
            return known + path.removeprefix(hidden), value
    return path, value


def _why(path: str) -> str:
    while path:
        if path in _CALLS:
            return _CALLS[path]
        path = path.rpartition(".")[0]
    return ""
