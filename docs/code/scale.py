"""A scale on I²C that can be told what weighs nothing."""

from typing import Any

import esair
from esair.buses import I2CBus


class Scale(esair.Sensor[float]):
    """The weight, in kg: an NAU7802 that counts 20,000 for each."""

    bus: I2CBus
    zero = 0.0

    async def read(self) -> float:
        data = await self.bus.read(0x2A, 0x12, 3)
        return int.from_bytes(data, signed=True) / 20_000 - self.zero

    @esair.operation(deadline=3.0)
    async def tare(self, samples: int = 4) -> float:
        """Take what lies on it now for nothing; returns how much that is, in kg."""
        weights = [await self.read() for _ in range(samples)]
        self.zero += sum(weights) / samples
        return self.zero


class Weigh(esair.Behavior):
    """Tares once, then tells the weight."""

    scale = esair.reads(float, configure=True)

    async def run(self) -> None:
        await self.scale.operate("tare", samples=8)
        async for weight in self.scale:
            self.offer(weight, latest=True)


def weights(robot: esair.Robot) -> Any:
    """What an operator sees: each operation with its parameters."""
    return [str(each) for each in robot.resources.get("scale").operations.values()]
