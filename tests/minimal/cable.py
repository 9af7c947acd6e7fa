"""A board at the end of a cable that behaves like one.

A real MicroPython runs what is in a folder, as a board does what is in its flash memory,
and its serial line goes through a relay. The relay drops the port at a reset for a time,
stops reading, fills up, is slow, damages bytes, and cuts the power after any byte; and it
has the watchdog, which outlives the program and cannot be stopped but by a reset.
"""

import contextlib
import fcntl
import os
import pty
import random
import select
import signal
import subprocess
import termios
import threading
import time
import tty
from pathlib import Path
from typing import Any, Self

import pytest

from esair.boards import stand_in

MACHINE = (
    Path(stand_in.__file__).read_text()
    + '''

import os as _os

cause = int(_os.getenv("RESET_CAUSE") or "1")


def reset():
    """Begin anew, at once: nothing of the program runs any more."""
    _os.system("kill -9 $PPID")


class WDT:
    """The watchdog of the relay: it bites whatever runs, and nothing stops it."""

    def __init__(self, timeout: int = 5000) -> None:
        self.line = open(_os.getenv("WATCHDOG"), "wb")
        self.line.write(b"%d\\n" % timeout)

    def feed(self) -> None:
        self.line.write(b"f")
'''
)
"""``machine`` of a board: pins that a test drives, and a reset and a watchdog that act."""

RUN = """
exec <>"$0" >&0 2>&0
if [ -f main.py ]; then exec "$1" -X heapsize=2m -i main.py; fi
exec "$1" -X heapsize=2m
"""

WAYS: dict[str, dict[str, Any]] = {
    "plain": {},
    "goes away": {"away": 1.0},
    "slow": {"speed": 20_000},
    "damages": {"damage": 0.00005, "seed": 7},
}
"""How a cable may be."""


def each_way() -> list[Any]:
    """Return the ways as parameters of a test: the plain one for each run."""
    plain, *others = WAYS
    return [plain, *(pytest.param(each, marks=pytest.mark.long) for each in others)]


