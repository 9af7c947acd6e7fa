"""A process that drives, until it dies or hangs: ``victim.py TTY WAY POLICY [CGROUP]``."""

import asyncio
import ctypes
import os
import re
import signal
import sys
import time
from pathlib import Path

from esair.watchdog import LIMIT, Outlet, SafeFrames, Watchdog

SAFE = SafeFrames([b"STOP\n"], resync=b"\n")


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


async def main(tty: str, way: str, policy: str) -> None:
    line = os.open(tty, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    # What is short of memory is slow, too: here it must die of it.
    limit = 5.0 if way == "oom" else LIMIT
    dog = Watchdog(limit=limit, policy=policy)  # type: ignore[arg-type]
    await dog.start()
    refused = await dog.arm("wheels", SAFE, Outlet("serial", descriptor=line))
    assert not refused, refused
    hoard = []
    for number in range(40):
        dog.beat()
        dog.moving("wheels", True)
        os.write(line, b"GO\n")
        if way == "oom":
            hoard.append(b"x" * 4 * 2**20)
        elif number == 20 and way != "end":
            os.write(line, b"GO")  # cut in half
            die(way)
        await asyncio.sleep(0.005)
    os.write(line, b"STOP\n")
    dog.moving("wheels", False)
    await dog.close()
    os.close(line)


if __name__ == "__main__":
    for cgroup in sys.argv[4:]:  # the watchdog's process will belong to it, too
        Path(cgroup, "cgroup.procs").write_text(str(os.getpid()), "ascii")
    asyncio.run(main(*sys.argv[1:4]))
