"""A rover to be watched and steered from another terminal."""

import attrs

import esair


@attrs.frozen
class Docked:
    """It stands in its bay."""

    bay: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    """Go to a bay."""

    bay: int


class Wheels(esair.Actuator[float]):
    """Nothing is connected."""

    safe = 0.0
    command_timeout = 0.5
    max_speed = esair.setting(0.5, unit="m/s", min=0.0, max=1.0)

    async def write(self, command: float) -> float:
        return min(command, self.max_speed)


class Scale(esair.Sensor[float]):
    """What is on it, in kg."""

    async def read(self) -> float:
        return 0.0

    @esair.operation
    async def tare(self, samples: int = 4) -> int:
        """Call what is on it now nothing."""
        return samples


class Wander(esair.Behavior):
    """Drive on."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            await self.wheels.write(0.3)


class Planner(esair.Behavior):
    """Takes goals."""

    async def run(self) -> None:
        while True:
            await self.receive()


class Docking(esair.Behavior):
    """Drives to a bay when it is asked."""

    @esair.answers
    async def dock(self, request: Dock) -> Docked:
        return Docked(request.bay)

    async def run(self) -> None:
        async for _ in esair.every(1.0):
            pass
