"""A battery and wheels without hardware."""

import esair


class Battery(esair.Sensor[float]):
    """Is always half full."""

    async def read(self) -> float:
        return 0.5


class Wheels(esair.Actuator[float]):
    """Only remember what they were told."""

    safe = 0.0

    async def write(self, command: float) -> None:
        self.told = command