class Cable:
    """A board and its cable; use it as a context manager.

    Args:
        program: The native MicroPython.
        folder: Gets a folder ``flash``, and the port of the board as ``tty``.
        ctrl_c: Whether a program is interrupted by Ctrl-C, as on a board unless it
            takes the byte for itself, as the link does.
        away: How long the port is gone at a reset, in seconds.
        boot: How long a board takes to begin, in seconds.
        speed: Bytes per second each way; None for as fast as can be.
        damage: The chance that a bit of a byte flips.
        seed: Of that chance.

    Attributes:
        folder: What the board has in its flash memory.
        port: Where its port is, while it is there.
        read: Whether the computer's end is read. If not, the line fills up.
        boots: How many times it has begun.
        bites: How many of these were the watchdog's.
        passed: How many bytes have gone over the line, both ways.
        heard: What the board has said.
    """

    def __init__(
        self,
        program: str,
        folder: Path,
        *,
        ctrl_c: bool = True,
        away: float = 0.0,
        boot: float = 0.02,
        speed: int | None = None,
        damage: float = 0.0,
        seed: int = 0,
    ) -> None:
        folder.mkdir(exist_ok=True)
        self.folder = folder / "flash"
        self.folder.mkdir(exist_ok=True)
        self._rom = folder / "rom"
        self._rom.mkdir(exist_ok=True)
        (self._rom / "machine.py").write_text(MACHINE)
        self._watchdog = self._rom / "watchdog"
        os.mkfifo(self._watchdog)
        self.port = str(folder / "tty")
        self._program, self._ctrl_c = program, ctrl_c
        self.away, self.boot, self.speed, self.damage = away, boot, speed, damage
        self._chance = random.Random(seed)
        self.read = True
        self.boots = self.bites = self.passed = 0
        self.heard = bytearray()
        self._cut_at: int | None = None
        self._lock = threading.RLock()
        self._process: subprocess.Popen[bytes] | None = None
        self._inner: list[int] = []
        self._outer: list[int] = []
        self._bite_at: float | None = None
        self._bite_in = 0.0
        self._on_at: float | None = None
        self._port_at: float | None = None
        self._cause = 1
        self._to_host = bytearray()
        self._to_board = bytearray()
        self._fed = os.open(self._watchdog, os.O_RDWR | os.O_NONBLOCK)
        self._over = threading.Event()
        self._relay = threading.Thread(target=self._run, name="cable")

    def __enter__(self) -> Self:
        self.power()
        self._relay.start()
        self.until(lambda: Path(self.port).exists())
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._relay.join()
        self._kill()
        self._take_port_away()
        os.close(self._fed)

    # What a test does

    def power(self, on: bool = True) -> None:
        """Give the board power, or cut it: at once, whatever it does."""
        with self._lock:
            self._cut_at = None
            self._kill()
            self._take_port_away()
            self._cause = 1
            now = time.monotonic()
            self._on_at = now if on else None
            self._port_at = now + self.away if on else None

    def reset(self, cause: int = 2) -> None:
        """Press its button."""
        with self._lock:
            self._reset(cause)

    def freeze(self, *, still: bool = True) -> None:
        """Let the board stand still, with its power, or go on."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGSTOP if still else signal.SIGCONT)

    def cut_after(self, count: int) -> None:
        """Cut the power when so many bytes more have passed."""
        with self._lock:
            self._cut_at = self.passed + count

    @property
    def slot(self) -> str:
        """The folder of the program that it starts."""
        return (self.folder / "main.py").read_text().split('["')[1].split('"')[0]

    @property
    def has_power(self) -> bool:
        """Whether it has not been cut."""
        return self._on_at is not None or self._process is not None

    def until(self, condition: Any, seconds: float = 20.0) -> None:
        """Wait for something that another process does."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, bytes(self.heard[-800:])
            time.sleep(0.01)

    # The relay

    def _run(self) -> None:
        before = time.monotonic()
        budget = [0.0, 0.0]
        while not self._over.is_set():
            ends = [self._fed, *self._inner[:1], *self._outer[:1]]
            with contextlib.suppress(OSError, ValueError):
                select.select(ends, [], [], 0.002)
            with self._lock:
                now = time.monotonic()
                passed, before = now - before, now
                for i in range(2):
                    most = self.speed and max(1.0, self.speed * 0.02)
                    budget[i] = (
                        min(most, budget[i] + passed * self.speed)
                        if self.speed and most
                        else 65536.0
                    )
                self._look(now)
                self._carry(budget)

    def _look(self, now: float) -> None:
        """See to the watchdog, to a board that has ended, and to what is due."""
        with contextlib.suppress(BlockingIOError):
            told = os.read(self._fed, 4096)
            whole, _, rest = told.rpartition(b"\n")
            if whole.strip(b"f"):
                self._bite_in = int(whole.split(b"\n")[-1].strip(b"f")) / 1000
            if self._process is not None and (whole or rest):
                self._bite_at = now + self._bite_in
        if self._process is not None and self._process.poll() is not None:
            # It has reset itself, or it was Ctrl-D at its prompt: a soft reset.
            self._reset(5, soft=self._process.returncode == 0)
        if self._bite_at is not None and now > self._bite_at:
            self.bites += 1
            self._reset(3)
        if self._on_at is not None and now >= self._on_at:
            self._on_at = None
            self._begin()
        if self._port_at is not None and now >= self._port_at:
            self._port_at = None
            self._bring_port()

    def _reset(self, cause: int, *, soft: bool = False) -> None:
        bites = self._bite_at if soft else None  # the port stays, and the watchdog
        self._kill()
        self._cause, self._bite_at = cause, bites
        now = time.monotonic()
        self._on_at = now + self.boot
        if self.away and not soft:
            self._take_port_away()
            self._port_at = now + self.away

    def _begin(self) -> None:
        mine, other = pty.openpty()
        how = termios.tcgetattr(other)
        how[0] = 0
        how[1] &= ~termios.OPOST
        how[3] &= ~(termios.ICANON | termios.ECHO)
        if not self._ctrl_c:
            how[3] &= ~termios.ISIG
        termios.tcsetattr(other, termios.TCSANOW, how)
        os.set_blocking(mine, False)
        self._inner = [mine, other]
        self.boots += 1
        self._process = subprocess.Popen(
            ["sh", "-c", RUN, os.ttyname(other), self._program],
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={
                "PATH": os.environ["PATH"],
                "MICROPYPATH": f".frozen:{self._rom}",
                "RESET_CAUSE": str(self._cause),
                "WATCHDOG": str(self._watchdog),
            },
        )

    def _kill(self) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None
        for each in self._inner:
            os.close(each)
        self._inner = []
        self._bite_at = None
        with contextlib.suppress(BlockingIOError):
            os.read(self._fed, 65536)
        self._to_board.clear()
        self._to_host.clear()

    def _take_port_away(self) -> None:
        Path(self.port).unlink(missing_ok=True)
        for each in self._outer:
            os.close(each)
        self._outer = []

    def _bring_port(self) -> None:
        if self._outer:
            return
        mine, other = pty.openpty()
        tty.setraw(other)
        os.set_blocking(mine, False)
        fcntl.fcntl(mine, fcntl.F_SETFL, os.O_NONBLOCK)
        self._outer = [mine, other]
        Path(self.port).symlink_to(os.ttyname(other))

    def _carry(self, budget: list[float]) -> None:
        if self._inner and self.read and len(self._to_host) < 4096:
            said = self._taken(self._inner[0])
            self.heard += said
            if self._outer:  # nobody hears what is said while the port is away
                self._to_host += said
        if self._outer and len(self._to_board) < 4096:
            self._to_board += self._taken(self._outer[0])
        for i, (waiting, ends) in enumerate(
            ((self._to_host, self._outer), (self._to_board, self._inner))
        ):
            most = int(min(len(waiting), budget[i]))
            if not ends or not most:
                continue
            if self._cut_at is not None:
                most = min(most, self._cut_at - self.passed)
            data = bytearray(waiting[:most])
            for at in range(len(data)):
                if self.damage and self._chance.random() < self.damage:
                    data[at] ^= 1 << self._chance.randrange(8)
            sent = 0
            with contextlib.suppress(BlockingIOError):
                sent = os.write(ends[0], data)
            del waiting[:sent]
            budget[i] -= sent
            self.passed += sent
            if self._cut_at is not None and self.passed >= self._cut_at:
                self.power(on=False)
                return

    def _taken(self, end: int) -> bytes:
        try:
            return os.read(end, 1024)
        except (BlockingIOError, OSError):
            return b""
