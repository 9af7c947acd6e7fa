"""A process that drives, until it dies or hangs: ``victim.py TTY WAY``."""

import asyncio
import ctypes
import os
import re
import signal
import sys
import time

from esair.watchdog import Outlet, SafeFrames, Watchdog

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
    dog = Watchdog(policy=policy)  # type: ignore[arg-type]
    await dog.start()
    refused = await dog.arm("wheels", SAFE, Outlet("serial", descriptor=line))
    assert not refused, refused
    for number in range(40):
        dog.beat()
        dog.moving("wheels", True)
        os.write(line, b"GO\n")
        if number == 20 and way != "end":
            os.write(line, b"GO")  # cut in half
            die(way)
        await asyncio.sleep(0.005)
    os.write(line, b"STOP\n")
    dog.moving("wheels", False)
    await dog.close()
    os.close(line)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
