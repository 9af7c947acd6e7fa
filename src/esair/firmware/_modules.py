"""The modules that go to a board, and what they import that no board has."""

# ruff: noqa: SIM905

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Final

from esair.firmware._knowledge import run_on_boards, what_boards_do_not_know

KNOWN_MODULES: Final = frozenset(
    "array asyncio binascii bluetooth btree builtins cmath collections cryptolib deflate "
    "dht ds18x20 errno esp esp32 framebuf gc hashlib heapq io json lwip machine marshal "
    "math micropython microbit neopixel network ntptime onewire os platform pyb random re "
    "rp2 select socket ssl stm struct sys time tls uasyncio uctypes ucollections uos "
    "ustruct utime vfs webrepl zephyr zlib".split()
)
"""What MicroPython, or one of its ports, brings itself."""

FACADE: Final = ("Actuator", "Reaction", "Sensor", "reads", "writes")
"""What ``import esair`` gives on a board."""


class Modules:
    """Collects the source of modules, and of what they import.

    Args:
        folder: The folder of the configuration; its modules are found first.
        misfit: Called with the key of a component and the reason that it does not fit.
    """

    def __init__(self, folder: Path, misfit: Callable[[str, str], None]) -> None:
        self._folder = folder
        self._misfit = misfit
        self.sources: dict[str, str] = {}
        """The text of each module, by its dotted name."""
        self.facade = False
        """Whether somebody imports ``esair`` itself."""
        self.future = False
        """Whether somebody imports ``__future__``, which boards do not have."""

    def add(self, name: str, key: str) -> None:
        """Take a module that a component needs, and what it imports in turn."""
        if name in self.sources or name == "esair.minimal":
            return
        path = self._path_of(name)
        if path is None:
            self._misfit(key, f"its module {name!r} has no Python source")
            return
        text = path.read_text(encoding="utf-8")
        self.sources[name] = text
        if name == "main":
            self._misfit(key, "its module main has the name of what a board starts")
        elif name in KNOWN_MODULES:  # a stand-in for a computer, or another one
            told = f"{path.name} has the name of a module of boards: give it another"
            self._misfit(key, told)
        is_package = path.name == "__init__.py"
        try:
            tree = ast.parse(text)
        except SyntaxError as error:
            self._misfit(key, f"module {name!r}: {error}")
            return
        # An import in a try with an ImportError is the module's own concern.
        for node in run_on_boards(tree, ["ImportError"]):
            if isinstance(node, ast.Import | ast.ImportFrom):
                self._follow(node, name, is_package, key)
        for node in run_on_boards(tree):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "esair":
                self._from_esair([node.attr], name, node, key)
        if name.startswith("esair."):
            return  # they are tried on MicroPython by the tests
        for line, reason in what_boards_do_not_know(tree):
            self._misfit(key, f"{path.name}, line {line}: {reason}")

    def _follow(
        self, node: ast.Import | ast.ImportFrom, name: str, is_package: bool, key: str
    ) -> None:
        if isinstance(node, ast.Import):
            for alias in node.names:
                self._need(alias.name, name, node.lineno, key)
            return
        target = node.module or ""
        if node.level:
            parts = name.split(".")
            base = parts[: len(parts) - node.level + is_package]
            target = ".".join([*base, *([target] if target else [])])
        if target == "esair":
            self._from_esair([alias.name for alias in node.names], name, node, key)
            return
        for alias in node.names:
            whole = f"{target}.{alias.name}"
            if self._is_ours(target) and self._path_of(whole) is not None:
                self._need(whole, name, node.lineno, key)
            else:
                self._need(target, name, node.lineno, key)

    def _from_esair(
        self, wanted: list[str], name: str, node: ast.stmt | ast.expr, key: str
    ) -> None:
        for each in wanted:
            if each in FACADE:
                self.facade = True
            elif self._path_of(f"esair.{each}") is not None:
                self._need(f"esair.{each}", name, node.lineno, key)
            else:
                told = f"module {name!r} uses esair.{each}, which only STD has"
                self._misfit(key, told)

    def _need(self, target: str, name: str, line: int, key: str) -> None:
        top = target.partition(".")[0]
        if target == "__future__":
            self.future = True
        elif target == "esair":
            self.facade = True
        elif self._is_ours(target):
            self.add(target, key)
        elif top not in KNOWN_MODULES:
            self._misfit(
                key,
                f"module {name!r} (line {line}) imports {target!r}, which MicroPython "
                "does not have",
            )

    def _is_ours(self, target: str) -> bool:
        """Tell whether a module is the user's, or one of esair's."""
        top = self._folder / target.partition(".")[0]
        return top.name == "esair" or top.is_dir() or top.with_suffix(".py").is_file()

    def _path_of(self, name: str) -> Path | None:
        beside = self._folder.joinpath(*name.split("."))
        for path in (beside.with_suffix(".py"), beside / "__init__.py"):
            if path.is_file():
                return path
        try:
            spec = importlib.util.find_spec(name)
        except (ImportError, ValueError):
            return None
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            return None
        return Path(spec.origin)
