"""The command line, as a user calls it: in this process, or in one of its own."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from esair.cli import main

Command = Callable[..., int]


@pytest.fixture
def esair_command() -> Command:
    """Run a verb in this process; what it prints goes to ``capsys``."""

    def run(*words: object) -> int:
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words])
        assert isinstance(ended.value.code, int)
        return ended.value.code

    return run


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start ``python -m esair ...`` in a process of its own."""
    started: list[subprocess.Popen[str]] = []

    def run(*words: object, cwd: Path, code: str = "") -> subprocess.Popen[str]:
        begin = ["-c", code] if code else ["-m", "esair"]
        process = subprocess.Popen(
            [sys.executable, *begin, *map(str, words)],
            cwd=cwd,
            env={**os.environ, "COLUMNS": "200", "PYTHONDONTWRITEBYTECODE": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()
