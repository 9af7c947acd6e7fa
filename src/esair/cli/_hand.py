"""``esair drive``: an actuator driven by keys, while somebody holds them."""

from __future__ import annotations

import collections
import contextlib
import math
import os
import select
import shutil
import sys
import termios
import time
import tty
from collections.abc import Iterator, Mapping
from typing import Any, Final

from rich.cells import set_cell_size

from esair.cli._errors import CANNOT_USE, tell
from esair.cli._options import Which
from esair.seat import Client, connect
from esair.values import printable

GAP: Final = 0.3
"""After how long without a look at the keys those typed meanwhile are dropped, in s."""

ASK: Final = "\x1b[5n"
"""Asks the terminal whether it is there; what is typed after its answer is newer than this."""

ANSWER: Final = b"\x1b[0n"

ASKED: Final = 32  # How many answers a terminal may owe until it is asked no more

HOW: Final = "hold a key; space stops, q leaves"

KEYS: Final[Mapping[bytes, tuple[int, int]]] = {
    b"\x1b[A": (1, 0),
    b"\x1b[B": (-1, 0),
    b"\x1b[D": (0, 1),
    b"\x1b[C": (0, -1),
    b"w": (1, 0),
    b"s": (-1, 0),
    b"a": (0, 1),
    b"d": (0, -1),
    b" ": (0, 0),
}
"""What a key means: how much forward, how much to the left."""

END: Final = (b"q", b"\x03", b"\x04")


def drive(
    actuator: str, /, *, speed: float = 0.3, lease: float = 0.5, robot: Which = None
) -> int:
    """Drive an actuator with the arrow keys, or w a s d.

    A space stops, q leaves. It moves while a key is held. Nothing is queued: when the
    keys, this program or the terminal are gone, the actuator is released when the lease
    is over.

    Args:
        actuator: What to drive.
        speed: Which part of its limits a key means; without limits the number itself.
        lease: How long it goes on without a fresh key, in seconds.
    """
    if not 0.0 < speed < math.inf:  # less would turn the keys round
        tell(f"--speed: expected a number above 0, not {speed:g}")
        return CANNOT_USE
    if not sys.stdin.isatty():
        tell("drive: expected a terminal with keys")
        return CANNOT_USE
    with connect(robot) as client, _keys_one_by_one():
        _Wheel(client, actuator, speed, lease).turn()
    return 0


def command_of(forward: int, left: int, axes: Mapping[str, Any], speed: float) -> Any:
    """Return the command that a key means, for an actuator with these axes.

    One axis follows forward and back; ``left`` and ``right`` are the sides of a pair of
    wheels; else the first axis is forward, the second turns to the left.
    """

    def part(direction: int, limits: Any) -> float:
        low, high = limits or (-1.0, 1.0)
        return float(speed * direction * abs(high if direction >= 0 else low))

    names = list(axes)
    if names == [""]:
        return part(forward, axes[""])
    command = dict.fromkeys(names, 0.0)
    if {"left", "right"} <= axes.keys():
        command["left"] = part(_sign(forward - left), axes["left"])
        command["right"] = part(_sign(forward + left), axes["right"])
        return command
    for name, direction in zip(names, (forward, left), strict=False):
        command[name] = part(direction, axes[name])
    return command


def _sign(number: int) -> int:
    return (number > 0) - (number < 0)


@contextlib.contextmanager
def _keys_one_by_one() -> Iterator[None]:
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    settings = termios.tcgetattr(sys.stdin)
    settings[3] &= ~termios.ISIG  # Ctrl-C is a key here: it gives back first
    termios.tcsetattr(sys.stdin, termios.TCSANOW, settings)
    try:
        yield
    finally:
        # What a held key has typed is no word for the shell.
        termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)


