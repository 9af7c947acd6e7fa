"""The robot that ``esair demo --kill`` kills: ``python -m esair.demo._victim PORT``."""

import logging
import sys

import esair
from esair.buses import SerialBus
from esair.drivers.line import LineActuator


class Wheels(LineActuator):
    """Both wheels, told one speed by lines of text."""

    command_timeout = 0.5


class Wander(esair.Behavior):
    """Drives on, for ever."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        """Tell the wheels 20 times a second."""
        async for _ in esair.every(0.05):
            await self.wheels.write(0.3)


if __name__ == "__main__":
    logging.basicConfig(format="%(message)s", level=logging.ERROR)
    bus = SerialBus(name="drive", port=sys.argv[1])
    wheels = Wheels(name="wheels", key="speed", safe=0.0, bus=bus)
    esair.run(esair.Robot(resources=[wheels], behaviors=[Wander()], watchdog=True))
