"""A rover that speaks MAVLink on a fake serial line, and drives as it is told."""

from __future__ import annotations

import asyncio
import math
from typing import Any

from esair.buses.serial import FakeSerial
from esair.drivers.mavlink import ARMED, BEAT, IGNORED, MIDDLE
from esair.framing import Mavlink

EARTH = 6_371_000.0
"""Its radius, in m."""

BEGIN = 0.0, 8.0
"""Where a vehicle begins: its latitude and longitude, in degrees."""


class FakeVehicle:
    """Tells how and where it is; goes forward and turns by its sticks.

    Args:
        line: The line, with ``framing="mavlink"``.
        system: Its number.
        period: From one position to the next, in seconds.
        own_timeout: After how many seconds it forgets what its sticks were told.

    Attributes:
        north: Where it is, in m from where it began; ``east`` likewise.
        yaw: Clockwise from north, in rad.
        speed: In m/s; at most 5.
        sticks: What channels 1 and 3 were told last, in microseconds: steering and throttle.
        heard: The messages that it was told, by name, the newest of each.
        silent: Whether it says and hears nothing, as without power.
    """

    def __init__(
        self,
        line: FakeSerial,
        *,
        system: int = 1,
        period: float = 0.1,
        own_timeout: float = 3.0,
    ) -> None:
        assert isinstance(line.framing, Mavlink)
        self._dialect = line.framing.dialect
        self._mav = self._dialect.MAVLink(None, system, 1)
        self._framing = line.framing.fresh()
        self._system = system
        self._period = period
        self._own_timeout = own_timeout
        self._told_at = -math.inf
        self.north: float = 0.0
        self.east: float = 0.0
        self.yaw: float = 0.0
        self.speed: float = 0.0
        self.sticks: list[int] = [MIDDLE, MIDDLE]
        self.heard: dict[str, Any] = {}
        self.silent = False
        self._silent_until = -math.inf
        line.on_frame = self._heard
        line.repeat(self._beat, BEAT)
        line.repeat(self._move, period)

    def power_cycle(self) -> None:
        """Lose the power for a moment: it is silent while it starts anew."""
        self._silent_until = asyncio.get_running_loop().time() + 4.0
        self.sticks = [MIDDLE, MIDDLE]

    def _packed(self, message: str, *fields: Any) -> bytes:
        now = asyncio.get_running_loop().time()
        if self.silent or now < self._silent_until:
            return b""
        kind = getattr(self._dialect, f"MAVLink_{message}_message")
        packet: bytes = kind(*fields).pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet

    def _beat(self) -> bytes:
        return self._packed("heartbeat", 10, 3, ARMED, 0, 4, 3)

    def _move(self) -> bytes:
        now = asyncio.get_running_loop().time()
        if now - self._told_at > self._own_timeout:
            self.sticks = [MIDDLE, MIDDLE]
        steering, throttle = ((each - MIDDLE) / 500 for each in self.sticks)
        self.speed = 5.0 * throttle
        self.yaw = math.remainder(self.yaw + steering * self._period, math.tau)
        self.north += self.speed * math.cos(self.yaw) * self._period
        self.east += self.speed * math.sin(self.yaw) * self._period
        gone = (math.degrees(each / EARTH) for each in (self.north, self.east))
        place = ((begin + far) * 1e7 for begin, far in zip(BEGIN, gone, strict=True))
        going = (self.speed * math.cos(self.yaw), self.speed * math.sin(self.yaw))
        return self._packed(
            "global_position_int",
            0,
            *map(round, place),
            0,
            0,
            *(round(100 * each) for each in going),
            0,
            round(math.degrees(self.yaw % math.tau) * 100) % 36000,
        ) + self._packed("attitude", 0, 0.0, 0.0, self.yaw, 0.0, 0.0, steering)

    def _heard(self, payload: bytes) -> None:
        if self.silent:
            return
        told = self._mav.decode(bytearray(self._framing.encode(payload)))
        self.heard[told.get_type()] = told
        if told.get_type() == "RC_CHANNELS_OVERRIDE":
            self._told_at = asyncio.get_running_loop().time()
            for n, raw in enumerate((told.chan1_raw, told.chan3_raw)):
                if raw != IGNORED:
                    self.sticks[n] = raw or MIDDLE
