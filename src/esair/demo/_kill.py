"""The death of a robot: its process is killed while it drives, seen from the wheels."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import subprocess
import sys
import time

import attrs
from rich.console import Console
from rich.text import Text

from esair.buses.serial import PtyLine

WAYS = {
    signal.SIGKILL: "killed: kill -9, as by a crash or by want of memory",
    signal.SIGSTOP: "stopped: kill -STOP, as by a debugger or a computer that swaps",
}
"""How the process is made to move the wheels no more, and what else does the like."""

MOVES, SAFE = b"speed=0.3", b"speed=0"  # What the wheels are told
DRIVES = 20  # How many commands come before the end
PATIENCE = 15.0  # How long the robot may take to start and to drive, in seconds
QUIET = 0.6  # How long it is listened after its end, in seconds


@attrs.frozen
class Death:
    """What was seen from the far end of the wheels' line."""

    # Each line, and when it came, in seconds from the signal on
    lines: tuple[tuple[float, bytes], ...]
    said: str  # What the watchdog said

    @property
    def safe_after(self) -> float | None:
        """When the wheels had their safe frame, in seconds; None if never, or not last."""
        moved = any(line == MOVES for _, line in self.lines)
        after = [(when, line) for when, line in self.lines if when >= 0 and line]
        if not moved or not after or after[-1][1] != SAFE:
            return None
        moves = [when for when, line in after if line != SAFE]
        return min(when for when, _ in after if not moves or when > moves[-1])


def kill(console: Console) -> int:
    """Let a robot die in each way, and show what its wheels were told.

    Returns:
        The exit code: 0 if the last that they were told was their safe frame, each time.
    """
    console.print(
        "A robot in a process of its own tells its wheels 20 times a second to drive, over "
        "a serial line.\nThe far end of the line is here: it notes when each line came."
    )
    good = True
    for way, told in WAYS.items():
        console.print(f"\n[bold]Its process is {told}[/bold]")
        death = die(way)
        for when, line in death.lines[-6:]:
            if line:
                style = "green" if line == SAFE else "red" if when > 0 else ""
                console.print(Text(f"  {1000 * when:+8.1f} ms  {line.decode()}", style))
        safe = death.safe_after
        good = good and safe is not None
        end = "NOT SAFE" if safe is None else f"safe after {1000 * safe:.1f} ms"
        console.print(f"  [bold]the wheels are {end}[/bold], and nothing more came")
        console.print(Text(f"  {death.said.strip() or 'no word of a watchdog'}", "dim"))
    return 0 if good else 1


def die(way: signal.Signals) -> Death:
    """Let a robot drive, then end its process, and listen to its wheels' line."""
    return asyncio.run(_die(way))


async def _die(way: signal.Signals) -> Death:
    lines: list[tuple[float, bytes]] = []
    rest = b""
    drives = asyncio.Event()

    def hear(data: bytes) -> None:
        nonlocal rest
        *whole, rest = (rest + data).split(b"\n")
        lines.extend((time.monotonic(), line) for line in whole)
        if sum(line == MOVES for _, line in lines) >= DRIVES:
            drives.set()

    line = PtyLine()
    line.heard = hear
    line.plug()
    robot = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "esair.demo._victim", line.port),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(drives.wait(), PATIENCE)
        begin = time.monotonic()
        robot.send_signal(way)
        await asyncio.sleep(QUIET)
    finally:
        with contextlib.suppress(ProcessLookupError):
            robot.kill()
        _, said = await robot.communicate()
        line.unplug()
    timed = tuple((when - begin, line) for when, line in lines)
    return Death(timed, said.decode(errors="replace"))
