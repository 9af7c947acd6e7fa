"""Puts a built folder on a board, over its serial line, and waits until it runs.

A board has two folders for programs, and its ``main.py`` says which of them runs. The
other one is written and compared; then ``main.py`` is replaced, which is one act. So what
runs after a cut at any moment is the old program, the new one, or the safe prompt.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import attrs

from esair.boards.start import ROOM, STARTS
from esair.buses.serial import devices, find_port
from esair.exceptions import ConfigError, EsairError
from esair.firmware._lines import Lines
from esair.firmware._prompt import Prompt
from esair.firmware._starter import AT_PROMPT, MARK, SLOTS, starter

_PIECE: Final = 768  # bytes of a file in one message
_NEW: Final = "main.new"


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
    asked to make room: it ends with its safe commands, and the board starts without it,
    and without its watchdog. If this is cut at any moment, the board starts the old
    program, the new one, or none; if there is no room, or Ctrl-C ends it, the old one.

    Args:
        folder: What `build` has written.
        port: The serial port of the board, a path or ``usb:...``; the only one that
            there is, unless given.
        seconds: How long to wait for the board, before and after its reset.
        say: Told what is done, line by line.

    Raises:
        ConfigError: There is no ``main.py`` in the folder, no board, another program
            has its port, or the board does not do what is asked, in its own words.
    """
    source = folder / "compiled"
    source = source if (source / "main.py").is_file() else folder
    if not (source / "main.py").is_file():
        raise ConfigError("esair min deploy", str(folder), "there is no main.py in it")
    files = {
        path.relative_to(source).as_posix(): path.read_bytes()
        for path in sorted(source.rglob("*"))
        if path.is_file() and _is_copied(path.relative_to(source))
    }
    place = place_of(port)
    with Lines(place) as lines:
        prompt = Prompt(lines, place)
        say(f"making room on the board at {place}")
        before = _make_room(prompt, seconds)
        slot = SLOTS[before == SLOTS[0]]
        say(f"copying {len(files)} files")
        try:
            _copy(prompt, slot, files)
        except BaseException:  # a half would fill the board, and nothing would run
            with contextlib.suppress(ConfigError):
                prompt.ask(_UNDO.format(slot=slot, new=_NEW), patience=2.0)
                _reset(prompt)
            raise
        say("starting it")
        _switch(prompt)
        ready = _restart(prompt, lines, place, seconds)
    return Deployed(place, {name: len(data) for name, data in files.items()}, ready)


def _is_copied(path: Path) -> bool:
    is_code = path.suffix in {".py", ".mpy"}
    return is_code and path.parts[0] not in {"compiled", "__pycache__"}


def place_of(port: str) -> str:
    """Return where a board's serial port is found: its path, or ``usb:...``.

    Raises:
        ConfigError: There is none, or there are several to choose from.
    """
    if port.startswith("usb:"):
        try:
            find_port(port)
        except (OSError, EsairError) as error:
            raise ConfigError("esair min", "port", str(error)) from error
        return port
    if port != "auto":
        if not Path(port).exists():
            told = f"there is no {port}: is the board plugged in?"
            raise ConfigError("esair min", "port", told)
        return port
    found = [each for each in devices() if each.address.startswith("usb:")]
    if len(found) == 1:
        return found[0].address
    told = "no board is plugged in at USB: else name its port by --port"
    if found:
        told = ", ".join(each.address for each in found)
        told = f"there are several: take one by --port: {told}"
    raise ConfigError("esair min", "port", told)


_LOOK: Final = f"""
_r = globals().get("_esair"), ""
try:
    with open("main.py") as file:
        _text = file.read()
    _r = _r[0], _text.split('["')[1].split('"')[0] if "{MARK}" in _text else "?"
except OSError:
    pass
"""
"""Asks how the prompt was reached, and which program the board would start."""

_LEAVE: Final = """
if "esair.was" in os.listdir():
    os.remove("esair.was")
if "main.py" in os.listdir():
    os.rename("main.py", "esair.was")
"""

_UNDO = """
try:
    _file.close()
except Exception:  # there is none, or no room for the rest of it
    pass
_clear("{slot}")
_clear("{new}")
"""


