"""A winch with a CiA 402 drive: up while it is told to, with its load watched.

Any drive with CANopen will do; `factor` is the unit of its target velocity. The SYNC comes
from this process: when that hangs the drive gets no target any more, and the watchdog tells
it to stop::

    python examples/can_winch.py can0
"""

import sys

import esair
from esair.buses import CanBus
from esair.drivers.canopen.drive import Drive, DriveReading, DriveState

UNIT = 0.001  # rad/s for one unit of the drive
LIFT, LOWER = 6.0, -3.0  # rad/s
TOP, BOTTOM = 40.0, 0.0  # rad of the drum
SYNC = 0.02


class Haul(esair.Behavior):
    """Lift to the top, lower to the bottom, again and again."""

    drum = esair.reads(DriveReading, max_age=0.2)
    winch = esair.writes(float)

    async def run(self) -> None:
        speed = LIFT
        async for reading in self.drum:
            if reading.position >= TOP:
                speed = LOWER
            elif reading.position <= BOTTOM:
                speed = LIFT
            await self.winch.write(speed)


def make_robot(bus: CanBus) -> esair.Robot:
    """Return the robot: one node is both the sensor and the actuator."""
    return esair.Robot(
        resources=[
            Drive(name="winch", bus=bus, node=5, factor=UNIT, sync=SYNC),
            DriveState(name="drum", bus=bus, node=5, sync=SYNC, position_factor=UNIT),
        ],
        behaviors=[Haul()],
    )


robot = make_robot(CanBus(name="drive", channel="can0"))

if __name__ == "__main__":
    channel = sys.argv[1] if len(sys.argv) > 1 else "can0"
    esair.run(make_robot(CanBus(name="drive", channel=channel)))
