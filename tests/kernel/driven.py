"""A robot that drives until it dies: ``driven.py KIND ADDRESS WAY POLICY``."""

import asyncio
import logging
import os
import signal
import socket
import struct
import sys
import threading
import time
from pathlib import Path
from typing import Any

import esair
from esair.buses import CanBus
from esair.drivers.dbc import DbcActuator
from esair.drivers.gpio import DigitalOutput

ROVER = Path(__file__).parents[1] / "drivers" / "rover.dbc"


class Drive(esair.Behavior):
    """Says that it drives, then dies in the given way."""

    out = esair.writes(Any)
    command: Any = None
    way = ""
    channel = ""

    async def run(self) -> None:
        for _ in range(10):
            await self.out.write(self.command)
            await asyncio.sleep(0.01)
        sys.stdout.write("driving\n")
        sys.stdout.flush()
        if self.way == "flood":
            threading.Thread(target=self.flood, daemon=True).start()
            await asyncio.sleep(0.3)
        self.die()
        while True:  # continued after all
            await self.out.write(self.command)
            await asyncio.sleep(0.01)

    def die(self) -> None:
        if self.way in {"kill", "flood"}:
            os.kill(os.getpid(), signal.SIGKILL)
        elif self.way == "stop":
            os.kill(os.getpid(), signal.SIGSTOP)
        elif self.way == "sleep":
            time.sleep(60)

    def flood(self) -> None:
        """Send motions as fast as the bus takes them."""
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can:
            can.bind((self.channel,))
            motion = struct.pack("=IB3x8s", 0x100, 8, b"\xff" * 8)
            while True:
                try:
                    can.send(motion)
                except OSError:  # its queue is full
                    time.sleep(0.0001)


def main(kind: str, address: str, way: str, policy: Any) -> None:
    Drive.way, Drive.channel = way, address
    if kind == "can":
        Drive.command = {"left": 1.0, "right": 1.0}
        device: Any = DbcActuator(
            name="out",
            bus=CanBus(name="can", channel=address),
            database=ROVER,
            message="WheelCommand",
            safe={"left": 0.0, "right": 0.0},
            fixed={"gear": "low"},
            sequence="count",
        )
    else:
        Drive.command = True
        device = DigitalOutput(name="out", chip=address, line="LAMP")
    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    esair.run(
        esair.Robot(
            resources=[device],
            behaviors=[Drive()],
            watchdog=True,
            watchdog_policy=policy,
            watchdog_limit=1.0,  # the guest is slow
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
