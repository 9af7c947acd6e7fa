"""Puts a built folder on a board, over its serial line, and waits until it runs."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import attrs

from esair.boards.link import VERSION, stuffed
from esair.buses.serial import devices, find_port
from esair.exceptions import ConfigError, EsairError
from esair.firmware._lines import Lines

SILENCE: Final = 60.0
"""How long one act of mpremote may take, in seconds."""


@attrs.frozen
class Deployed:
    """What a board has got.

    Attributes:
        port: Its serial port.
        files: The files that were copied and compared, and the bytes of each.
        ready: What it said when it ran: why it has started, and what arms it.
    """

    port: str
    files: Mapping[str, int]
    ready: str


def deploy(
    folder: Path,
    *,
    port: str = "auto",
    seconds: float = 20.0,
    say: Callable[[str], object] = lambda line: None,
) -> Deployed:
    """Copy a built folder to a board, compare, reset it, and wait until it is ready.

    What was compiled is copied rather than its text. A program that runs there is
    stopped first; its actuators get their safe commands.

    Args:
        folder: What `build` has written.
        port: The serial port of the board, a path or ``usb:...``; the only one that
            there is, unless given.
        seconds: How long to wait for the board after its reset.
        say: Told what is done, line by line.

    Raises:
        ConfigError: There is no ``main.py`` in the folder, no board, no mpremote, or
            the board does not do what is asked, in its own words.
    """
    source = (
        folder / "compiled" if (folder / "compiled" / "main.py").is_file() else folder
    )
    if not (source / "main.py").is_file():
        raise ConfigError("esair min deploy", str(folder), "there is no main.py in it")
    files = {
        path.relative_to(source).as_posix(): path
        for path in sorted(source.rglob("*"))
        if path.is_file() and _is_copied(path.relative_to(source))
    }
    path = port_of(port)
    stop_program(path)
    say(f"copying {len(files)} files to the board on {path}")
    _copy(path, files)
    say("comparing")
    _compare(path, files)
    say("resetting")
    ready = _restart(path, seconds)
    return Deployed(
        path, {name: each.stat().st_size for name, each in files.items()}, ready
    )


def _is_copied(path: Path) -> bool:
    return path.parts[0] not in {"compiled", "__pycache__"} and path.suffix in {
        ".py",
        ".mpy",
    }


def port_of(port: str) -> str:
    """Return the path of a board's serial port.

    Raises:
        ConfigError: There is none, or there are several to choose from.
    """
    if port.startswith("usb:"):
        try:
            return find_port(port)
        except EsairError as error:
            raise ConfigError("esair min", "port", str(error)) from error
    if port != "auto":
        if not Path(port).exists():
            raise ConfigError(
                "esair min", "port", f"there is no {port}: is the board plugged in?"
            )
        return port
    found = [each for each in devices() if each.address.startswith("usb:")]
    if len(found) == 1:
        return find_port(found[0].address)
    told = ", ".join(each.address for each in found)
    raise ConfigError(
        "esair min",
        "port",
        f"there are several: take one by --port: {told}"
        if found
        else "no board is plugged in at USB: else name its port by --port",
    )


def stop_program(path: str) -> None:
    """Stop what runs on a board: by the link's own word, and by Ctrl-C."""
    with Lines(path) as lines:
        # A linked board takes no Ctrl-C: its bytes may be in a message.
        for message in (b"B" + str(VERSION).encode(), b"Q1"):
            lines.write(stuffed(message))
        time.sleep(0.3)
        lines.write(b"\r\x03\x03")
        time.sleep(0.1)


_PREPARE: Final = """
import os
def attempt(act, name):
    try:
        act(name)
    except OSError:
        pass
for name in {folders!r}:
    attempt(os.mkdir, name)
for name in {others!r}:
    attempt(os.remove, name)
"""


def _copy(path: str, files: Mapping[str, Path]) -> None:
    folders = sorted({str(each) for name in files for each in Path(name).parents})
    # An older text or compiled module of the same name would win, or be in the way.
    swapped = {".mpy": ".py", ".py": ".mpy"}
    others = [str(each.with_suffix(swapped[each.suffix])) for each in map(Path, files)]
    _mpremote(path, "exec", _PREPARE.format(folders=folders, others=others))
    acts: list[str] = []
    for name, file in files.items():
        acts += [*(["+"] if acts else []), "fs", "cp", str(file), f":{name}"]
    _mpremote(path, *acts)


def _compare(path: str, files: Mapping[str, Path]) -> None:
    told = _mpremote(path, "fs", "sha256sum", *(f":{name}" for name in files))
    there = re.findall(r"^[0-9a-f]{64}\b", told, re.MULTILINE)
    for (name, file), found in zip(files.items(), there, strict=True):
        if found != hashlib.sha256(file.read_bytes()).hexdigest():
            raise ConfigError(
                "esair min deploy",
                name,
                "what is on the board is not what was copied: is it full?",
            )


def _restart(path: str, seconds: float) -> str:
    with Lines(path) as lines:
        # Into the raw REPL, and the line stays open: what it says at its start counts.
        lines.write(b"\r\x03\x03\x01")
        time.sleep(0.2)
        lines.write(b"import machine\nmachine.reset()\n\x04")
        end = time.monotonic() + seconds
        heard: list[str] = []
        asked = 0.0
        while time.monotonic() < end:
            for line in lines.read():
                heard.append(line)
                if "esair: ready" in line:
                    return line[line.index("esair: ready") :].strip()
            if time.monotonic() - asked > 1.0:
                asked = time.monotonic()
                lines.write(b"who\r\n")  # it may have said so before the port was back
    tail = "\n".join(heard[-15:]) or "nothing"
    raise ConfigError(
        "esair min deploy",
        path,
        f"the board was not ready within {seconds:g} s; it said: {tail}",
    )


def _mpremote(path: str, *words: str) -> str:
    """Do something by mpremote; return what it printed."""
    if importlib.util.find_spec("mpremote") is None:
        raise ConfigError(
            "esair min deploy", "mpremote", "it is missing: pip install 'esair[min]'"
        )
    command = [sys.executable, "-m", "mpremote", "connect", path, "resume", *words]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=SILENCE, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ConfigError(
            "esair min deploy", path, "the board does not answer: is it a MicroPython?"
        ) from error
    if done.returncode:
        text = (done.stderr or done.stdout).strip()
        raise ConfigError("esair min deploy", path, f"mpremote: {text[-500:]}")
    return done.stdout


def monitor(
    port: str, show: Callable[[str], object], *, seconds: float | None = None
) -> None:
    """Show what a board says, until Ctrl-C: its lines, and how a linked one is.

    Args:
        port: As `deploy` takes it.
        show: Told each line.
        seconds: How long; for ever unless given.

    Raises:
        ConfigError: There is no board.
    """
    path = port_of(port)
    end = None if seconds is None else time.monotonic() + seconds
    before: Any = None
    with contextlib.suppress(KeyboardInterrupt), Lines(path) as lines:
        while end is None or time.monotonic() < end:
            for line in lines.read():
                show(line)
            state = lines.state()
            if state is not None and state != before:
                before = state
                show(state)
