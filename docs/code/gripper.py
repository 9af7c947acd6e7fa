"""A gripper: its motor and its force on a CAN bus, its attitude from an IMU on I²C."""

from collections.abc import AsyncIterator

import esair
from esair.buses import CanBus
from esair.drivers.mpu6050 import Motion


class Motor(esair.Actuator[float]):
    """How fast it closes, -1 to 1; it stops by itself when it hears nothing."""

    bus: CanBus
    safe = 0.0
    limits = (-1.0, 1.0)
    own_timeout = 0.3

    async def write(self, command: float) -> None:
        speed = round(command * 127).to_bytes(1, signed=True)
        await self.bus.send(0x201, speed)


class Force(esair.Sensor[float]):
    """How hard it presses, in N; the gripper tells it by itself."""

    bus: CanBus

    async def stream(self) -> AsyncIterator[float]:
        with self.bus.frames(0x181, length=2) as frames:
            async for frame in frames:
                yield int.from_bytes(frame.data) / 100


class Hold(esair.Reaction):
    """Close until something is held."""

    force = esair.reads(float, max_age=0.2)
    motor = esair.writes(float)

    def react(self, force: float) -> float:
        return 0.5 if force < 5.0 else 0.0


class LetGo(esair.Reaction):
    """Open when the arm is upside down, whatever is held."""

    attitude = esair.reads(Motion, max_age=0.5)
    motor = esair.writes(float, priority=10)

    def react(self, attitude: Motion) -> float | None:
        return -1.0 if attitude.acceleration[2] < 0.0 else None
