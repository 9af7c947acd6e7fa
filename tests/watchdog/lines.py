"""A process whose watchdog holds lines, none, one or more: ``lines.py DESCRIPTOR ...``."""

import asyncio
import sys

from esair.watchdog import Outlet, SafeFrames, Watchdog


async def main(lines: list[int]) -> None:
    dog = Watchdog()
    await dog.start()
    for number, line in enumerate(lines):
        outlet = Outlet("serial", descriptor=line)
        for _ in range(9):  # a busy computer takes a while to start it
            refused = await dog.arm(f"line {number}", SafeFrames([b"STOP\n"]), outlet)
            if not refused:
                break
        assert not refused, refused
    sys.stdout.write("armed\n")
    sys.stdout.flush()
    while True:
        dog.beat()
        await asyncio.sleep(0.02)


if __name__ == "__main__":
    asyncio.run(main(list(map(int, sys.argv[1:]))))