class _Wheel:
    """Turns keys into input for a lease.

    A key answers the newest beat that the terminal had when it was typed, and may come late
    over a network, as by ssh: so the terminal is asked at each beat. One that never answers
    is taken for one of this computer.
    """

    def __init__(
        self, client: Client, actuator: str, speed: float, seconds: float
    ) -> None:
        self._client = client
        self._actuator = actuator
        self._speed = speed
        self._seconds = seconds
        self._lease: dict[str, Any] | None = None
        self._beat: int | None = 0
        self._asked: collections.deque[int] = collections.deque()
        self._answers = False
        self._rest = b""
        self._pressed = -math.inf
        self._sent: str | None = None
        self._shown = ""

    def turn(self) -> None:
        """Go on until somebody leaves."""
        self._take()
        self._show(HOW)
        try:
            self._listen()
            if self._lease is not None:
                self._client.send("release", {"lease": self._lease["lease"]})
            self._show(f"{self._actuator} is released")
        finally:
            self._wait_for_answers()
            sys.stdout.write("\n")

    def _listen(self) -> None:
        last = time.monotonic()
        while True:
            ready, _, _ = select.select([sys.stdin, self._client], [], [], 0.05)
            now = time.monotonic()
            if now - last > GAP:  # the program stood still: what was typed is old
                while select.select([sys.stdin], [], [], 0.0)[0] and self._read():
                    pass
                ready = [each for each in ready if each is not sys.stdin]
                self._show("there was a gap: the keys typed in it were dropped")
            last = now
            if self._client in ready:
                self._hear()
            if sys.stdin in ready:
                typed = self._read()
                if not typed or any(keys.endswith(END) for _, keys in typed):
                    return
                for beat, keys in typed:
                    self._press(keys, beat)

    def _read(self) -> list[tuple[int | None, bytes]]:
        """Return what was typed, each with the beat that it answers; nothing at the end."""
        keys = os.read(sys.stdin.fileno(), 4096)
        if not keys:
            return []
        keys = self._rest + keys
        whole = len(keys) - next(n for n in (3, 2, 1, 0) if keys.endswith(ANSWER[:n]))
        before, *after = keys[:whole].split(ANSWER)
        self._rest = keys[whole:]
        typed = [(self._beat, before)]
        for later in after:
            self._answers = True
            if self._asked:
                self._beat = self._asked.popleft()
            typed.append((self._beat, later))
        return typed

    def _take(self) -> None:
        fields = {"actuator": self._actuator, "seconds": self._seconds}
        self._lease = self._client.do("lease", fields)
        self._ask(self._lease["beat"])

    def _ask(self, beat: int) -> None:
        """Ask the terminal: keys that come before its answer are older than a beat."""
        if len(self._asked) < ASKED and os.environ.get("TERM") != "dumb":
            self._asked.append(beat)
            sys.stdout.write(ASK)
            sys.stdout.flush()
        if not self._answers:
            self._beat = beat

    def _wait_for_answers(self) -> None:
        """Let no answer come when somebody else reads the keys."""
        end = time.monotonic() + 1.0
        with contextlib.suppress(OSError):  # the terminal itself has gone
            while self._answers and self._asked and time.monotonic() < end:
                if select.select([sys.stdin], [], [], 0.1)[0] and not self._read():
                    return

    def _press(self, keys: bytes, beat: int | None) -> None:
        """Send what the newest key means; those before it are never done."""
        key = max(KEYS, key=lambda each: (keys.rfind(each), keys.endswith(each)))
        if key not in keys:
            return
        before, self._pressed = self._pressed, time.monotonic()
        if self._lease is None:
            if self._pressed - before < min(GAP, 0.8 * self._seconds):
                return  # held all the time: who has taken it over keeps it
            self._take()
            beat = None if self._answers else self._beat
        assert self._lease is not None
        if beat is None:
            return  # it may be old: the next one tells
        forward, left = KEYS[key]
        command = command_of(forward, left, self._lease["axes"], self._speed)
        self._sent = self._client.send(
            "drive",
            {"lease": self._lease["lease"], "beat": beat, "command": command},
        )
        self._show(f"{self._actuator}: {command}")

    def _hear(self) -> None:
        for found in self._client.lines(0.0):
            if "beat" in found:
                self._ask(found["beat"])
            elif self._lease and found.get("lapsed") == self._lease["lease"]:
                self._lease = self._beat = None
                self._show(f"released: let go, {HOW}")
            elif found.get("id") == self._sent and "ok" in found:
                if not found["ok"]:
                    self._show(str(found["error"]["text"]))
                elif not found["result"]["written"]:
                    by, rule = found["result"]["holder"], found["result"]["rule"]
                    told = rule if rule.startswith(by) else f"{by}: {rule}"
                    self._show(f"refused: {told}")  # what does not fit is cut

    def _show(self, text: str) -> None:
        if text != self._shown:
            self._shown = text
            width = shutil.get_terminal_size().columns - 1  # what wraps is not erased
            line = set_cell_size(printable(text), width).rstrip()
            sys.stdout.write(f"\r\x1b[K{line}")
            sys.stdout.flush()
