"""A rover that explores, docks and charges: behaviors that take turns."""

import asyncio

import esair


class Wander(esair.Behavior):
    """Drives about until the battery is low."""

    battery = esair.reads(float)
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(0.3)
            if await self.battery.read() < 0.2:
                return


class Dock(esair.Behavior):
    """Drives to the dock, slowly."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        try:
            async with asyncio.timeout(5.0):
                async for _ in esair.every(0.05):
                    await self.wheels.write(0.1)
        except TimeoutError:
            return


class Charge(esair.Behavior):
    """Waits until the battery is full."""

    battery = esair.reads(float)

    async def run(self) -> None:
        async for level in self.battery:
            if level > 0.9:
                return


def make_robot(battery: esair.Sensor, wheels: esair.Actuator) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(
        resources=[battery, wheels],
        behaviors=[Wander(), Dock(), Charge()],
        modes={
            "explore": esair.Mode(["wander"], then="dock"),
            "dock": esair.Mode(["dock"], then="charge", on_failure="explore"),
            "charge": esair.Mode(["charge"], then="explore"),
        },
        mode="explore",
    )
