"""What in a robot's own code cannot repeat: found in its source, before a run."""

from __future__ import annotations

import ast
import builtins
import inspect
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
    "http.client": _NETWORK,
    "httpx": _NETWORK,
    "io.open": _FILE,
    "multiprocessing": _THREAD,
    "numpy.random": _RANDOM,
    "os.getrandom": _RANDOM,
    "os.open": _FILE,
    "os.urandom": _RANDOM,
    "pathlib.Path": _FILE,
    "random": _RANDOM,
    "requests": _NETWORK,
    "secrets": _RANDOM,
    "socket": _NETWORK,
    "subprocess": _THREAD,
    "threading.Thread": _THREAD,
    "threading.Timer": _THREAD,
    "time.monotonic": _CLOCK,
    "time.monotonic_ns": _CLOCK,
    "time.perf_counter": _CLOCK,
    "time.perf_counter_ns": _CLOCK,
    "time.time": _CLOCK,
    "time.time_ns": _CLOCK,
    "urllib": _NETWORK,
    "uuid.uuid1": _RANDOM,
    "uuid.uuid4": _RANDOM,
}


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

    It reads the source of their classes and of the functions beside them that they
    use. It does not see what libraries do inside.

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
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            path, called = _resolved(node.func, names)
            why = _why(path)
            if why:
                line = first + node.lineno - 1
                yield Unrepeatable(name, file, line, path, why)
            elif (
                isinstance(called, types.FunctionType | type)
                and called.__module__ == code.__module__
            ):
                waiting.append(called)


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
    return path.replace("_io.", "io."), value


def _why(path: str) -> str:
    while path:
        if path in _CALLS:
            return _CALLS[path]
        path = path.rpartition(".")[0]
    return ""
