"""Write `actions/_blocking.py`: what a thread calls, from what a task awaits.

Run it after a change of a port or of `Behavior`; a test compares.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "esair"
ACTIONS = SOURCE / "actions"

PORTS = '''"""Ports whose calls wait. Written by tools/make_blocking.py."""

# What a thread calls waits where its base is awaited: that is the idea of it.
# mypy: disable-error-code="no-any-return"

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from esair.connections import ActuatorPort, Port, SensorPort
from esair.exceptions import BehaviorRemovedError
from esair.loop import Portal
from esair.messages import Reading, Refused, ResourceState, Why, Written
from esair.resources import Operation

T = TypeVar("T")


async def in_loop(function: Callable[..., T], *args: Any, **options: Any) -> T:
    """Call a plain function where it belongs, while its thread waits."""
    return function(*args, **options)


async def forever() -> None:
    await asyncio.get_running_loop().create_future()


def blocking(port: Any, portal: Portal) -> Any:
    """Return the same port for the thread of a plain behavior."""
    kind = BlockingSensorPort if isinstance(port, SensorPort) else BlockingActuatorPort
    return kind(port, portal)
'''

HEADER = '''"""Behaviors whose calls wait. Written by tools/make_blocking.py."""

# What a thread calls waits where its base is awaited: that is the idea of it.
# mypy: disable-error-code="override, no-any-return"

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar, cast, overload

from esair import minimal
from esair.actions._behavior import Behavior, D, portal_of
from esair.actions._blocking_ports import (
    BlockingActuatorPort,
    BlockingSensorPort,
    forever,
    in_loop,
)
from esair.actions._reaction import Reaction
from esair.actions._request import Request
from esair.actions._supervisor import BlockingBehaviors
from esair.connections import Stopped
from esair.messages import Access

A = TypeVar("A")
'''

BASE = '''

class BlockingPort(Generic[T]):
    """A `Port` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ("_port", "_portal")

    def __init__(self, port: Port[T], portal: Portal) -> None:
        self._port = port
        self._portal = portal
'''

PORT = '''

class Blocking{cls}(BlockingPort[T]):
    """A `{cls}` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    _port: {cls}[T]
'''

ITERATION = '''
    def __iter__(self) -> Iterator[T]:
        """Yield each new value; a slow reader misses some and gets the newest."""
        values = self._port._values()  # noqa: SLF001 - the same port, for a thread
        try:
            while True:
                yield self._portal.call(values.__anext__)
        finally:
            # Its tasks are gone too; or the collector ends it, who may be in the loop.
            with contextlib.suppress(BehaviorRemovedError, RuntimeError):
                self._portal.call(values.aclose)
'''

BEHAVIOR = '''

class ThreadBehavior(Behavior):
    """A behavior with a thread of its own: its ports and methods wait.

    Write a plain ``def run``. Everything else is as in `Behavior`.

    Example:
        >>> class Inspect(esair.ThreadBehavior):
        ...     arm = esair.writes(float)
        ...
        ...     def run(self) -> None:
        ...         for _ in esair.every(0.1):
        ...             self.arm.write(0.5)
    """

    def run(self) -> None:
        """Do the work, in the thread. Unless overridden it waits."""
        portal_of(self).call(forever)

    @property
    def supervisor(self) -> BlockingBehaviors:
        """The behaviors of the robot: what they do, and, with a right, to manage them."""
        return cast("BlockingBehaviors", super().supervisor)
'''

LEFT_OUT = {"blocking", "revive", "supervisor", "takes", "provides", "halt_robot"}


def methods(module: str, cls: str) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Return the public methods of a class, in their order."""
    tree = ast.parse((SOURCE / module).read_text(encoding="utf-8"))
    (body,) = [
        node.body
        for node in tree.body
        if isinstance(node, ast.ClassDef) and node.name == cls
    ]
    return [
        node
        for node in body
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and not node.name.startswith("_")
        and node.name not in LEFT_OUT
    ]


def passed(arguments: ast.arguments) -> str:
    """Return a call's arguments that hand on what a method gets."""
    positional = [*arguments.posonlyargs, *arguments.args]
    names = [each.arg for each in positional[1:]]
    names += [f"{each.arg}={each.arg}" for each in arguments.kwonlyargs]
    if arguments.kwarg is not None:
        names.append(f"**{arguments.kwarg.arg}")
    return "".join(f", {name}" for name in names)


def method(node: ast.FunctionDef | ast.AsyncFunctionDef, cls: str) -> str:
    """Return the text of the method that waits."""
    returns = ast.unparse(node.returns) if node.returns is not None else "None"
    head = f"    def {node.name}({ast.unparse(node.args)}) -> "
    summary, *rest = (ast.get_docstring(node) or "").split("\n")
    if rest:  # told once, where it is awaited
        told = f" See `{cls}.{node.name}`."
        summary += told if len(summary + told) < 86 else f"\n\n       {told}\n        "
    text = f'        """{summary}"""\n'
    if any(ast.unparse(each) == "property" for each in node.decorator_list):
        return f"\n    @property\n{head}{returns}:\n{text}        return self._port.{node.name}\n"
    returns = returns.replace("SensorPort[", "BlockingSensorPort[").replace(
        "ActuatorPort[", "BlockingActuatorPort["
    )
    if any(ast.unparse(each) == "overload" for each in node.decorator_list):
        return f"    @overload\n{head}{returns}: ...\n"
    is_async = isinstance(node, ast.AsyncFunctionDef)
    of_port = cls != "Behavior"
    if returns == "Awaitable[None]":
        returns = "None"
    target = f"self._port.{node.name}" if of_port else f"Behavior.{node.name}"
    portal = "self._portal" if of_port else "portal_of(self)"
    arguments = ("" if of_port else ", self") + passed(node.args)
    call = f"{target}{arguments}" if is_async else f"in_loop, {target}{arguments}"
    verb = "" if returns == "None" else "return "
    return f"\n{head}{returns}:\n{text}        {verb}{portal}.call({call})\n"


def made() -> dict[str, str]:
    """Return the text of each module, by its name."""
    ports = [PORTS, BASE, *port_methods("_ports.py", "Port")]
    ports += [PORT.format(cls="SensorPort"), *port_methods("_ports.py", "SensorPort")]
    ports += [ITERATION, PORT.format(cls="ActuatorPort")]
    ports += port_methods("_ports.py", "ActuatorPort")
    behavior = [HEADER, BEHAVIOR]
    behavior += [
        method(each, "Behavior") for each in methods("actions/_behavior.py", "Behavior")
    ]
    return {
        "_blocking_ports.py": formatted("".join(ports)),
        "_blocking.py": formatted("".join(behavior)),
    }


def port_methods(module: str, cls: str) -> list[str]:
    """Return the methods of a port that waits."""
    found = methods(f"connections/{module}", cls)
    return [method(each, cls) for each in found]


def formatted(text: str) -> str:
    """Return a module as ruff would write it."""
    ruff = [
        sys.executable,
        "-m",
        "ruff",
        "format",
        "-q",
        "--stdin-filename",
        "x.py",
        "-",
    ]
    return subprocess.run(
        ruff, input=text, capture_output=True, text=True, check=True
    ).stdout


if __name__ == "__main__":
    for name, text in made().items():
        (ACTIONS / name).write_text(text, encoding="utf-8")
