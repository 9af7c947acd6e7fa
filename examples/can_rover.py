"""A rover whose motors are on a CAN bus: two messages of a DBC file.

`Patrol` drives forth and back. `Ease` goes slowly while the motors take too much current.
Run it with the name of the bus::

    sudo ip link set can0 up type can bitrate 500000
    python examples/can_rover.py can0
"""

import sys
from pathlib import Path

import esair
from esair.buses import CanBus
from esair.drivers.dbc import DbcActuator, DbcSensor

DATABASE = Path(__file__).with_suffix(".dbc")
TOO_MUCH = 8.0  # A


class Patrol(esair.Behavior):
    """Drive forth and back, two seconds each."""

    wheels = esair.writes(dict)

    async def run(self) -> None:
        steps = 0
        async for _ in esair.every(0.05):
            speed = 0.5 if steps // 40 % 2 == 0 else -0.5
            await self.wheels.write({"left": speed, "right": speed})
            steps += 1


class Ease(esair.Reaction):
    """Go slowly on, the way it goes, while the motors take too much current."""

    feedback = esair.reads(dict, max_age=0.2)
    wheels = esair.writes(dict, priority=10)

    def react(self, feedback: dict[str, float]) -> dict[str, float] | None:
        if feedback["current"] < TOO_MUCH:
            return None
        return {side: 0.2 * feedback[side] for side in ("left", "right")}


def make_robot(bus: CanBus) -> esair.Robot:
    """Return the rover; the limits of its wheels are those of the DBC file."""
    return esair.Robot(
        resources=[
            DbcSensor(
                name="feedback", bus=bus, database=DATABASE, message="WheelFeedback"
            ),
            DbcActuator(
                name="wheels",
                bus=bus,
                database=DATABASE,
                message="WheelCommand",
                sequence="counter",
                safe={"left": 0.0, "right": 0.0},
            ),
        ],
        behaviors=[Patrol(), Ease()],
    )


robot = make_robot(CanBus(name="drive", channel="can0"))

if __name__ == "__main__":
    channel = sys.argv[1] if len(sys.argv) > 1 else "can0"
    esair.run(make_robot(CanBus(name="drive", channel=channel)))
