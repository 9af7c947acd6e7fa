"""A driver for a servo that shares one half-duplex wire with others."""

from typing import Unpack

import esair
from esair.buses import SerialBus
from esair.resources import ActuatorSettings
from esair.watchdog import SafeFrames

MOVE, STOP, POSITION = 1, 12, 28
STEP = 0.24  # degrees


class BusServo(esair.Actuator[float]):
    """The angle in degrees. Source: Hiwonder, LX-16A bus servo protocol."""

    bus: SerialBus
    safe = esair.HOLD  # where it is
    limits = (0.0, 240.0)
    command_timeout = 0.5

    def __init__(self, *, number: int, **settings: Unpack[ActuatorSettings]) -> None:
        super().__init__(**settings)
        if number not in range(254):
            told = f"expected 0 to 253, not {number!r:.80}"
            raise esair.ConfigError(self.name, "number", told)
        self.number = number
        self.claim = f"servo {number}"

    async def open(self) -> None:
        await self.angle()  # who does not answer is not there

    async def write(self, command: float) -> float:
        angle = await self.angle() if command is esair.HOLD else command
        steps = min(max(0, round(angle / STEP)), 1000)  # it may be a bit beyond
        data = steps.to_bytes(2, "little") + bytes(2)
        await self.bus.send(bytes([self.number, MOVE]) + data)
        return steps * STEP

    def safe_frames(self) -> SafeFrames:
        stop = self.bus.framing.encode(bytes([self.number, STOP]))
        return SafeFrames([stop], repeat=3)  # one may end what was cut in half

    async def angle(self) -> float:
        """Ask it for its angle."""
        request = bytes([self.number, POSITION])
        answer = await self.bus.ask(request, prefix=request, timeout=0.1)
        return int.from_bytes(answer[2:4], "little", signed=True) * STEP
