"""What an action owes while nothing is wrong, and what it does not."""

import asyncio

import esair


class Wheels(esair.Actuator[float]):
    """Two wheels, in m/s."""

    safe = 0.0

    async def write(self, command: float) -> None:
        raise ConnectionError("there are no wheels at this desk")


class Patrol(esair.Behavior):
    """Drives a little, each half minute."""

    wheels = esair.writes(float)
    rounds = esair.works("wheels", within=30.0)  # owes a command each half minute

    async def run(self) -> None:
        async for _ in esair.every(25.0):
            await self.wheels.write(0.1)


class Greet(esair.Behavior):
    """Moves for five seconds when it begins, and is done."""

    wheels = esair.writes(float)
    rest = esair.works(idle=True)  # may rest, or end, whenever it likes

    async def run(self) -> None:
        for _ in range(50):
            await self.wheels.write(0.5)
            await asyncio.sleep(0.1)


# end
robot = esair.Robot(resources=[Wheels()], behaviors=[Patrol(), Greet()])
