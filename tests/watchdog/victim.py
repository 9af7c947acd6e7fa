"""A process that drives, until it dies or hangs: ``victim.py LINE WAY POLICY [CGROUP]``.

The line is a terminal, or a CAN channel.
"""

import asyncio
import ctypes
import os
import re
import signal
import socket
import sys
import time
from pathlib import Path

from esair.watchdog import LIMIT, Outlet, SafeFrames, Watchdog, can_frame

GO, STOP = can_frame(0x100, b"GO"), can_frame(0x100, b"STOP")


def die(way: str) -> None:
    if way == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif way == "segfault":
        ctypes.string_at(0)
    elif way == "abort":
        os.abort()
    elif way == "stop":
        os.kill(os.getpid(), signal.SIGSTOP)
    elif way == "spin":
        while True:
            pass
    elif way == "sleep":
        time.sleep(60)
    elif way == "regex":
        re.match(r"(a+)+$", "a" * 64 + "b")


class Serial:
    """A serial line; its safe command ends what was cut in half."""

    go, stop, half = b"GO\n", b"STOP\n", b"GO"
    safe = SafeFrames([stop], resync=b"\n")

    def __init__(self, tty: str) -> None:
        self.line = os.open(tty, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.outlet = Outlet("serial", descriptor=self.line)


class Can:
    """A CAN channel."""

    go, stop, half = GO, STOP, GO
    safe = SafeFrames([STOP])

    def __init__(self, channel: str) -> None:
        can = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        can.bind((channel,))
        self.line = can.detach()
        self.outlet = Outlet("can", {"channel": channel})


async def main(line: str, way: str, policy: str) -> None:
    wire = Serial(line) if "/" in line else Can(line)
    # What is short of memory is slow, too: here it must die of it.
    limit = 5.0 if way == "oom" else LIMIT
    dog = Watchdog(limit=limit, policy=policy)  # type: ignore[arg-type]
    await dog.start()
    refused = await dog.arm("wheels", wire.safe, wire.outlet)
    assert not refused, refused
    hoard = []
    for number in range(40):
        dog.beat()
        dog.moving("wheels", True)
        os.write(wire.line, wire.go)
        if way == "oom":
            hoard.append(b"x" * 4 * 2**20)
        elif number == 20 and way != "end":
            os.write(wire.line, wire.half)
            die(way)
        await asyncio.sleep(0.005)
    os.write(wire.line, wire.stop)
    dog.moving("wheels", False)
    await dog.close()
    os.close(wire.line)


if __name__ == "__main__":
    for cgroup in sys.argv[4:]:  # the watchdog's process will belong to it, too
        Path(cgroup, "cgroup.procs").write_text(str(os.getpid()), "ascii")
    asyncio.run(main(*sys.argv[1:4]))
