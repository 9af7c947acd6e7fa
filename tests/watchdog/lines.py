"""A process whose watchdog holds lines, none, one or more: ``lines.py DESCRIPTOR ...``."""

import asyncio
import json
import os
import signal
import sys
from pathlib import Path

from esair.watchdog import Outlet, SafeFrames, Watchdog, _process


def run_another_program(*_: object) -> None:
    os.execv("/bin/sleep", ["sleep", "60"])


async def main(lines: list[int]) -> None:
    signal.signal(signal.SIGUSR1, run_another_program)
    if "FAILS" in os.environ:
        os.environ["PROGRAM"] = str(_process._PROGRAM)
        _process._PROGRAM = Path(__file__).with_name("failing.py")
    dog = Watchdog()
    await dog.start()
    frames = SafeFrames([b"STOP\n"], **json.loads(os.environ.get("FRAMES", "{}")))
    for number, line in enumerate(lines):
        outlet = Outlet("serial", descriptor=line)
        refused = await dog.arm(f"line {number}", frames, outlet)
        assert not refused, refused
    os.write(int(os.environ.get("TELLS", "1")), b"armed\n")
    while True:
        dog.beat()
        await asyncio.sleep(0.02)


if __name__ == "__main__":
    asyncio.run(main(list(map(int, sys.argv[1:]))))
