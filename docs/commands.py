"""The commands in the pages, typed as a reader types them, and what they print.

Every block of kind ``console`` of the README, the tutorial and the how-to pages is taken: its
lines ``$ COMMAND`` are commands, the others are what they print (without any ``$`` all are
commands).
``...`` alone stands for any lines, at the end of a line for the rest of it; a number, a time
or a path that differs each time is compared as such. A block that shows no output at all is
an overview: there the exit codes count. One is 0, unless ``$ echo $?`` shows it.

A page is one session in one folder. The files that it shows are in it, under their names.
Lines before a block say what else a reader does, or why a command is not typed::

    <!-- before: cp "$CODE/corridor.py" . -->
    <!-- while: esair sim rover.toml -->
    <!-- not run: installs 1 -->

The numbers are those of the commands in the block; without one it is all of them.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from docs import sync

PAGES = [
    sync.ROOT / "README.md",
    *sorted((sync.ROOT / "docs" / "tutorial").glob("*.md")),
    *sorted((sync.ROOT / "docs" / "how-to").glob("*.md")),
]

REASONS = {
    "installs": "it fetches packages; .ci/run types those of the README",
    "hardware": "it needs a device that is not there",
    "system": "it changes or asks the service manager of the computer",
    "terminal": "it reads keys, or draws until somebody ends it",
    "browser": "it waits for a page or a viewer",
    "compiler": "it needs a compiler for another processor",
    "ros": "it needs ROS 2 and a graph that runs",
}
"""Why a command of a page is not typed by a test."""

BLOCK = re.compile(
    r"(?P<notes>(?:^<!-- (?:before|while|not run): [^\n]+ -->\n)*)"
    r"^```(?:console|bash|sh)\n(?P<text>.*?)^```$"
    r"|^<!-- code: (?P<code>[^\n]+) -->$",
    re.M | re.S,
)
NOTE = re.compile(r"<!-- (before|while|not run): ([^\n]+) -->")

ANY = [  # what differs from run to run
    (re.compile(r"\x1b\[[0-9;]*m"), ""),
    (re.compile(r"\b\d{4}-\d\d-\d\d[-T ]\d{6}\b"), "DATE"),
    (re.compile(r"\b\d\d:\d\d:\d\d(\.\d+)?\b"), "TIME"),
    (re.compile(r"\b\d[\d,]*(\.\d+)? ?(s|ms|us|times|a minute|MB|kB)\b"), r"N \2"),
    (re.compile(r"\b\d+ (events|turns)\b|\bturn \d+"), r"N \1"),
    (re.compile(r"\bpid \d+|process \d+"), "PID"),
    (re.compile(r"(?<![\w.])/(?:[\w.+-]+/)+"), "PATH/"),
    (re.compile(r"[─═━]+|={3,}|-{3,}"), "-"),
    (re.compile(r" {2,}"), " "),
]


TRIES = 5
HELD = "the event loop is held"
"""What a robot says on a computer that does something else: it is typed again then."""


class Command(NamedTuple):
    """One command of a page."""

    line: int
    text: str
    printed: list[str] | None  # None: it shows nothing, in a block that does not either
    before: list[str]
    meanwhile: list[str]
    reason: str  # why it is not typed; empty if it is


def commands(page: str) -> Iterator[Command | str]:
    """Return the commands of a page, and where its files are from, in their order."""
    for found in BLOCK.finditer(page):
        if found["code"]:
            yield found["code"]
            continue
        notes = NOTE.findall(found["notes"])
        skipped = [value.split() for kind, value in notes if kind == "not run"]
        before = [value for kind, value in notes if kind == "before"]
        meanwhile = [value for kind, value in notes if kind == "while"]
        lines = found["text"].splitlines()
        shell = any(line.startswith("$ ") for line in lines)
        parts: list[tuple[str, list[str]]] = []
        for line in lines:
            if parts and goes_on(parts[-1][0]):
                parts[-1] = (f"{parts[-1][0]}\n{line}", [])
            elif line.startswith("$ ") or not shell:
                parts.append((line.removeprefix("$ "), []))
            else:
                parts[-1][1].append(line)
        shows = any(printed for _, printed in parts)
        at = page.count("\n", 0, found.start("text")) + 1
        for number, (text, printed) in enumerate(parts, 1):
            reason = next(
                (why for why, *which in skipped if not which or str(number) in which),
                "",
            )
            text = re.sub(r"\s{2,}#.*", "", text)
            known = printed if shows else None
            yield Command(at, text, known, before, meanwhile, reason)
            before, meanwhile = [], []


def goes_on(command: str) -> bool:
    """Tell whether the next line belongs to a command, too."""
    loops = re.search(r"; do$", command, re.M) and not command.endswith("\n  done")
    return command.endswith("\\") or bool(loops)


def alike(shown: list[str], printed: list[str]) -> bool:
    """Tell whether a command has printed what its page shows."""
    if not shown:
        return not printed
    if shown[0] == "...":
        return any(alike(shown[1:], printed[at:]) for at in range(len(printed) + 1))
    if not printed:
        return False
    known, line = shown[0], printed[0]
    same = (
        line.startswith(known[:-3].rstrip()) if known.endswith("...") else line == known
    )
    return same and alike(shown[1:], printed[1:])


def plain(text: str) -> list[str]:
    """Return lines with what differs from run to run taken out."""
    for pattern, instead in ANY:
        text = pattern.sub(instead, text)
    return [line.rstrip() for line in text.splitlines() if line.strip()]


class Session:
    """A reader in a folder, who types what a page says."""

    def __init__(self, folder: Path) -> None:
        self.here = folder
        self._state = folder / ".here"
        self._code = 0
        self._running: list[subprocess.Popen[bytes]] = []
        self._env = {
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "CODE": str(sync.ROOT / "docs" / "code"),
            "EXAMPLES": str(sync.ROOT / "examples"),
            "COLUMNS": "100",
            "PYTHONDONTWRITEBYTECODE": "1",
            "XDG_RUNTIME_DIR": str(folder),
            "STATE": str(self._state),
        }

    def keep(self, where: str) -> None:
        """Have the file that a page shows in the folder, if it is a whole one."""
        path, *options = where.split()
        file = sync.ROOT / path
        under = next((o[5:] for o in options if o.startswith("file=")), None)
        if file.suffix == ".tmpl" or (options and under is None):
            return
        (self.here / (under or file.name)).write_text(file.read_text("utf-8"), "utf-8")

    def type(self, command: str, seconds: float = 120.0) -> tuple[int, str]:
        """Type a command; return its exit code and what it has printed."""
        words = f'(exit {self._code}); {command}\ncode=$?; pwd > "$STATE"; exit $code'
        done = subprocess.run(
            ["bash", "-c", words],
            cwd=self.here,
            env=self._env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=seconds,
            check=False,
        )
        self.here = Path(self._state.read_text("utf-8").strip())
        self._code = done.returncode
        return done.returncode, done.stdout

    def meanwhile(self, command: str) -> None:
        """Have a command run until the page ends; returns when its robot runs."""
        with (self.here / ".while").open("w") as said:
            child = subprocess.Popen(
                ["bash", "-c", f"exec {command}"],
                cwd=self.here,
                env=self._env,
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=subprocess.STDOUT,
            )
        self._running.append(child)
        until = time.monotonic() + 30.0
        while time.monotonic() < until and child.poll() is None:
            time.sleep(0.1)
            code, _ = self.type("esair why")
            if code == 0:
                return
        told = (self.here / ".while").read_text("utf-8")
        raise RuntimeError(f"{command}: nothing runs: {told}")

    def close(self) -> None:
        """End what runs meanwhile."""
        for child in self._running:
            child.send_signal(signal.SIGINT)
            child.wait(timeout=20.0)


def differences(page: str, folder: Path) -> list[str]:
    """Type the commands of a page in a folder; return what is not as it says."""
    session, found = Session(folder), []
    try:
        steps = list(commands(page))
        for step, after in zip(steps, [*steps[1:], None], strict=True):
            if isinstance(step, str):
                session.keep(step)
                continue
            for text in step.before:
                code, printed = session.type(text)
                if code:
                    found.append(f"line {step.line}: before: {text}: {printed}")
            for text in step.meanwhile:
                session.meanwhile(text)
            if step.reason:
                continue
            for _ in range(TRIES):
                code, printed = session.type(step.text)
                if HELD not in printed:
                    break
            asked = isinstance(after, Command) and after.text == "echo $?"
            if code and not asked:
                found.append(f"line {step.line}: {step.text}: exit {code}\n{printed}")
            elif step.printed is not None:
                shown = plain("\n".join(step.printed))
                if not alike(shown, plain(printed)):
                    told = f"line {step.line}: {step.text}: the page shows\n"
                    found.append(told + "\n".join(shown) + f"\nbut it is\n{printed}")
    finally:
        session.close()
    return found
