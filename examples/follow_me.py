"""A rover of ArduPilot that follows another vehicle, 5 m behind it: both speak MAVLink.

Without arguments both vehicles are simulated, so it runs on any computer. With two they
are real, or those of a simulator::

    python follow_me.py socket://127.0.0.1:5760 socket://127.0.0.1:5770

The sticks of the rover are moved by the robot. They let go by themselves when it is
silent (`RC_OVERRIDE_TIME`), and when either position is old nobody moves them.
"""

import math
import sys

import esair
from esair.buses import SerialBus
from esair.drivers.mavlink import MavlinkSensor, Position, RcOverride

METRES_PER_DEGREE = 111_195.0
"""Of latitude."""

BEHIND = 5.0
"""How far behind the rover stays, in metres."""

STANDING = {"steering": 0.0, "throttle": 0.0}


def to_metres(there: Position, here: Position) -> tuple[float, float]:
    """Return how far north and east one position is of another."""
    narrow = math.cos(math.radians(here.latitude_deg))
    return (
        (there.latitude_deg - here.latitude_deg) * METRES_PER_DEGREE,
        (there.longitude_deg - here.longitude_deg) * METRES_PER_DEGREE * narrow,
    )


class Follow(esair.Reaction):
    """Turns to the leader, and drives the faster the further it is away."""

    own = esair.reads(Position, max_age=1.0)
    leader = esair.reads(Position, max_age=1.0)
    sticks = esair.writes(dict)
    rate = 10.0

    def react(self, own: Position, leader: Position) -> dict[str, float]:
        north, east = to_metres(leader, own)
        too_far = math.hypot(north, east) - BEHIND
        turn = math.remainder(math.atan2(east, north) - (own.heading or 0.0), math.tau)
        ahead = max(0.0, math.cos(turn))
        return {
            "steering": max(-1.0, min(1.0, 2.0 * turn)),
            "throttle": max(0.0, min(1.0, 0.3 * too_far)) * ahead,
        }


class Report(esair.Behavior):
    """Prints how far away the leader is."""

    own = esair.reads(Position, max_age=1.0)
    leader = esair.reads(Position, max_age=1.0)

    async def run(self) -> None:
        async for seconds in esair.every(0.5):
            try:
                leader = await self.leader.read(timeout=5.0)
                north, east = to_metres(leader, await self.own.read(timeout=5.0))
            except (esair.DeviceLostError, esair.StaleReadingError):
                continue
            print(f"{seconds:4.1f} s: {math.hypot(north, east):5.1f} m", flush=True)


def make_robot(rover: SerialBus, leader: SerialBus) -> esair.Robot:
    """Return the robot on the lines of both vehicles."""
    place = "GLOBAL_POSITION_INT"
    return esair.Robot(
        resources=[
            MavlinkSensor(name="own", message=place, period=0.1, bus=rover),
            MavlinkSensor(name="leader", message=place, period=0.1, bus=leader),
            RcOverride(
                name="sticks",
                channels={"steering": 1, "throttle": 3},
                safe=STANDING,
                own_timeout=1.0,
                bus=rover,
            ),
        ],
        behaviors=[Follow(), Report()],
    )


def simulated() -> tuple[SerialBus, SerialBus]:
    """Return the lines of a rover, and of a leader that drives a wide circle before it."""
    from esair.drivers.mavlink.fake import FakeVehicle
    from esair.testing import FakeSerial

    lines = (
        FakeSerial("rover", framing="mavlink"),
        FakeSerial("lead", framing="mavlink"),
    )
    FakeVehicle(lines[0], own_timeout=1.0)
    leader = FakeVehicle(lines[1], own_timeout=math.inf)
    leader.north, leader.sticks = 20.0, [1525, 1700]
    return lines


def make_bus(name: str, port: str) -> SerialBus:
    """Return the line of a vehicle."""
    return SerialBus(name=name, port=port, framing="mavlink")


robot = make_robot(make_bus("rover", "/dev/ttyACM0"), make_bus("lead", "/dev/ttyACM1"))

if __name__ == "__main__":
    if len(sys.argv) == 3:
        esair.run(
            make_robot(make_bus("rover", sys.argv[1]), make_bus("lead", sys.argv[2]))
        )
    else:
        esair.run(make_robot(*simulated()), duration=5.0)
