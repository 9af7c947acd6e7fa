"""An RPLIDAR A1 on a fake serial line: the same packets, any surroundings."""

from __future__ import annotations

import math
from collections.abc import Callable

from esair.buses.serial import FakeSerial
from esair.drivers import rplidar
from esair.drivers.rplidar import Health, Info, Scan

BEAMS = 90
"""How many directions a turn has."""


class FakeRpLidar:
    """Answers requests, and scans when it is told to.

    Args:
        line: The line, with ``framing="raw"``.
        distance: The distance in m to what is in a direction in rad, counter-clockwise
            from straight ahead.
        period: How long a turn takes, in seconds.

    Attributes:
        info: Who it says it is.
        health: How it says it is.
        scanning: Whether it scans now.
        requests: The requests that came, oldest first.
        silent: Whether it has no power, and says nothing.
    """

    def __init__(
        self,
        line: FakeSerial,
        distance: Callable[[float], float] = lambda _angle: 1.0,
        *,
        period: float = 0.1,
    ) -> None:
        self.distance = distance
        self.info: Info = Info(0x18, (1, 29), 7, "0123456789ABCDEF0123456789ABCDEF")
        self.health: Health = Health("good", 0)
        self.scanning: bool = False
        self.requests: list[int] = []
        self.silent = False
        self._rest = b""
        line.on_write = self.heard
        line.repeat(self.turn, period)

    def heard(self, data: bytes) -> bytes:
        """Obey requests; return the answers."""
        if self.silent:
            return b""
        data = self._rest + data
        answers = b""
        while (begin := data.find(rplidar.START)) >= 0 and len(data) >= begin + 2:
            answers += self._obey(data[begin + 1])
            data = data[begin + 2 :]
        self._rest = data[-1:] if data.endswith(bytes([rplidar.START])) else b""
        return answers

    def power_cycle(self) -> None:
        """Lose the power for a moment: it scans no more."""
        self.scanning = False
        self._rest = b""

    def turn(self) -> bytes:
        """Return the measurements of the next turn; none unless it scans."""
        if not self.scanning or self.silent:
            return b""
        angles = [-math.tau * beam / BEAMS for beam in range(BEAMS)]
        angles = [angle if angle > -math.pi else angle + math.tau for angle in angles]
        return rplidar.encode_scan(
            Scan(
                tuple(angles),
                tuple(self.distance(angle) for angle in angles),
                (47,) * BEAMS,
            )
        )

    def _obey(self, command: int) -> bytes:
        self.requests.append(command)
        if command == rplidar.STOP:
            self.scanning = False
        elif command == rplidar.SCAN:
            self.scanning = True
            return rplidar.SCAN_DESCRIPTOR
        elif command == rplidar.GET_INFO:
            return rplidar.INFO_DESCRIPTOR + rplidar.encode_info(self.info)
        elif command == rplidar.GET_HEALTH:
            return rplidar.HEALTH_DESCRIPTOR + rplidar.encode_health(self.health)
        return b""