def _make_room(prompt: Prompt, seconds: float) -> str:
    """Have the board at a prompt without a watchdog; return the folder that it starts."""
    for _ in range(5):
        prompt.enter(seconds)
        said: tuple[str, str] = ast.literal_eval(prompt.ask(_LOOK))
        state, slot = said
        if state == AT_PROMPT or (not slot and state != "reset"):
            return slot  # nothing has run that a watchdog could be of
        if not slot:
            pass  # it has not heard the last word
        elif slot == "?":  # a program of another make starts no more, and makes room so
            prompt.ask(_LEAVE)
        else:
            prompt.ask(f"open({ROOM!r}, 'w').close()")
        _reset(prompt)
    raise ConfigError("esair min deploy", "board", "it makes no room: it resets itself")


def _reset(prompt: Prompt) -> None:
    """Reset the board; what is asked is answered first, so that it comes once."""
    prompt.ask("_esair = 'reset'")
    prompt.send("machine.reset()")


def _copy(prompt: Prompt, slot: str, files: Mapping[str, bytes]) -> None:
    prompt.ask(f"_clear({slot!r})")
    folders = {str(each) for name in files for each in Path(slot, name).parents}
    for each in sorted(folders - {"."}):
        prompt.ask(f"if not _there({each!r}): os.mkdir({each!r})")
    for name, data in files.items():
        _put(prompt, f"{slot}/{name}", data)
    _put(prompt, _NEW, starter(slot).encode())


def _put(prompt: Prompt, name: str, data: bytes) -> None:
    for _ in range(3):
        prompt.ask(f"_file = open({name!r}, 'wb')")
        for at in range(0, len(data), _PIECE):
            prompt.write(at, data[at : at + _PIECE])
        prompt.ask("_file.close()")
        if prompt.ask(f"_r = _sum({name!r})")[1:-1] == hashlib.sha256(data).hexdigest():
            return
    told = "what is on the board is not what was copied: is it full?"
    raise ConfigError("esair min deploy", name, told)


def _switch(prompt: Prompt) -> None:
    """Let the board start the other program: one act, of its file system."""
    prompt.ask(f"if _there({STARTS!r}): os.remove({STARTS!r})")
    prompt.ask("if hasattr(os, 'sync'): os.sync()")
    prompt.ask(f"if _there({_NEW!r}): os.rename({_NEW!r}, 'main.py')")


def _restart(prompt: Prompt, lines: Lines, place: str, seconds: float) -> str:
    """Reset the board, and wait for any sign of life of its program."""
    _reset(prompt)
    end = time.monotonic() + seconds
    heard: list[str] = []
    asked = time.monotonic()
    while time.monotonic() < end:
        for line in lines.read():
            heard.append(line)
            if "esair: ready" in line:
                return line[line.index("esair: ready") :].strip()
        if lines.beat is not None:  # one with a link says no words
            how = "armed" if lines.beat.armed else "not armed"
            return f"esair: ready, {lines.beat.cause}, {how}, linked"
        if time.monotonic() - asked > 1.0:
            asked = time.monotonic()
            if any("NameError" in each for each in heard[-3:]):  # it is at a prompt
                heard.clear()
                prompt.enter(seconds)
                _reset(prompt)
            lines.write(b"\r\nwho\r\n\x04")  # it said so before the port was back
    told = "\n".join(heard[-15:]) or "nothing"
    told = f"the board was not ready within {seconds:g} s; it said: {told}"
    raise ConfigError("esair min deploy", place, told)


def monitor(
    port: str, show: Callable[[str], object], *, seconds: float | None = None
) -> None:
    """Show what a board says, until Ctrl-C: its lines, and how a linked one is.

    Args:
        port: As `deploy` takes it.
        show: Told each line.
        seconds: How long; for ever unless given.

    Raises:
        ConfigError: There is no board, another program has its port, or it speaks
            another version of the link.
    """
    place = place_of(port)
    end = None if seconds is None else time.monotonic() + seconds
    before: Any = None
    with contextlib.suppress(KeyboardInterrupt), Lines(place) as lines:
        while end is None or time.monotonic() < end:
            for line in lines.read():
                show(line)
            state = lines.state()
            if state is not None and state != before:
                before = state
                show(state)
